// Why a motion, a campaign or the machine stopped, and the next step: by its code, in the language and units of the page.

import { element } from "./elements.js";
import { figures, foreign, outside, parts, text } from "./words.js";

// the reason that this page sends for a press of STOP; the audit stores it in this form, in every language of the page
export const PAGE = "operator page";
export const PRESSED = "stop button";
const WATCH = "host watch"; // by which the service stops the machine itself

const WANTED = ["stopped", "paused", "aborted", "sweeps_skipped"]; // codes of what a person wanted
const DIGITS = [4, 15]; // significant, and the most that tell a value from its limit
/** @type {Record<string, [number, string]>} */
const UNITS = { rad: [180 / Math.PI, "\u00b0"], "rad/s": [180 / Math.PI, "\u00b0/s"], m: [1e3, " mm"], "m/s": [1e3, " mm/s"] };

/** @param {Api.StopDocument} stop */
export const stopParts = ({ by, why, cause }) => parts("stop.by", { by: whose(by), why: cause ? causeParts(cause) : reason(why) });

/** @param {string} by */
export const whose = (by) => (by === WATCH ? text("stop.watch") : by === PAGE || by.endsWith(`(${PAGE})`) ? by.replace(PAGE, text("stop.page")) : by);

/** @param {string} why */
const reason = (why) => (why === PRESSED ? text("stop.button") : outside("person", why));

// whether the headline tells it (no machine) or a banner (a stop)
/** @param {Api.Cause} cause @param {Machine} machine */
export const toldAbove = ({ code, joint }, { drives, stop }) =>
  [drives.connected ? null : drives.trouble_cause, ...stop.stops.map((one) => one.cause ?? { code: "stopped", joint })].some((one) => one?.code === code && one.joint === joint);

// whether nobody wanted it
/** @param {Api.Cause | null} cause */
export const byFault = (cause) => cause !== null && !WANTED.includes(cause.code);

/** @param {{joint?: string}} cause */
export const axisOf = (cause) => cause.joint || text("cause-of.machine");

/** @param {Api.Cause | null} cause @returns {Part[]} */
export function causeParts(cause) {
  if (cause === null) return [];
  const told = parts(`cause.${cause.code}`, { axis: axisOf(cause), by: whose(cause.by), why: reason(cause.detail) });
  const measured = measuredOf(cause);
  return measured ? [...told, ` (${measured})`] : told;
}

// the same and, behind a summary, the sentence of the service's log
/** @param {Api.Cause | null} cause */
export function causeWithDetails(cause) {
  if (!byFault(cause)) return causeParts(cause);
  const details = element("details", element("summary", text("cause-of.details")));
  details.append(foreign(cause.detail));
  return [...causeParts(cause), details];
}

// "-30.51°, limit -30.5°"
/** @param {Api.Cause} cause */
function measuredOf({ value, limit, unit }) {
  const [scale, name] = UNITS[unit] ?? [1, unit && ` ${unit}`];
  /** @param {number} one */
  const shown = (one) => figures(one * scale, digits);
  let [digits, most] = DIGITS;
  if (unit === "hex") return `${value.toString(16).toUpperCase().padStart(4, "0")}h`;
  if (value === null) return limit === null ? "" : text("cause-of.limit", { limit: shown(limit) + name });
  if (limit === null) return shown(value) + name;
  while (value !== limit && shown(value) === shown(limit) && digits < most) digits += 1;
  return text("cause-of.measured", { value: shown(value) + name, limit: shown(limit) + name });
}
