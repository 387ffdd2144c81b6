// Table cells, numbers and select elements of the pages.

import { Unknown } from "./api.js";
import { decimal, figures, text, told } from "./words.js";

export const EMPTY = "\u2013";
const MINUS = "\u2212";
/** @type {(id: string) => Control} */
export const byId = (id) => /** @type {any} */ (document.getElementById(id));

/** @type {Error | null} */
let complaint = null; // the displayed error

/** @template {keyof HTMLElementTagNameMap} T @param {T} tag @param {Content} [content] @param {string} [kind] @returns {HTMLElementTagNameMap[T]} */
export function element(tag, content, kind) {
  const made = document.createElement(tag);
  if (content !== undefined) made.append(...(/** @type {Part[]} */ ([content].flat())));
  if (kind) made.className = kind;
  return made;
}

/** @param {Content} content @param {string} href */
export function link(content, href) {
  const made = element("a", content);
  made.href = href;
  return made;
}

/** @param {any[][]} cells */
export function row(cells) {
  const tr = element("tr");
  for (const [content, kind, control] of cells) {
    const td = element("td", content, kind);
    if (control) td.append(" ", control);
    tr.append(td);
  }
  return tr;
}

export const number = (value, unit = "") => (value === null || value === undefined ? EMPTY : `${figures(value, 4)}${unit}`);

// three significant digits
export const figure = (value) => (value === null || value === undefined ? EMPTY : figures(value, 3));

// a standard deviation in percent: two figures, as everywhere
/** @param {number | null} percent */
export const confidence = (percent) => (percent === null ? EMPTY : `${figures(percent, 2)} %`);

/** @param {number | null} value @param {number} digits */
export function fixed(value, digits) {
  if (value === null) return EMPTY;
  const shown = Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value;
  return decimal(shown, { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

/** @param {number} value */
const powerOf = (value) => Number(value.toExponential().split("e")[1]);

/** @param {number} value @param {number} digits */
function exponential(value, digits) {
  const [mantissa, power] = value.toExponential(digits).split("e");
  return `${fixed(Number(mantissa), digits)}e${power.replace(/\d+/, (one) => one.padStart(2, "0"))}`;
}

// as `with_std` of reports and sheets: all values end at the second figure of their standard deviation; without one, five
/** @param {number | null} std @param {(number | null)[]} values */
export function measured(std, ...values) {
  if (!(std > 0)) return values.map((value) => (typeof value === "number" ? minus(figures(value, 5)) : EMPTY));
  const last = 1 - powerOf(Number(std.toPrecision(2)));
  if (last > 7) return values.map((one) => (typeof one === "number" ? minus(exponential(one, Math.max(one === std ? 1 : 0, last + powerOf(one)))) : EMPTY));
  const step = 10 ** -Math.min(0, last); // above 1 for a deviation of 100 or more
  /** @param {number} one */
  const rounded = (one) => (step > 1 ? Math.round(one / step) * step : one);
  return values.map((one) => minus(fixed(typeof one === "number" ? rounded(one) : null, Math.max(0, last))));
}

/** @param {Api.EstimateDocument} estimate */
export function estimateTold({ revision, number: sweep, document: { condition_number: value } }) {
  return text("estimate.told", { revision, sweep, condition: value === null ? "" : text("estimate.condition", { value: figures(value, 3) }) });
}

// what the accepted effects of the model did to this estimate, axis by axis
/** @param {Api.Estimate | undefined} found */
export const effectsTold = (found) => Object.entries(found?.axes ?? {}).filter(([, { effects_moved_in_std: by }]) => typeof by === "number")
  .map(([axis, { effects_moved_in_std: by }]) => text("results.moved", { axis, by: figures(by, 2) }));

/** @param {string} told */
export const minus = (told) => told.replace("-", MINUS);

export function duration(seconds) {
  const whole = Math.round(seconds);
  const minutes = Math.floor(whole / 60);
  return minutes ? `${minutes} min ${whole % 60} s` : `${whole} s`;
}

/** @param {HTMLSelectElement | Control} select @param {any[][]} entries */
export function choices(select, entries) {
  const chosen = select.value;
  select.replaceChildren(...entries.map(([value, name]) => new Option(String(name), value)));
  if (entries.some(([value]) => String(value) === chosen)) select.value = chosen;
}

// unchanged content is not written again: a screen reader reads changes only
/** @param {string} id @param {Content} content */
export function tell(id, content) {
  const made = element("p", content);
  if (byId(id).innerHTML !== made.innerHTML) byId(id).replaceChildren(...made.childNodes);
}

/** @param {Error | null} error */
export function complain(error) {
  if (error instanceof Unknown) return; // the head of the page asks for the login
  complaint = error;
  byId("error").hidden = !error;
  tell("error", error ? told(error) : "");
}

export const complainAgain = () => complain(complaint);
