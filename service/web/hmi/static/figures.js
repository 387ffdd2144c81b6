// The report's figures in the colours of the page.

import { clear, draw } from "./drawing.js";
import { element } from "./elements.js";
import { foreign, isMain, separators, spoken, text, word } from "./words.js";

const KEPT = ["type", "mode", "orientation", "color", "symbol", "anchor", "xanchor", "yanchor", "xref", "yref", "dash", "shape", "rangemode", "barmode", "textposition", "hoverinfo", "autorange", "align", "hovermode"];
const GRID = "rgba(128,128,128,.25)";

/** @param {HTMLElement} place @param {Record<string, Api.PlotlyFigure>} figures @param {Api.AxisDiagnosis} axis */
export function drawFigures(place, figures, axis) {
  for (const old of place.querySelectorAll(".figure")) clear(old);
  place.replaceChildren();
  for (const [name, figure] of Object.entries(figures)) {
    place.append(element("h2", word("figure", name)));
    if (name === "map") place.append(...sentencesOf(axis).map((sentence) => element("p", foreign(sentence))));
    if (name === "evidence") place.append(element("p", text("figure-caption.evidence")));
    const plot = element("div", undefined, "figure");
    plot.id = `figure-${name}`;
    plot.style.height = `${figure.layout.height}px`;
    const scroll = element("div", undefined, "scroll");
    scroll.append(plot);
    place.append(scroll);
    draw(plot, inWords(figure.data), inColours(inWords(figure.layout)));
  }
}

// texts of the service, hover templates included: a template's own words stand between its values
/** @template T @param {T} part @returns {T} */
function inWords(part) {
  if (isMain()) return part;
  if (Array.isArray(part)) return /** @type {any} */ (part.map(inWords));
  if (part && typeof part === "object") return /** @type {any} */ (Object.fromEntries(Object.entries(part).map(([key, value]) => [key, KEPT.includes(key) ? value : inWords(value)])));
  return /** @type {any} */ (typeof part === "string" ? spoken(part) : part);
}

// sentences without the findings of the data check, which are displayed above
/** @param {Api.AxisDiagnosis} axis */
function sentencesOf(axis) {
  const told = new Set((axis.data ?? []).map((finding) => finding.sentence));
  return axis.sentences.filter((sentence) => !told.has(sentence));
}

/** @param {Record<string, any>} layout */
function inColours(layout) {
  const ink = getComputedStyle(document.body).color;
  const axes = Object.entries(layout).filter(([key]) => /^[xy]axis\d*$/.test(key));
  return {
    ...layout,
    separators: separators(),
    ...Object.fromEntries(axes.map(([key, axis]) => [key, { ...axis, gridcolor: GRID }])),
    font: { ...layout.font, color: ink },
    paper_bgcolor: "transparent",
    plot_bgcolor: "transparent",
  };
}
