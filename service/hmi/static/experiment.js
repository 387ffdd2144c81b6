// The next experiment: what would move, how far and how long; it starts with a second click and a name.

import { call, get } from "./api.js";
import { byId, duration, element, link, plain, row } from "./elements.js";

const MM = 1e-3;

let asked = null; // {diagnosis, joint, kind, cell} of the panel
let scale = null; // of each joint's position: {factor, unit}

export function clearExperiment() {
  byId("experiment").hidden = true;
  byId("prepared").hidden = true;
  asked = null;
}

// campaign: that of the experiment approved last, after: the diagnosis that went on with it, or undefined
export async function showExperiment(diagnosis, joint, experiment, campaign, after) {
  if (!experiment) {
    clearExperiment();
    return;
  }
  const same = asked?.diagnosis === diagnosis.id && asked.joint === joint;
  asked = { diagnosis: diagnosis.id, joint, kind: experiment.kind, cell: same ? asked.cell : null };
  scale = await scales(diagnosis.robot_id);
  if (!same) byId("prepared").hidden = true;
  byId("experiment").hidden = false;
  byId("experiment-text").textContent =
    `${plain(experiment.kind)}: ${experiment.reason} About ${duration(experiment.seconds)} of machine time.`;
  byId("experiment-way").textContent = wayInWords(joint, experiment.sweeps);
  const over = !campaign || campaign.state === "aborted";
  byId("prepare").hidden = Boolean(after) || !over;
  if (byId("prepare").hidden) byId("prepared").hidden = true;
  byId("experiment-done").replaceChildren(...(campaign ? approved(diagnosis.experiment, campaign, after) : []));
}

function approved({ axis, approved_by }, campaign, after) {
  const told = [`Approved by ${approved_by} for ${axis}: `, link(`campaign ${campaign.id}`, `./#campaign-${campaign.id}`), `, ${campaign.state}.`];
  if (campaign.state !== "aborted" && !after) told.push(" When it is completed, the diagnosis goes on by itself.");
  return told;
}

export function watchExperiment(submit) {
  byId("prepare").addEventListener("submit", submit(prepare));
  byId("approve").addEventListener("submit", submit(approve));
}

async function prepare() {
  const { diagnosis, joint, kind } = asked;
  asked.cell = byId("cell").value || null;
  const plan = (await call("POST", `/diagnoses/${diagnosis}/plan`, { axis: joint, cell: asked.cell })).content.document;
  byId("prepared-text").textContent =
    `${plan.sweeps.length} sweeps, ${duration(plan.duration)} with all moves between poses. ` +
    plan.dropped.map((one) => `Left out: ${one.reason}.`).join(" ");
  byId("prepared-ways").replaceChildren(...ways(plan.sweeps).map((text) => element("li", text)));
  byId("prepared-sweeps").replaceChildren(...grouped(plan.sweeps).map(line));
  byId("mass").hidden = kind !== "test_mass";
  for (const input of byId("mass").querySelectorAll("input")) input.required = kind === "test_mass";
  byId("prepared").hidden = false;
}

async function approve() {
  const { diagnosis, joint, kind, cell } = asked;
  const approval = { axis: joint, cell, approved_by: byId("approved-by").value, test_mass: kind === "test_mass" ? mass() : null };
  byId("prepared").hidden = true; // one approval, one motion
  await call("POST", `/diagnoses/${diagnosis}/experiment`, approval);
}

function mass() {
  const value = (id) => {
    const told = Number(byId(id).value.replace(",", "."));
    if (byId(id).value.trim() === "" || !Number.isFinite(told)) throw new Error(`${byId(id).value || "nothing"} is not a number`);
    return told;
  };
  return {
    mass: value("mass-kg"),
    center: ["mass-x", "mass-y", "mass-z"].map((id) => value(id) * MM),
    inertia: [value("mass-xx"), 0, value("mass-yy"), 0, 0, value("mass-zz")],
  };
}

// -- motion in words

async function scales(robot) {
  const { description, urdf_text } = await get(`/robots/${robot}`);
  const urdf = new DOMParser().parseFromString(urdf_text, "application/xml");
  const prismatic = new Set([...urdf.querySelectorAll('joint[type="prismatic"]')].map((joint) => joint.getAttribute("name")));
  const of = (joint) => prismatic.has(joint) ? { factor: 1e3, unit: " mm" } : { factor: 180 / Math.PI, unit: "\u00b0" };
  return Object.fromEntries(description.axes.map((axis) => [axis.joint, of(axis.joint)]));
}

function length(joint, value, signed = false) {
  const shown = Number((value * scale[joint].factor).toPrecision(3));
  return `${signed && shown > 0 ? "+" : ""}${shown}${scale[joint].unit}`.replace("-", "\u2212");
}

// from standstill to standstill; the sines swing about that way
function travel({ spec, ramp, settle }) {
  return spec.offset_velocity * (ramp + settle + (spec.period ?? 0) * (spec.periods ?? 0));
}

function swing({ spec }) {
  return spec.sines.reduce((sum, sine) => sum + sine.amplitude / (2 * Math.PI * sine.frequency), 0);
}

function topSpeed({ spec }) {
  return Math.abs(spec.offset_velocity) + spec.sines.reduce((sum, sine) => sum + sine.amplitude, 0);
}

function wayInWords(joint, sweeps) {
  if (!sweeps.length) return "";
  const poses = new Set(sweeps.map((sweep) => sweep.spec.pose.join())).size;
  const most = Math.max(...sweeps.map((sweep) => Math.abs(travel(sweep)) + swing(sweep)));
  const speed = Math.max(...sweeps.map(topSpeed));
  return `${joint} turns in ${sweeps.length} sweeps, up to ${length(joint, most)} from the pose and back, at most ` +
    `${length(joint, speed)}/s. The robot first goes to ${poses === 1 ? "its pose" : `each of ${poses} poses`}, joint by joint.`;
}

function ways(sweeps) {
  const reached = new Map();
  for (const leg of sweeps.flatMap((sweep) => sweep.legs)) {
    const [low, high] = reached.get(leg.joint) ?? [Infinity, -Infinity];
    reached.set(leg.joint, [Math.min(low, leg.target), Math.max(high, leg.target)]);
  }
  const between = [...reached].map(([joint, [low, high]]) => low === high
    ? `${joint} is moved to ${length(joint, low)} between sweeps`
    : `${joint} is moved between ${length(joint, low)} and ${length(joint, high)} from sweep to sweep`);
  return between.concat("Before its first motion each axis makes its check move: half a degree (or a small way) and back.");
}

function grouped(sweeps) {
  const groups = [];
  for (const sweep of sweeps) {
    const last = groups.at(-1);
    const same = last && last[0].spec.block === sweep.spec.block && last[0].spec.pose.join() === sweep.spec.pose.join();
    if (same) last.push(sweep);
    else groups.push([sweep]);
  }
  return groups;
}

function line(sweeps) {
  const [first] = sweeps;
  const { spec } = first;
  const joints = Object.keys(scale);
  const goes = Math.abs(travel(first)) > swing(first) ? length(spec.axis, travel(first), true) : swing(first) ? `\u00b1${length(spec.axis, swing(first))}` : "stands";
  return row([
    [spec.pose.map((position, k) => length(joints[k], position)).join(", "), "words"],
    [plain(spec.block ?? "sweep")],
    [sweeps.length, "number"],
    [length(spec.axis, spec.pose[joints.indexOf(spec.axis)]), "number"],
    [goes, "number"],
    [`${length(spec.axis, topSpeed(first))}/s`, "number"],
    [duration(sweeps.reduce((sum, sweep) => sum + sweep.duration, 0)), "number"],
  ]);
}
