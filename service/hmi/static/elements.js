// Cells, numbers and choices of the pages.

import { Unknown } from "./api.js";

export const EMPTY = "\u2013";
export const byId = (id) => document.getElementById(id);

export function element(tag, text, kind) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

export function link(text, href) {
  const made = element("a", text);
  made.href = href;
  return made;
}

export function row(cells) {
  const tr = element("tr");
  for (const [text, kind, control] of cells) {
    const td = element("td", text, kind);
    if (control) td.append(" ", control);
    tr.append(td);
  }
  return tr;
}

export function number(value, unit = "") {
  return value === null || value === undefined ? EMPTY : `${Number(value.toPrecision(4))}${unit}`;
}

export function fixed(value, digits) {
  return value === null ? EMPTY : (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);
}

export function duration(seconds) {
  const whole = Math.round(seconds);
  const minutes = Math.floor(whole / 60);
  return minutes ? `${minutes} min ${whole % 60} s` : `${whole} s`;
}

export const plain = (name) => name.replaceAll("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck");

export function choices(select, entries) {
  const chosen = select.value;
  select.replaceChildren(...entries.map(([value, text]) => new Option(text, value)));
  if (entries.some(([value]) => String(value) === chosen)) select.value = chosen;
}

// a text that did not change is not written again: who listens to the page hears changes alone
export function tell(id, text) {
  if (byId(id).textContent !== text) byId(id).textContent = text;
}

export function complain(error) {
  if (error instanceof Unknown) return; // the head of the page asks who it is
  byId("error").hidden = !error;
  byId("error").textContent = error ? `${error.message}` : "";
}
