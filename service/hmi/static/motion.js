// What a plan will move, in words and as a table, beside the button that lets it move.

import { get } from "./api.js";
import { duration, element, plain, row } from "./elements.js";

const ORDER = "In this order. Position of the turning axis at the start of each sweep and how far it goes from there.";
const COLUMNS = [["Pose"], ["Axis"], ["Block"], ["Sweeps", "number"], ["From", "number"], ["Goes", "number"], ["Top speed", "number"], ["Time", "number"]];
const CHECK_MOVES = "Before its first motion each axis makes its check move: half a degree (or a small way) and back.";

const known = new Map(); // by robot

// {joints, length}: names in the order of a pose, and positions (rad, m) as an operator reads them
export async function unitsOf(robot) {
  if (!known.has(robot)) known.set(robot, await read(robot));
  return known.get(robot);
}

async function read(robot) {
  const { description, urdf_text } = await get(`/robots/${robot}`);
  const urdf = new DOMParser().parseFromString(urdf_text, "application/xml");
  const prismatic = new Set([...urdf.querySelectorAll('joint[type="prismatic"]')].map((joint) => joint.getAttribute("name")));
  const scale = (joint) => (prismatic.has(joint) ? [1e3, " mm"] : [180 / Math.PI, "\u00b0"]);
  const length = (joint, value, signed = false) => {
    const [factor, unit] = scale(joint);
    const shown = Number((value * factor).toPrecision(3));
    return `${signed && shown > 0 ? "+" : ""}${shown}${unit}`.replace("-", "\u2212");
  };
  return { joints: description.axes.map((axis) => axis.joint), length, scale, prismatic };
}

// what moves now and what follows, in words: "joint_2 travels to -40 deg, then joint_3 sweeps, 12 s"
export function inWords(steps, { length }) {
  return steps.map(({ kind, axes, target, seconds }) => {
    const [axis] = axes;
    if (kind === "travel") return `${axis} travels to ${length(axis, target)}`;
    if (kind === "check_move") return `${axis} makes its check move`;
    return axes.length > 1 ? `${axes.join(", ")} move at once, ${duration(seconds)}` : `${axis} sweeps, ${duration(seconds)}`;
  }).join(", then ");
}

export function showMotion(place, plan, units) {
  const list = element("ul");
  list.append(...ways(plan, units).concat(CHECK_MOVES).map((text) => element("li", text)));
  const scroll = element("div", undefined, "scroll");
  scroll.append(table(plan.sweeps, units));
  place.replaceChildren(element("p", size(plan)), list, scroll);
}

// -- of one sweep; from standstill to standstill, the sines swing about that way

export function travel({ spec, ramp, settle }) {
  return spec.offset_velocity * (ramp + settle + (spec.period ?? 0) * (spec.periods ?? 0));
}

export function swing({ spec }) {
  return spec.sines.reduce((sum, sine) => sum + sine.amplitude / (2 * Math.PI * sine.frequency), 0);
}

// noise has no set-point: it may be as fast as it is let
export function topSpeed({ spec, velocity_limit }) {
  if (spec.excitation === "noise") return velocity_limit;
  return Math.abs(spec.offset_velocity) + spec.sines.reduce((sum, sine) => sum + sine.amplitude, 0);
}

const counted = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;

export const posesOf = (sweeps) => new Set(sweeps.map((sweep) => sweep.spec.pose.join())).size;

// -- of all

function size(plan) {
  const axes = [...new Set(plan.sweeps.map((sweep) => sweep.spec.axis))].join(", ");
  return `${plan.robot}: ${counted(plan.sweeps.length, "sweep")} of ${axes} in ${counted(posesOf(plan.sweeps), "pose")}, ` +
    `${duration(plan.duration)} with all moves between poses. ` +
    (plan.dropped ?? []).map((one) => `Left out: ${one.reason}.`).join(" ");
}

// a sweep outside of its window is stopped: as far as that an axis may go
function ways({ sweeps, request }, { joints, length }) {
  const legs = sweeps.flatMap((sweep) => sweep.legs);
  return joints.flatMap((joint) => {
    const own = sweeps.filter((sweep) => sweep.spec.axis === joint);
    const targets = legs.filter((leg) => leg.joint === joint).map((leg) => leg.target);
    const reached = [...targets, ...own.flatMap((sweep) => sweep.position_window)];
    if (!reached.length) return [];
    const speed = Math.max(targets.length ? request.move_velocity : 0, ...own.map(topSpeed));
    const when = [own.length ? `in ${counted(own.length, "sweep")}` : "", targets.length ? "between poses" : ""].filter(Boolean).join(" and ");
    return `${joint} is moved between ${length(joint, Math.min(...reached))} and ${length(joint, Math.max(...reached))}, ` +
      `at most ${length(joint, speed)}/s, ${when}`;
  });
}

function table(sweeps, units) {
  const head = element("tr");
  head.append(...COLUMNS.map(([title, kind]) => element("th", title, kind)));
  const made = element("table");
  made.createCaption().textContent = ORDER;
  made.createTHead().append(head);
  made.createTBody().append(...grouped(sweeps).map((group) => line(group, units)));
  return made;
}

function grouped(sweeps) {
  const groups = [];
  for (const sweep of sweeps) {
    const last = groups.at(-1);
    if (last && kindOf(last[0]) === kindOf(sweep)) last.push(sweep);
    else groups.push([sweep]);
  }
  return groups;
}

const kindOf = ({ spec }) => [spec.axis, spec.block, ...spec.pose].join();

function line(sweeps, { joints, length }) {
  const [first] = sweeps;
  const { spec } = first;
  const goes = Math.abs(travel(first)) > swing(first) ? length(spec.axis, travel(first), true) : swing(first) ? `\u00b1${length(spec.axis, swing(first))}` : "stands";
  return row([
    [spec.pose.map((position, k) => length(joints[k], position)).join(", "), "words"],
    [spec.axis],
    [plain(spec.block || "sweep")],
    [sweeps.length, "number"],
    [length(spec.axis, spec.pose[joints.indexOf(spec.axis)]), "number"],
    [goes, "number"],
    [`${length(spec.axis, topSpeed(first))}/s`, "number"],
    [duration(sweeps.reduce((sum, sweep) => sum + sweep.duration, 0)), "number"],
  ]);
}
