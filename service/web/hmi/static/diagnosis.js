// The diagnosis page: differences of model and measurement, missing effects, the next experiment.

import { address, all, call, get } from "./api.js";
import { byId, choices, complain, element, link, measured, row, tell } from "./elements.js";
import { clearExperiment, showExperiment, watchExperiment } from "./experiment.js";
import { drawFigures } from "./figures.js";
import { findingParts } from "./findings.js";
import { held } from "./intent.js";
import { watchMachine } from "./machine.js";
import { showMoving } from "./moving.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";
import { foreign, formula, joined, language, parts, text, word } from "./words.js";

const FINISHED = ["measured", "completed"];
const OPEN = ["waiting", "running"];

/** @type {Api.DiagnosisDocument | null} */
let shown = null; // the displayed diagnosis, with its document when it is done
/** @type {Api.CampaignDocument | undefined} */
let paused; // the paused campaign
let drawn = ""; // diagnosis and axis of the displayed figures

// -- the list, and a new one

/** @returns {Promise<[Api.CampaignDocument[], Api.DiagnosisEntry[]]>} */
async function showLists() {
  const [campaigns, diagnoses] = await Promise.all([all("/campaigns"), all("/diagnoses")]);
  paused = held(campaigns);
  await showMoving(campaigns, diagnoses);
  showEvidence(campaigns.filter((one) => FINISHED.includes(one.state)).reverse());
  await showModels();
  if (!location.hash && diagnoses.length) history.replaceState(null, "", `#${diagnoses.at(-1).id}`);
  byId("diagnoses").replaceChildren(...diagnoses.toReversed().map(listed));
  return [campaigns, diagnoses];
}

/** @param {Api.DiagnosisEntry} one */
function listed(one) {
  const line = row([
    [one.here ? "" : one.machine, "", link(one.id, `#${one.id}`)],
    [one.campaigns.join(", ")],
    [Object.entries(one.verdicts).map(([joint, verdict]) => `${joint}: ${word("verdict", verdict)}`).join(", "), "words"],
    [one.unattended ? text("diagnosis.alone", { state: stateOf(one) }) : stateOf(one)],
  ]);
  if (`#${one.id}` === location.hash) line.setAttribute("aria-current", "true");
  return line;
}

/** @param {{state: string}} diagnosis */
const stateOf = (diagnosis) => word("diagnosis-state", diagnosis.state);

/** @param {Api.CampaignDocument[]} campaigns */
function showEvidence(campaigns) {
  const chosen = evidence();
  const boxes = campaigns.map((one) => {
    const box = element("input");
    box.type = "checkbox";
    box.value = String(one.id);
    box.dataset.robot = String(one.robot_id);
    box.checked = chosen.some((other) => Number(other.value) === one.id);
    const label = element("label");
    const sweeps = Object.values(one.sweeps).reduce((sum, count) => sum + count, 0);
    label.append(box, ` ${text("diagnosis.evidence", { id: one.id, robot: one.robot_id, sweeps })}`);
    return label;
  });
  byId("evidence").replaceChildren(byId("evidence").firstElementChild, ...boxes);
  if (!boxes.length) byId("evidence").append(element("p", text("diagnosis.no-campaign"), "quiet"));
}

/** @returns {HTMLInputElement[]} */
const evidence = () => [...byId("evidence").querySelectorAll(/** @type {"input"} */ (":checked"))];

async function showModels() {
  const robot = evidence()[0]?.dataset.robot;
  const models = robot ? await all(`/models?robot=${robot}`) : [];
  choices(byId("model"), [["", text("diagnosis.no-model")], ...models.map((one) => [one.id, text("diagnosis.model", { revision: one.revision, by: one.accepted_by })])]);
}

async function start() {
  const campaigns = evidence().map((box) => Number(box.value)).sort((one, other) => one - other);
  const model = Number(byId("model").value) || null;
  const made = await call("POST", "/diagnoses", { campaigns, axes: null, model, start: byId("start").value });
  location.hash = `#${made.content.id}`;
}

// -- the displayed diagnosis

/** @param {[Api.CampaignDocument[], Api.DiagnosisEntry[]]} lists */
async function showDiagnosis([campaigns, diagnoses]) {
  const id = location.hash.slice(1);
  byId("shown").hidden = !id;
  if (!id) return;
  shown = await get(`/diagnoses/${id}`);
  const after = diagnoses.find((one) => one.parent === shown.id);
  tell("shown-title", text("diagnosis.title", { id: shown.id }));
  tell("shown-state", stateOf(shown));
  byId("shown-state").className = `badge ${shown.state}`;
  byId("shown-about").replaceChildren(...about(after));
  tell("shown-cause", shown.cause && foreign(shown.cause));
  const done = shown.state === "done";
  byId("report").hidden = !done;
  byId("report").href = address(`/diagnoses/${shown.id}/report.html`);
  byId("findings").hidden = byId("axis-choice").hidden = !done;
  if (done) choices(byId("axis"), Object.entries(shown.document.axes).map(([joint, axis]) => [joint, `${joint} (${word("verdict", axis.verdict)})`]));
  const campaign = campaigns.find((one) => one.id === shown.experiment?.campaign_id);
  await showAxis(campaign, after);
}

/** @param {number} id */
const diagnosisLink = (id) => link(text("about.diagnosis", { id }), `#${id}`);

/** @param {Api.DiagnosisEntry} [after] @returns {Part[]} */
function about(after) {
  /** @type {Part[][]} */
  const told = [[text("about.from", { campaigns: shown.campaigns.join(", ") })]];
  if (shown.model) told.push([text("about.model", { id: shown.model })]);
  if (shown.estimate) told.push([text("about.estimate", { id: shown.estimate.campaign_id, revision: shown.estimate.revision })]);
  if (shown.parent) told.push(parts("about.continues", { diagnosis: diagnosisLink(shown.parent) }));
  if (after) told.push(parts("about.continued", { diagnosis: diagnosisLink(after.id), state: stateOf(after) }));
  if (OPEN.includes(shown.state)) {
    const done = Object.keys(shown.verdicts).length;
    told.push([shown.axes.length ? text("about.done", { done, total: shown.axes.length }) : text("about.done-of-all", { done })]);
  }
  return joined(told, ", ");
}

/** @param {Api.CampaignDocument} [campaign] @param {Api.DiagnosisEntry} [after] */
async function showAxis(campaign, after) {
  const joint = byId("axis").value;
  const axis = shown.state === "done" ? shown.document.axes[joint] : null;
  if (!axis) {
    clearExperiment();
    byId("acceptance").hidden = byId("pictures").hidden = true;
    drawn = "";
    return;
  }
  tell("verdict", foreign(axis.summary));
  byId("verdict").className = `verdict ${axis.standing ?? "open"}`;
  const unfinished = (axis.unfinished ?? []).map((one) => ({ severity: /** @type {const} */ ("warning"), ...one }));
  byId("data").replaceChildren(...findingParts([...(axis.data ?? []), ...unfinished]));
  byId("effects").replaceChildren(...axis.effects.flatMap(effectParts));
  if (axis.verdict === "ambiguous") byId("effects").prepend(element("p", text("diagnosis.simplest")));
  showPart(axis.part ?? []);
  if (axis.law) byId("part").append(...formulaParts(text("diagnosis.law"), axis.law.sentence, axis.law.formula, axis.law.parameters));
  showRigidModel(axis);
  byId("untestable").textContent = notLookedAt(axis).join(" ");
  await showExperiment(shown, joint, axis.next_experiment, campaign, after);
  await showAcceptance(axis);
  const wanted = `${shown.id}/${joint}/${language()}`;
  if (wanted === drawn) return;
  const figures = await get(`/diagnoses/${shown.id}/figures`);
  drawn = wanted;
  byId("pictures").hidden = false;
  drawFigures(byId("pictures"), figures.axes[joint], axis);
}

/** @param {Api.AxisDiagnosis} axis */
function notLookedAt(axis) {
  const names = (/** @type {string[]} */ effects) => ({ effects: effects.map(effectName).join(", ") });
  return [
    hasNoiseFloor(axis.gap) ? "" : text("diagnosis.no-noise-floor"),
    axis.untestable.length ? text("diagnosis.untestable", names(axis.untestable)) : "",
    axis.biasing?.length ? text("diagnosis.biasing", names(axis.biasing)) : "",
  ];
}

/** @param {Api.AxisDiagnosis["gap"]} gap */
const hasNoiseFloor = (gap) => [gap, ...gap.by_pose].some((one) => one.noise_floor_rms !== null);

/** @param {string} effect */
const effectName = (effect) => word("effect", effect);

/** @param {Api.Value} value */
const significant = ({ value, std }) => std === null || std <= Math.abs(value) / 2;

/** @param {Api.Effect} effect */
const effectParts = (effect) => formulaParts(effectName(effect.effect), effect.sentence, effect.physics, effect.parameters);

// a coefficient of which the sweeps tell nothing is not shown
/** @param {string} title @param {string} told @param {string} physics @param {Record<string, Api.Value>} parameters */
function formulaParts(title, told, physics, parameters) {
  const heading = element("h3", title);
  const sentence = element("p", [foreign(told), " "]);
  sentence.append(element("code", physics));
  const table = element("table");
  const [shown, open] = [true, false].map((kind) => Object.entries(parameters).filter(([, value]) => significant(value) === kind));
  table.append(...shown.map(([name, value]) => row([
    [word("parameter", name)], [`${measured(value.std, value.value, value.std).join(" \u00b1 ")} ${value.unit.replace("^2", "\u00b2")}`, "number"],
  ])));
  const left = open.length ? [element("p", text("diagnosis.not-significant", { parameters: open.map(([name]) => word("parameter", name)).join(", ") }), "quiet")] : [];
  return [heading, sentence, table, ...left];
}

/** @param {Api.Effect[]} part */
function showPart(part) {
  byId("part").replaceChildren(...part.flatMap(effectParts));
  if (part.length) byId("part").prepend(element("p", text("diagnosis.in-part")));
}

// values that changed by more than their standard deviation are highlighted
/** @param {Api.AxisDiagnosis} axis */
function showRigidModel(axis) {
  const parameters = axis.rigid_model ?? [];
  byId("rigid-model").hidden = !parameters.length;
  tell("rigid-before", (axis.started_from ?? "cad") === "cad" ? "CAD" : text("diagnosis.estimate"));
  byId("rigid-parameters").replaceChildren(...parameters.map((one) => {
    const name = /^\w+$/.test(one.name) ? word("parameter", one.name) : formula(one.name);
    const line = row([
      [name, "words"], ...measured(one.std, one.nominal, one.value, one.std).map((shown) => [shown, "number"]),
    ]);
    if (one.nominal !== null && Math.abs(one.value - one.nominal) > one.std) line.className = "moved";
    return line;
  }));
}

// -- acceptance into the model

/** @param {Api.AxisDiagnosis} axis */
async function showAcceptance(axis) {
  const named = axis.verdict === "named" ? axis.effects.map((effect) => effectName(effect.effect)) : [];
  const changed = [...new Set((axis.changes ?? []).map((change) => text("accept.changed", { effect: effectName(change.effect) })))];
  const acceptable = named.length > 0 || (["none", "untestable"].includes(axis.verdict) && changed.length > 0);
  byId("acceptance").hidden = !acceptable;
  if (!acceptable) return;
  const models = (await all(`/models?robot=${shown.robot_id}`)).filter((one) => one.diagnosis_id === shown.id);
  byId("accept").hidden = models.length > 0;
  byId("accept-text").textContent = `${byId("axis").value}: ${[...named, ...changed].join(", ")}`;
  byId("accepted").replaceChildren(...models.flatMap((one) => [
    text("accept.done", { revision: one.revision, by: one.accepted_by }), " ",
    link(text("accept.scenario"), address(`/models/${one.id}/scenario.yaml`)),
    " ",
  ]));
}

async function accept() {
  await call("POST", `/diagnoses/${shown.id}/model`, { axes: [byId("axis").value], accepted_by: byId("accepted-by").value });
}

// -- event handlers

const refresh = refresher(async () => showDiagnosis(await showLists()));

// the button of a form is disabled while its request runs
/** @param {() => Promise<void>} run */
const submit = (run) => async (/** @type {SubmitEvent & {submitter: HTMLButtonElement}} */ event) => {
  event.preventDefault();
  event.submitter.disabled = true;
  try {
    await run();
    complain(null);
  } catch (error) {
    complain(error);
  } finally {
    event.submitter.disabled = false;
  }
  await refresh();
};

byId("new").addEventListener("submit", submit(start));
byId("evidence").addEventListener("change", () => showModels().catch(complain));
byId("axis").addEventListener("change", refresh);
byId("accept").addEventListener("submit", submit(accept));
window.addEventListener("hashchange", refresh);
watchExperiment(submit);

const stream = events();
stream.addEventListener("open", refresh); // events were possibly missed
for (const kind of ["campaign", "sweep", "check_move", "data_check", "diagnosis", "stop"]) stream.addEventListener(kind, refresh);
watchMachine(refresh, () => paused);
