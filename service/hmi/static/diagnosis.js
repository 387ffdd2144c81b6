// The diagnosis page: where model and measurement disagree, what is missing, what to measure next.

import { address, all, call, get } from "./api.js";
import { byId, choices, complain, element, link, number, plain, row } from "./elements.js";
import { clearExperiment, showExperiment, watchExperiment } from "./experiment.js";
import { drawFigures } from "./figures.js";
import { findingParts } from "./findings.js";
import { held } from "./intent.js";
import { identified } from "./login.js";
import { watchMachine } from "./machine.js";
import { showMoving } from "./moving.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";

const FINISHED = ["measured", "completed"];
const OPEN = ["waiting", "running"];
const NOTHING = 1e-6; // of a standard deviation: rounding

let shown = null; // the diagnosis on the page, with its document once it is done
let paused; // the campaign that waits for somebody
let drawn = ""; // diagnosis and axis of the figures on the page

// -- the list, and a new one

async function showLists() {
  const [campaigns, diagnoses] = await Promise.all([all("/campaigns"), all("/diagnoses")]);
  paused = held(campaigns);
  await showMoving(campaigns, diagnoses);
  showEvidence(campaigns.filter((one) => FINISHED.includes(one.state)).reverse());
  if (!location.hash && diagnoses.length) history.replaceState(null, "", `#${diagnoses.at(-1).id}`);
  byId("diagnoses").replaceChildren(...diagnoses.toReversed().map(listed));
  return [campaigns, diagnoses];
}

function listed(one) {
  const line = row([
    ["", "", link(one.id, `#${one.id}`)],
    [one.campaigns.join(", ")],
    [Object.entries(one.verdicts).map(([joint, verdict]) => `${joint}: ${verdict}`).join(", "), "words"],
    [one.state + (one.unattended ? ", runs alone" : "")],
  ]);
  if (`#${one.id}` === location.hash) line.setAttribute("aria-current", "true");
  return line;
}

function showEvidence(campaigns) {
  const chosen = evidence();
  const boxes = campaigns.map((one) => {
    const box = element("input");
    box.type = "checkbox";
    box.value = one.id;
    box.dataset.robot = one.robot_id;
    box.checked = chosen.some((other) => Number(other.value) === one.id);
    const label = element("label");
    const sweeps = Object.values(one.sweeps).reduce((sum, count) => sum + count, 0);
    label.append(box, ` ${one.id} (robot ${one.robot_id}, ${sweeps} sweeps)`);
    return label;
  });
  byId("evidence").replaceChildren(byId("evidence").firstElementChild, ...boxes);
  if (!boxes.length) byId("evidence").append(element("p", "no measured campaign yet", "quiet"));
}

const evidence = () => [...byId("evidence").querySelectorAll(":checked")];

async function showModels() {
  const robot = evidence()[0]?.dataset.robot;
  const models = robot ? await all(`/models?robot=${robot}`) : [];
  choices(byId("model"), [["", "none"], ...models.map((one) => [one.id, `revision ${one.revision}, accepted by ${one.accepted_by}`])]);
}

async function start() {
  const campaigns = evidence().map((box) => Number(box.value)).sort((one, other) => one - other);
  const model = Number(byId("model").value) || null;
  const made = await call("POST", "/diagnoses", { campaigns, axes: null, model, start: byId("start").value });
  location.hash = `#${made.content.id}`;
}

// -- the one shown

async function showDiagnosis([campaigns, diagnoses]) {
  const id = location.hash.slice(1);
  byId("shown").hidden = !id;
  if (!id) return;
  shown = await get(`/diagnoses/${id}`);
  const after = diagnoses.find((one) => one.parent === shown.id);
  byId("shown-title").textContent = `Diagnosis ${shown.id}`;
  byId("shown-state").textContent = shown.state;
  byId("shown-state").className = `badge ${shown.state}`;
  byId("shown-about").replaceChildren(...about(after));
  byId("shown-cause").textContent = shown.cause;
  const done = shown.state === "done";
  byId("report").hidden = !done;
  byId("report").href = address(`/diagnoses/${shown.id}/report.html`);
  byId("findings").hidden = byId("axis-choice").hidden = !done;
  if (done) choices(byId("axis"), Object.entries(shown.document.axes).map(([joint, axis]) => [joint, `${joint} (${axis.verdict})`]));
  const campaign = campaigns.find((one) => one.id === shown.experiment?.campaign_id);
  await showAxis(campaign, after);
}

function about(after) {
  const parts = [`from campaign ${shown.campaigns.join(", ")}`];
  if (shown.model) parts.push(`, starts from model ${shown.model}`);
  if (shown.estimate) parts.push(`, rigid model from the estimate of campaign ${shown.estimate.campaign_id}, revision ${shown.estimate.revision}`);
  if (shown.parent) parts.push(", continues ", link(`diagnosis ${shown.parent}`, `#${shown.parent}`));
  if (after) parts.push(", continued by ", link(`diagnosis ${after.id} (${after.state})`, `#${after.id}`));
  if (OPEN.includes(shown.state)) parts.push(`; ${Object.keys(shown.verdicts).length} of ${shown.axes.length || "all"} axes done`);
  return parts;
}

async function showAxis(campaign, after) {
  const joint = byId("axis").value;
  const axis = shown.state === "done" ? shown.document.axes[joint] : null;
  if (!axis) {
    clearExperiment();
    byId("acceptance").hidden = byId("pictures").hidden = true;
    drawn = "";
    return;
  }
  byId("verdict").textContent = axis.summary;
  byId("verdict").className = `verdict ${axis.verdict}`;
  byId("data").replaceChildren(...findingParts(axis.data ?? []));
  byId("effects").replaceChildren(...axis.effects.flatMap(effectParts));
  if (axis.verdict === "ambiguous") byId("effects").prepend(element("p", "The simplest explanation so far, not decided:"));
  showPart(axis.part ?? []);
  showRigidModel(axis);
  byId("untestable").textContent = axis.untestable.length ? `These sweeps cannot show: ${axis.untestable.map(plain).join(", ")}.` : "";
  await showExperiment(shown, joint, axis.next_experiment, campaign, after);
  await showAcceptance(axis);
  const wanted = `${shown.id}/${joint}`;
  if (wanted === drawn) return;
  drawn = wanted;
  const figures = await get(`/diagnoses/${shown.id}/figures`);
  byId("pictures").hidden = false;
  drawFigures(byId("pictures"), figures.axes[joint], axis);
}

function effectParts(effect) {
  const heading = element("h3", plain(effect.effect));
  const sentence = element("p", `${effect.sentence} `);
  sentence.append(element("code", effect.physics));
  const table = element("table");
  table.append(...Object.entries(effect.parameters).map(([name, value]) => row([
    [plain(name)], [`${number(value.value)} \u00b1 ${number(value.std && Number(value.std.toPrecision(2)))} ${value.unit}`, "number"],
  ])));
  return [heading, sentence, table];
}

function showPart(part) {
  byId("part").replaceChildren(...part.flatMap(effectParts));
  if (part.length) byId("part").prepend(element("p", "Known in part, beside a rest that no effect of the catalogue explains; the model stays what it was:"));
}

// what differs from before by more than its standard deviation stands out
function showRigidModel(axis) {
  const parameters = axis.rigid_model ?? [];
  byId("rigid-model").hidden = !parameters.length;
  byId("rigid-before").textContent = (axis.started_from ?? "cad") === "cad" ? "CAD" : "Estimate";
  byId("rigid-parameters").replaceChildren(...parameters.map((one) => {
    const shown = (value) => number(value !== null && Math.abs(value) < NOTHING * one.std ? 0 : value);
    const name = /^\w+$/.test(one.name) ? plain(one.name) : one.name;
    const line = row([
      [name, "words"], [shown(one.nominal), "number"], [shown(one.value), "number"],
      [number(one.std && Number(one.std.toPrecision(2))), "number"],
    ]);
    if (one.nominal !== null && Math.abs(one.value - one.nominal) > one.std) line.className = "moved";
    return line;
  }));
}

// -- into the model

async function showAcceptance(axis) {
  const named = axis.verdict === "named" ? axis.effects.map((effect) => plain(effect.effect)) : [];
  const changed = [...new Set((axis.changes ?? []).map((change) => `${plain(change.effect)} as it is now`))];
  const acceptable = named.length > 0 || (axis.verdict === "none" && changed.length > 0);
  byId("acceptance").hidden = !acceptable;
  if (!acceptable) return;
  const models = (await all(`/models?robot=${shown.robot_id}`)).filter((one) => one.diagnosis_id === shown.id);
  byId("accept").hidden = models.length > 0;
  byId("accept-text").textContent = `${byId("axis").value}: ${[...named, ...changed].join(", ")}`;
  byId("accepted").replaceChildren(...models.flatMap((one) => [
    `Revision ${one.revision} of the robot's model, accepted by ${one.accepted_by}. `,
    link("Scenario of the twin", address(`/models/${one.id}/scenario.yaml`)),
    " ",
  ]));
}

async function accept() {
  await call("POST", `/diagnoses/${shown.id}/model`, { axes: [byId("axis").value], accepted_by: byId("accepted-by").value });
}

// -- what happens when

const refresh = refresher(async () => showDiagnosis(await showLists()));

// a form's button is dead while its order is under way
const submit = (run) => async (event) => {
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
identified.then(showModels).catch(complain);

const stream = events();
stream.addEventListener("open", refresh); // whatever was missed meanwhile
for (const kind of ["campaign", "sweep", "check_move", "data_check", "diagnosis", "stop"]) stream.addEventListener(kind, refresh);
watchMachine(refresh, () => paused);
