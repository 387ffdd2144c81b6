// The texts of the pages in the language of the user; service/web/hmi/texts has one file per language.

import { TEXTS } from "./texts.js";

const KEPT = "sweepid-language"; // stored in this browser
const MAIN = "en"; // language of the service's texts
const ATTRIBUTES = ["title", "placeholder", "aria-label"];
const TINY = 1e-6; // values below are shown with an exponent

let now = preferred();

export const language = () => now;
export const isMain = () => now === MAIN;

function preferred() {
  const asked = [kept(KEPT), ...navigator.languages].map((tag) => tag?.split("-")[0]);
  return asked.find((tag) => Object.hasOwn(TEXTS, tag)) ?? MAIN;
}

// a browser may refuse to store data: then the page does not remember the language, but works
/** @param {string} name */
export function kept(name) {
  try {
    return localStorage.getItem(name);
  } catch {
    return null;
  }
}

/** @param {string} name @param {string} value */
export function store(name, value) {
  try {
    localStorage.setItem(name, value);
  } catch {
    // see above
  }
}

// -- texts

/** @type {(key: string, values: Values) => string} */
const template = (key, { count }) =>
  TEXTS[now][key] ?? TEXTS[now][`${key}.${new Intl.PluralRules(now).select(count ?? 0)}`] ?? key;

// strings and nodes; values: strings, numbers, nodes, errors, and lists of them
/** @type {(key: string, values?: Values) => Part[]} */
export const parts = (key, values = {}) =>
  template(key, values).split(/\{(\w+)\}/).flatMap((piece, k) => (k % 2 ? shown(values[piece]) : piece)).filter((piece) => piece !== "");

/** @type {(key: string, values?: Values) => string} */
export const text = (key, values) => parts(key, values).join("");

/** @param {any} value @returns {any} */
function shown(value) {
  if (Array.isArray(value)) return value.flatMap(shown);
  if (value instanceof Error) return told(value);
  if (value instanceof Node) return value.cloneNode(true);
  return typeof value === "number" ? decimal(value) : value;
}

/** @param {string} name */
export const plain = (name) => name.replaceAll("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck");

// text for a code of the service; an unknown code is shown unchanged
/** @type {(family: string, code: string) => string} */
export const word = (family, code) => TEXTS[now][`${family}.${code}`] ?? numbered(family, code) ?? plain(code);

// sine_24, sine_9.27: the text of the code, and its number
/** @param {string} family @param {string} code */
function numbered(family, code) {
  const [, stem, number] = code.match(/^(.+)_([\d.]+)$/) ?? [];
  const known = TEXTS[now][`${family}.${stem}`];
  return known && `${known} ${decimal(Number(number))}`;
}

// numbers as the user's country writes them: "mz(link_2) + 1,15 m(link_3)", "2.797.064"
/** @param {string} name */
export const formula = (name) => name.replace(/(?<![\d.])(\d+\.\d+(?![\d.])|(?<!,)\d{1,3}(,\d{3})+(?![\d.]|,\d))/g, (told) => decimal(Number(told.replaceAll(",", "")), { useGrouping: told.includes(",") }));

export const knows = (key) => Object.hasOwn(TEXTS[now], key);

/** @param {string} told */
const escaped = (told) => told.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
const DIMENSIONS = Object.entries(TEXTS[MAIN]).filter(([key]) => key.startsWith("said.d-")).map(([, told]) => escaped(told)).join("|");

// what the service says in words, with its values: a code and its template in each language
const SAID = Object.entries(TEXTS[MAIN]).filter(([key]) => /^(said|input|effect|effect-told|block|parameter)\./.test(key)).map(([key, told]) => {
  const pieces = told.split(/\{(\w+)\}/);
  const pattern = pieces.map((piece, k) => (k % 2 === 0 ? escaped(piece) : piece === "dimension" ? `(${DIMENSIONS}|.*?)` : "(.*?)")).join("");
  return { key, pattern: new RegExp(`^${pattern}$`, "s"), names: pieces.filter((_, k) => k % 2), fixed: pieces.filter((_, k) => k % 2 === 0).join("").length };
}).sort((one, other) => other.fixed - one.fixed); // the most special first
const OUTSIDE = ["system", "drive", "person", "file"]; // values that are quoted: their words are of another source
const JOINTS = [/(?<=[.!?]) /g, /; /g, /: /g, /, /g, / (?=and )/g, / (?=or )/g]; // of sentences, reasons, places and lists
/** @type {Map<string, Part[] | null>} */
const meanings = new Map();

// a sentence of the service: in the language of the page if the catalogue has it, otherwise as it is
/** @param {string} sentence */
export function foreign(sentence) {
  const made = document.createElement("span");
  const found = isMain() ? null : meant(sentence);
  if (found) made.append(...found.map((one) => (one instanceof Node ? one.cloneNode(true) : one)));
  else {
    made.lang = MAIN;
    made.textContent = sentence;
  }
  return made;
}

// the same as a string, for a figure
/** @param {string} told */
export const spoken = (told) => foreign(told).textContent;

// words of a person, of a drive or of the operating system: unchanged, in no language that is known
/** @param {string} source @param {string} told */
export const outside = (source, told) => (isMain() || meant(told) ? foreign(told) : quoted(source, told));

/** @param {string} source @param {string} told */
function quoted(source, told) {
  const made = document.createElement("q");
  made.lang = "";
  made.dataset.source = source;
  made.textContent = told;
  return made;
}

// null: the catalogue does not have all of it
/** @param {string} told @returns {Part[] | null} */
function meant(told) {
  const key = `${now} ${told}`;
  if (meanings.size > 5000) meanings.clear(); // values change
  if (!meanings.has(key)) meanings.set(key, read(told));
  return meanings.get(key);
}

/** @param {string} told @returns {Part[] | null} */
function read(told) {
  if (told.split("(").length !== told.split(")").length) return null; // cut within a value
  const [, of] = told.match(/^[A-Z][a-z]+(?:[A-Z][a-z]+)+: (.*)$/s) ?? []; // the class of an error: its code says it
  if (of) return meant(of);
  for (const { key, pattern, names } of SAID) {
    const found = told.match(pattern);
    if (!found) continue;
    const shown = found.slice(1).map((value, k) => (OUTSIDE.includes(names[k]) ? meantOrQuoted(names[k], value) : meant(value)));
    if (shown.every((one) => one !== null)) return parts(key, Object.fromEntries(names.map((name, k) => [name, shown[k]])));
  }
  for (const joint of JOINTS) {
    for (const { index, 0: between } of told.matchAll(joint)) {
      const [before, after] = [meant(told.slice(0, index)), meant(told.slice(index + between.length))];
      if (before && after) return [...before, between, ...after];
    }
  }
  const small = told.charAt(0).toLowerCase() + told.slice(1);
  if (small !== told && /^[A-Z][a-z]/.test(told) && SAID.some(({ pattern }) => pattern.test(small))) return meant(small);
  if (told.endsWith(".")) return meant(told.slice(0, -1))?.concat(".") ?? null;
  return /[a-z]{2,}\S? [a-z]{2,}|[:;] .*[a-z]{2}/i.test(told.replace(/\w*_\w*|'[^']*'|\x60[^\x60]*\x60/g, "")) ? null : [formula(told)];
}

/** @param {string} source @param {string} told @returns {Part[]} */
const meantOrQuoted = (source, told) => meant(told) ?? [quoted(source, told)];

/** @type {(list: (Part | Part[])[], between: string) => Part[]} */
export const joined = (list, between) => list.flatMap((one, k) => (k ? [between, one] : [one]).flat());

// -- errors

// error of the page itself
export class Told extends Error {
  constructor(key, values) {
    super(key);
    this.parts = () => parts(key, values);
  }
}

/** @type {(error: Error & {parts?: () => Part[]}) => Part[]} */
export const told = (error) => error.parts?.() ?? [foreign(error.message)];

// -- numbers and dates

// locale of the user's country, if the browser has one for the language of the page: en-GB, de-CH
const locale = () => navigator.languages.find((tag) => tag.split("-")[0] === now) ?? now;

/** @param {number} value @param {Intl.NumberFormatOptions} [form] */
export const decimal = (value, form = {}) => new Intl.NumberFormat(locale(), { useGrouping: false, maximumFractionDigits: 20, ...form }).format(value);

/** @param {number} value @param {number} count */
export function figures(value, count) {
  const rounded = Number(value.toPrecision(count));
  if (rounded === 0 || Math.abs(rounded) >= TINY) return decimal(rounded, { maximumSignificantDigits: count });
  const [mantissa, exponent] = rounded.toExponential().split("e");
  return `${decimal(Number(mantissa))}e${exponent}`;
}

// a time of the service, in the format of the user's country and time zone
export const moment = (at) => new Intl.DateTimeFormat(locale(), { dateStyle: "medium", timeStyle: "medium" }).format(new Date(at));

// for Plotly: decimal sign and thousands separator
export function separators() {
  const pieces = new Intl.NumberFormat(locale()).formatToParts(12345.6);
  return ["decimal", "group"].map((type) => pieces.find((piece) => piece.type === type).value).join("");
}

// -- the page

function translate() {
  document.documentElement.lang = now;
  for (const one of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-text]"))) one.textContent = text(one.dataset.text);
  for (const name of ATTRIBUTES) {
    for (const one of document.querySelectorAll(`[data-${name}]`)) one.setAttribute(name, text(one.getAttribute(`data-${name}`)));
  }
}

// `changed` draws the parts that scripts wrote again
/** @param {() => void} changed */
export function watchLanguage(changed) {
  const select = /** @type {HTMLSelectElement} */ (document.getElementById("language"));
  for (const [tag, texts] of Object.entries(TEXTS)) {
    const option = new Option(texts["language.name"], tag);
    option.lang = tag;
    select.append(option);
  }
  select.value = now;
  translate();
  select.addEventListener("change", () => {
    now = select.value;
    store(KEPT, now);
    translate();
    changed();
  });
}
