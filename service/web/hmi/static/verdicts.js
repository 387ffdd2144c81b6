// The verdict of an axis in the language of the page. The service's own sentence is in English only.

import { element, figure } from "./elements.js";
import { foreign, isMain, text, word } from "./words.js";

// parts: the sentence of the page, and the service's sentence if its language is different
/** @param {string} joint @param {Api.AxisDiagnosis} axis */
export function verdictParts(joint, axis) {
  if (isMain()) return [foreign(axis.summary)];
  return [text(`verdict-told.${kindOf(axis)}`, { joint, effects: effectsOf(axis), before: gapOf(axis, "before"), after: gapOf(axis, "after") }), " ", element("small", foreign(axis.summary))];
}

/** @param {Api.AxisDiagnosis} axis */
const kindOf = ({ verdict, data }) => ((data ?? []).some((one) => one.severity === "wrong") ? "wrong-data" : verdict);

/** @param {Api.AxisDiagnosis} axis */
function effectsOf({ verdict, effects, alternatives }) {
  const open = [...new Set((alternatives ?? []).flat())];
  const names = verdict === "ambiguous" && open.length ? open : effects.map((one) => one.effect);
  return names.map((name) => word("effect", name)).join(", ");
}

/** @type {(axis: Api.AxisDiagnosis, when: "before" | "after") => string} */
const gapOf = ({ gap, unit }, when) => text("verdict-gap", { rms: figure(gap[`${when}_rms`]), unit, percent: figure(gap[`${when}_percent`]) });
