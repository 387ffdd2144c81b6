// The cause of a stop, a pause or a refusal: what happened in the language of the page, and on request the service's sentence.

import { element } from "./elements.js";
import { foreign, inPageUnits, knows, parts, text, word } from "./words.js";

// the reason that this page sends for a press of STOP; the audit stores it in this form, in every language of the page
export const PAGE = "operator page";
export const PRESSED = "stop button";

const STOPPED = /^stopped by (.+?): (.*)$/;
const ERROR = /^([A-Z]\w+): (?:(\w+) \([^)]*\): |(\w+): )?/; // its name and, if the sentence begins with one, the axis
const SIGN_OF_LIFE = /^no sign of life within ([\d.]+) s/;
const BY_REQUEST = /^(paused|aborted) by request/;

// `by` and `why` of a stop
/** @param {string} by @param {string} why */
export const stopParts = (by, why) => parts("stop.by", { by: whose(by), why: why === PRESSED ? text("stop.button") : foreign(why) });

/** @param {string} by */
export const whose = (by) => (by === PAGE || by.endsWith(`(${PAGE})`) ? by.replace(PAGE, text("stop.page")) : by);

// whether nobody wanted it
/** @param {string} cause */
export const byFault = (cause) => cause !== "" && !STOPPED.test(cause) && !BY_REQUEST.test(cause);

// of a campaign, a sweep or a diagnosis: who stopped it, what happened, or a sentence
/** @param {string} cause @returns {Part[]} */
export function causeParts(cause) {
  const [, by, why] = cause.match(STOPPED) ?? [];
  if (by !== undefined) return parts("cause.stopped", { by: whose(by), why: why === PRESSED ? text("stop.button") : foreign(why) });
  const [, seconds] = cause.match(SIGN_OF_LIFE) ?? [];
  if (seconds) return [text("cause.sign-of-life", { seconds: Number(seconds) })];
  const [, kind] = cause.match(ERROR) ?? [];
  if (kind) return [text(knows(`cause.${kind}`) ? `cause.${kind}` : "cause.error", { axis: axisOf(cause) ?? text("cause.machine") })];
  return cause === "" ? [] : knows(`cause.${cause}`) ? [word("cause", cause)] : [foreign(cause)];
}

// the same and, behind a summary, the sentence of an error
/** @param {string} cause */
export function causeWithDetails(cause) {
  if (!ERROR.test(cause)) return causeParts(cause);
  const details = element("details", element("summary", text("cause.details")));
  details.append(foreign(inPageUnits(cause)));
  return [...causeParts(cause), details];
}

// the axis that an error names, or undefined
/** @param {string} cause */
export const axisOf = (cause) => cause.match(ERROR)?.slice(2).find(Boolean);
