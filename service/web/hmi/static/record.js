// Model revisions and the audit: events and their authors.

import { all, get } from "./api.js";
import { byId, element, row } from "./elements.js";
import { mayNot } from "./login.js";
import { causeWithDetails, PRESSED, whose } from "./causes.js";
import { knows, moment, outside, parts, text, word } from "./words.js";

const API = "/api/v1";

/** @param {string} id @param {[string, string?][]} heads @param {HTMLTableRowElement[]} lines */
export function table(id, heads, lines) {
  const head = element("tr");
  head.append(...heads.map(([key, kind]) => element("th", text(key), kind)));
  byId(id).replaceChildren();
  byId(id).createTHead().append(head);
  byId(id).createTBody().append(...(lines.length ? lines : [row([[text("results.nothing"), "quiet"]])]));
}

/** @param {number} robot */
export async function showModels(robot) {
  const models = await all(`/models?robot=${robot}`);
  table("models", [["results.revision"], ["results.diagnosis"], ["results.accepted-by"], ["results.when"], ["results.effects"]], models.toReversed().map((one) => row([
    [one.revision], [one.diagnosis_id], [one.accepted_by], [moment(one.at)],
    [Object.entries(one.document.axes).map(([joint, { effects }]) => `${joint}: ${effects.map((effect) => word("effect", effect.effect)).join(", ")}`).join("; "), "words"],
  ])));
}

export async function showAudit() {
  const why = mayNot("GET /audit");
  byId("audit-why").textContent = why;
  if (why) return table("audit", [["results.when"]], []);
  const entries = (await get("/audit?newest=true&limit=200")).items.map((one) => /** @type {Record<string, string>} */ (one.entry));
  const done = entries.filter((one) => one.event !== "request").toReversed();
  table("audit", [["results.when"], ["results.who"], ["results.what"], ["results.outcome"]], done.map((one) => row([
    [moment(one.at)], [whose(one.by ?? one.actor)], [whatOf(one), "words"], [outcomeOf(one), "words"],
  ])));
}

// the action of an audit entry, as text if the page has a translation
/** @param {Record<string, string>} entry */
function whatOf({ method, path, route, event }) {
  const code = route ? [method, route.replace(API, "")].join(" ") : event;
  const key = `done.${code}`;
  if (!knows(key)) return `${method ?? ""} ${path ?? event}`.trim();
  return parts(key, { id: path?.match(/\/(\d+)(\/|$)/)?.[1], joint: path?.split("/").at(-2) });
}

/** @param {Record<string, string>} entry @returns {Content} */
function outcomeOf({ status, why, code, joint }) {
  if (code) return causeWithDetails({ code: /** @type {Api.CauseCode} */ (code), joint, detail: why, by: "", unit: "", value: null, limit: null });
  if (status === undefined) return why === PRESSED ? text("stop.button") : outside("person", why ?? "");
  return Number(status) < 400 ? text("results.done") : text("results.refused", { status });
}
