// The cause of a stop or a refusal: its kind in the language of the page, and the text of the service.

import { foreign, knows, parts, text, word } from "./words.js";

// the reason that this page sends for a press of STOP; the audit stores it in this form, in every language of the page
export const PAGE = "operator page";
export const PRESSED = "stop button";

const STOPPED = /^stopped by (.+?): (.*)$/;
const KIND = /^(\w+): /;

// `by` and `why` of a stop
export const stopParts = (by, why) => parts("stop.by", { by: whose(by), why: why === PRESSED ? text("stop.button") : foreign(why) });

export const whose = (by) => (by === PAGE || by.endsWith(`(${PAGE})`) ? by.replace(PAGE, text("stop.page")) : by);

// of a campaign, a sweep or a diagnosis: who stopped it, the name of an error, or a sentence
export function causeParts(cause) {
  const [, by, why] = cause.match(STOPPED) ?? [];
  if (by !== undefined) return parts("cause.stopped", { by: whose(by), why: why === PRESSED ? text("stop.button") : foreign(why) });
  const kind = `cause.${cause.match(KIND)?.[1]}`;
  return cause === "" ? [] : knows(kind) ? parts(kind, { cause: foreign(cause) }) : known(cause);
}

const known = (cause) => (knows(`cause.${cause}`) ? [word("cause", cause)] : [foreign(cause)]);
