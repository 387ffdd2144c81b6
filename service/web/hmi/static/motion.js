// The motion of a plan, as text and as a table, next to the button that starts it.

import { all, get } from "./api.js";
import { duration, element, minus, row } from "./elements.js";
import { subjectParts } from "./subject.js";
import { figures, foreign, moment, parts, text, word } from "./words.js";

const COLUMNS = [["pose"], ["axis"], ["block"], ["sweeps", "number"], ["from", "number"], ["goes", "number"], ["speed", "number"], ["time", "number"]];

const BUS_LIMIT = 70; // percent: the drivers refuse a higher load

/** @type {Map<number, Units>} */
const known = new Map(); // by robot

// {robot, joints, length}: its name, names in the order of a pose, and a function that formats positions (rad, m) for an operator
/** @param {number} robot @returns {Promise<Units>} */
export async function unitsOf(robot) {
  if (!known.has(robot)) known.set(robot, await read(robot));
  return known.get(robot);
}

// units of the robot with the joints of the drives, if no campaign names the robot; null: no such robot
/** @param {Api.DrivesView} drives */
export async function unitsOfMachine({ axes }) {
  const joints = axes.map((axis) => axis.joint).join();
  for (const { id } of (await all("/robots")).toReversed()) {
    const units = await unitsOf(id);
    if (units.joints.join() === joints) return units;
  }
  return null;
}

/** @param {number} robot @returns {Promise<Units>} */
async function read(robot) {
  const { description, urdf_text } = await get(`/robots/${robot}`);
  const urdf = new DOMParser().parseFromString(urdf_text, "application/xml");
  const prismatic = new Set([...urdf.querySelectorAll('joint[type="prismatic"]')].map((joint) => joint.getAttribute("name")));
  /** @returns {[number, string]} */
  const scale = (/** @type {string} */ joint) => (prismatic.has(joint) ? [1e3, " mm"] : [180 / Math.PI, "\u00b0"]);
  const length = (/** @type {string} */ joint, /** @type {number} */ value, signed = false) => {
    const [factor, unit] = scale(joint);
    const shown = figures(value * factor, 3);
    return minus(`${signed && value > 0 ? "+" : ""}${shown}${unit}`);
  };
  return { robot: description.name, joints: description.axes.map((axis) => axis.joint), length, scale, prismatic };
}

// the present and next motion as text: "joint_2 travels to -40 deg, then joint_3 sweeps, 12 s"
/** @param {Api.StepView[]} steps @param {Units} units */
export function inWords(steps, { length }) {
  return steps.map(({ kind, axes, target, seconds }) => {
    const [axis] = axes;
    if (kind === "travel") return text("motion.travels", { axis, to: length(axis, target) });
    if (kind === "check_move") return text("motion.checks", { axis });
    return text(axes.length > 1 ? "motion.at-once" : "motion.sweeps", { axes: axes.join(", "), time: duration(seconds) });
  }).reduce((first, next) => text("motion.then", { first, next }));
}

// drives, ahead: as in the API; null if not known
/** @param {HTMLElement} place @param {Planned} plan @param {Units} units @param {Api.DrivesView | null} [drives] @param {Api.Ahead | null} [ahead] */
export function showMotion(place, plan, units, drives = null, ahead = null) {
  const list = element("ul");
  list.append(...ways(plan, units, ahead?.range).concat(text("motion.check-moves"), bus(plan, drives)).map((way) => element("li", way)));
  const scroll = element("div", undefined, "scroll");
  scroll.tabIndex = 0; // a person without a mouse scrolls it
  scroll.append(table(plan, units));
  const before = ahead ? [element("p", subjectParts(ahead.subject), "subject"), element("p", approach(ahead, units), "approach")] : [];
  place.replaceChildren(...before, element("p", size(plan)), list, scroll);
}

// from where the axes stand to the first pose
/** @param {Api.Ahead} ahead @param {Units} units @returns {Content} */
function approach({ trouble, at, positions, approach: legs }, { length }) {
  if (trouble) return parts("motion.approach-unknown", { why: foreign(trouble) });
  if (!legs.length) return text("motion.approach-none", { at: moment(at) });
  const here = { ...positions };
  const moves = legs.map(({ joint, target }) => {
    const from = here[joint];
    here[joint] = target;
    return text("motion.approach-leg", { joint, from: length(joint, from), to: length(joint, target) });
  });
  return text("motion.approach", { at: moment(at), moves: moves.join(", ") });
}

// -- one sweep, from standstill to standstill; the sines oscillate about the constant velocity

/** @param {Swept} sweep */
export function travel({ spec, ramp, settle }) {
  return spec.offset_velocity * (ramp + settle + (spec.period ?? 0) * (spec.periods ?? 0));
}

/** @param {Swept} sweep */
export function swing({ spec }) {
  return spec.sines.reduce((sum, sine) => sum + sine.amplitude / (2 * Math.PI * sine.frequency), 0);
}

// noise has no set-point: the velocity limit applies
/** @param {Swept & {velocity_limit: number}} sweep */
export function topSpeed({ spec, velocity_limit }) {
  if (spec.excitation === "noise") return velocity_limit;
  return Math.abs(spec.offset_velocity) + spec.sines.reduce((sum, sine) => sum + sine.amplitude, 0);
}

/** @param {Swept[]} sweeps */
export const posesOf = (sweeps) => new Set(sweeps.map((sweep) => sweep.spec.pose.join())).size;

// -- all sweeps

/** @param {Planned} plan */
function size(plan) {
  const axes = [...new Set(plan.sweeps.map((sweep) => sweep.spec.axis))].join(", ");
  const sweeps = text("motion.count-sweeps", { count: plan.sweeps.length });
  const poses = text("motion.count-poses", { count: posesOf(plan.sweeps) });
  const size = parts("motion.size", { robot: plan.robot, sweeps, axes, poses, time: duration(plan.duration) });
  return size.concat(...(plan.dropped ?? []).map((one) => [" ", ...parts("motion.left-out", { reason: foreign(one.reason) })]));
}

// bus load, if the host streams the set-points; sweeps of one block in one pose move their axes at the same time
/** @param {Planned} plan @param {Api.DrivesView | null} drives */
function bus({ sweeps }, drives) {
  const streamed = sweeps.filter((sweep) => "mode" in sweep && sweep.mode === "host_streamed");
  if (!streamed.length) return text("bus.drives");
  const together = Map.groupBy(streamed, ({ spec }) => `${spec.started_at}/${spec.block}/${spec.pose}`);
  const axes = Math.max(...[...together.values()].map((group) => new Set(group.map(({ spec }) => spec.axis)).size));
  const load = drives?.capabilities?.bus_load[axes - 1];
  if (load === undefined) return text("bus.unknown");
  return text("bus.load", { percent: Math.round(100 * load), limit: BUS_LIMIT, rate: drives.capabilities.bus_bitrate / 1000, count: axes });
}

// a sweep is stopped at its window: this is the largest motion of an axis; range: as told by the service, with the approach
/** @param {Planned} plan @param {Units} units @param {Api.Ahead["range"]} [range] */
function ways({ sweeps, request }, { joints, length }, range = {}) {
  const legs = sweeps.flatMap((sweep) => sweep.legs);
  return joints.flatMap((joint) => {
    const own = sweeps.filter((sweep) => sweep.spec.axis === joint);
    const targets = legs.filter((leg) => leg.joint === joint).map((leg) => leg.target);
    const [least, most] = range[joint] ?? [0, 0];
    const approached = least !== most;
    const reached = [...targets, ...own.flatMap((sweep) => sweep.position_window), ...(approached ? [least, most] : [])];
    if (!reached.length) return [];
    const speed = Math.max(targets.length || approached ? request.move_velocity : 0, ...own.map(topSpeed));
    const when = !own.length ? "motion.between-poses" : targets.length ? "motion.in-sweeps-and-between" : "motion.in-sweeps";
    return text("motion.way", {
      joint, low: length(joint, Math.min(...reached)), high: length(joint, Math.max(...reached)),
      speed: `${length(joint, speed)}/s`, when: text(when, { count: own.length }),
    });
  });
}

/** @param {Planned} plan @param {Units} units */
function table({ sweeps, pace = 1 }, units) {
  const head = element("tr");
  head.append(...COLUMNS.map(([title, kind]) => element("th", text(`column.${title}`), kind)));
  const made = element("table");
  made.createCaption().textContent = text("motion.order");
  made.createTHead().append(head);
  made.createTBody().append(...grouped(sweeps).map((group) => line(group, units, pace)));
  return made;
}

/** @param {Sweep[]} sweeps */
function grouped(sweeps) {
  /** @type {Sweep[][]} */
  const groups = [];
  for (const sweep of sweeps) {
    const last = groups.at(-1);
    if (last && kindOf(last[0]) === kindOf(sweep)) last.push(sweep);
    else groups.push([sweep]);
  }
  return groups;
}

// axes that move at once share a line
/** @param {Sweep} sweep */
const kindOf = ({ spec }) => [spec.excitation === "trajectory" ? "" : spec.axis, spec.block, ...spec.pose].join();

/** @param {Sweep[]} sweeps @param {Units} units @param {number} pace measured over planned time */
function line(sweeps, { joints, length }, pace) {
  const [{ spec: { pose, block } }] = sweeps;
  const axes = [...new Map(sweeps.map((sweep) => [sweep.spec.axis, sweep])).values()];
  const kind = axes.length > 1 ? "words" : "number";
  const each = (/** @type {(sweep: Sweep, axis: string) => string} */ told) => axes.map((sweep) => told(sweep, sweep.spec.axis)).join(", ");
  return row([
    [pose.map((position, k) => length(joints[k], position)).join(", "), "words"],
    [each((_, axis) => axis), "words"],
    [axes.length > 1 ? text("motion.simultaneously") : word("block", block || "sweep")],
    [sweeps.length / axes.length, "number"],
    [each((_, axis) => length(axis, pose[joints.indexOf(axis)])), kind],
    [each((sweep, axis) => goes(sweep, (value, signed) => length(axis, value, signed))), kind],
    [each((sweep, axis) => `${length(axis, topSpeed(sweep))}/s`), kind],
    [duration(pace * sweeps.reduce((sum, sweep) => sum + sweep.duration, 0)), "number"],
  ]);
}

/** @param {Sweep} sweep @param {(value: number, signed?: boolean) => string} length */
function goes(sweep, length) {
  const [far, about] = [travel(sweep), swing(sweep)];
  if (Math.abs(far) > about) return length(far, true);
  return about ? `\u00b1${length(about)}` : text("motion.stands");
}
