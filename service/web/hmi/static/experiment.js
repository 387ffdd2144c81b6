// The next experiment: its motion, distance and duration; it starts after a second click and with a name.

import { call, get } from "./api.js";
import { byId, duration, link, tell } from "./elements.js";
import { posesOf, showMotion, swing, topSpeed, travel, unitsOf } from "./motion.js";
import { aheadOf, askNames, machineHere, typedNames } from "./subject.js";
import { foreign, parts, text, Told, word } from "./words.js";

const MM = 1e-3;

/** @type {{diagnosis: number, joint: string, kind: string, cell: string | null, names: "" | `?${string}`, seen: Api.Ahead["range"] | null} | null} */
let asked = null; // of the panel; names: the typed ones, as a query
/** @type {Units | null} */
let units = null; // of its robot
/** @type {{id: number, name: string} | null} */
let robot = null;
/** @type {Here | null} */
let machine = null; // of this service

export function clearExperiment() {
  byId("experiment").hidden = true;
  byId("prepared").hidden = true;
  asked = null;
}

// campaign: that of the last approved experiment; after: the diagnosis that continued with it, or undefined
/** @param {Api.DiagnosisDocument} diagnosis @param {string} joint @param {Api.Experiment | null} experiment @param {Api.CampaignDocument} [campaign] @param {Api.DiagnosisEntry} [after] */
export async function showExperiment(diagnosis, joint, experiment, campaign, after) {
  if (!experiment) {
    clearExperiment();
    return;
  }
  const same = asked?.diagnosis === diagnosis.id && asked.joint === joint;
  asked = { ...(same ? asked : { cell: null, names: "", seen: null }), diagnosis: diagnosis.id, joint, kind: experiment.kind };
  [units, machine] = await Promise.all([unitsOf(diagnosis.robot_id), machineHere()]);
  robot = { id: diagnosis.robot_id, name: units.robot };
  showConfirm();
  if (!same) byId("prepared").hidden = true;
  byId("experiment").hidden = false;
  tell("experiment-text", parts("experiment.told", {
    kind: word("block", experiment.kind), reason: foreign(experiment.reason), time: duration(experiment.seconds),
  }));
  byId("experiment-way").textContent = wayInWords(joint, experiment.sweeps);
  const over = !campaign || campaign.state === "aborted";
  byId("prepare").hidden = Boolean(after) || !over;
  if (byId("prepare").hidden) byId("prepared").hidden = true;
  byId("experiment-done").replaceChildren(...(campaign ? approved(diagnosis.experiment, campaign, after) : []));
}

/** @param {Api.ExperimentDocument} experiment @param {Api.CampaignDocument} campaign @param {Api.DiagnosisEntry} [after] */
function approved({ axis, approved_by }, campaign, after) {
  const told = parts("experiment.approved", {
    by: approved_by, axis, campaign: link(text("experiment.campaign", { id: campaign.id }), `./#campaign-${campaign.id}`),
    state: word("campaign-state", campaign.state),
  });
  if (campaign.state !== "aborted" && !after) told.push(" ", text("experiment.goes-on"));
  return told;
}

const showConfirm = () => askNames(machine, robot, byId("cell").value || machine.cell);

/** @param {(run: () => Promise<void>) => (event: Event) => void} submit */
export function watchExperiment(submit) {
  byId("cell").addEventListener("change", () => machine && showConfirm());
  byId("prepare").addEventListener("submit", submit(prepare));
  byId("approve").addEventListener("submit", submit(approve));
}

async function prepare() {
  const { diagnosis, joint, kind } = asked;
  asked.cell = byId("cell").value || null;
  asked.names = typedNames();
  const { id, document: plan } = (await call("POST", `/diagnoses/${diagnosis}/plan${asked.names}`, { axis: joint, cell: asked.cell })).content;
  const ahead = await aheadOf(`/plans/${id}/ahead`);
  asked.seen = ahead?.range ?? null;
  showMotion(byId("motion"), plan, units, await get("/drives"), ahead);
  byId("mass").hidden = kind !== "test_mass";
  for (const input of byId("mass").querySelectorAll("input")) input.required = kind === "test_mass";
  byId("prepared").hidden = false;
}

async function approve() {
  const { diagnosis, joint, kind, cell, names, seen } = asked;
  const approval = { axis: joint, cell, seen, approved_by: byId("approved-by").value, test_mass: kind === "test_mass" ? mass() : null };
  byId("prepared").hidden = true; // one approval allows one motion
  await call("POST", `/diagnoses/${diagnosis}/experiment${names}`, approval);
}

function mass() {
  const value = (id) => {
    const told = Number(byId(id).value.replace(",", "."));
    if (byId(id).value.trim() === "" || !Number.isFinite(told)) throw byId(id).value ? new Told("mass.no-number", { given: byId(id).value }) : new Told("mass.nothing");
    return told;
  };
  return {
    mass: value("mass-kg"),
    center: ["mass-x", "mass-y", "mass-z"].map((id) => value(id) * MM),
    inertia: [value("mass-xx"), 0, value("mass-yy"), 0, 0, value("mass-zz")],
  };
}

// before the plan exists
/** @param {string} joint @param {Api.ExperimentSweep[]} sweeps */
function wayInWords(joint, sweeps) {
  if (!sweeps.length) return "";
  const { length } = units;
  const poses = posesOf(sweeps);
  const most = Math.max(...sweeps.map((sweep) => Math.abs(travel(sweep)) + swing(sweep)));
  const speed = Math.max(...sweeps.map(topSpeed));
  const turns = text("experiment.turns", { joint, sweeps: sweeps.length, way: length(joint, most), speed: `${length(joint, speed)}/s` });
  return `${turns} ${text("experiment.goes-to", { count: poses })}`;
}
