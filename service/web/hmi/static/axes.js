// State of the axes, their faults, and the acknowledgement by a person who has checked them.

import { call } from "./api.js";
import { byId, element, EMPTY, fixed, minus, row } from "./elements.js";
import { mayNot } from "./login.js";
import { joined, outside, parts, text, told, word } from "./words.js";

/** @type {string[]} */
let faulty = []; // joints
/** @type {[Api.DrivesView, Units | null] | null} */
let last = null; // the last answer for the drives

// units: of the robot, or null while not known
/** @param {Api.DrivesView} drives @param {Units | null} units */
export function showAxes(drives, units) {
  last = [drives, units];
  byId("axes").replaceChildren(...drives.axes.map((axis) => {
    const [factor, unit, effort] = scaleOf(axis.joint, units);
    const digits = factor === 1 ? 4 : 2;
    return row([
      [axis.joint],
      [word("axis-state", axis.state)],
      [shown(axis.position, factor, unit, digits), "number"],
      [shown(axis.velocity, factor, unit && `${unit}/s`, digits), "number"],
      [shown(axis.effort, 1, effort, 1), "number"],
      ...faultCells(axis),
    ]);
  }));
  faulty = drives.axes.filter((axis) => axis.fault).map((axis) => axis.joint);
  byId("acknowledge-all").hidden = faulty.length < 2;
}

/** @param {string} joint @param {Units | null} units @returns {[number, string, string]} */
function scaleOf(joint, units) {
  if (units === null) return [1, "", ""]; // only the robot file gives the type of a joint
  const effort = units.prismatic.has(joint) ? " N" : " N m";
  if (byId("si").checked) return [1, units.prismatic.has(joint) ? " m" : " rad", effort];
  return [...units.scale(joint), effort];
}

/** @param {number | null} value @param {number} factor @param {string} unit @param {number} digits */
const shown = (value, factor, unit, digits) =>
  value === null ? EMPTY : minus(`${fixed(value * factor, digits)}${unit}`);

/** @param {Api.AxisView} axis @returns {any[][]} */
function faultCells(axis) {
  if (!axis.fault) return [["", "fault"]];
  const button = element("button", text("axes.acknowledge"));
  button.type = "button";
  button.dataset.acknowledge = axis.joint;
  const reason = mayNot("POST /drives/{joint}/acknowledge");
  button.disabled = reason !== "";
  return [[reason ? [...inWords(axis.fault), ` (${reason})`] : inWords(axis.fault), "fault", button]];
}

/** @param {Api.FaultView} fault */
function inWords({ code, text: fault, emergency_stop }) {
  const hexadecimal = `${code.toString(16).toUpperCase().padStart(4, "0")}h`;
  const cause = outside("drive", fault.includes(hexadecimal) || !code ? fault : `${hexadecimal} ${fault}`);
  return emergency_stop ? parts("axes.emergency", { cause }) : [cause];
}

class AxesRefused extends Error {
  /** @param {[string, Error][]} refused */
  constructor(refused) {
    super();
    this.parts = () => joined(refused.map(([joint, error]) => [`${joint}: `, ...told(error)]), "; ");
  }
}

/** @param {string[]} joints */
async function acknowledge(joints) {
  /** @type {[string, Error][]} */
  const refused = [];
  for (const joint of joints) {
    await call("POST", `/drives/${joint}/acknowledge`).catch((error) => refused.push([joint, error]));
  }
  if (refused.length) throw new AxesRefused(refused);
}

/** @param {(run: () => Promise<unknown>) => void} command */
export function watchAxes(command) {
  byId("si").addEventListener("change", () => last && showAxes(...last));
  byId("axes").addEventListener("click", (click) => {
    const joint = /** @type {HTMLElement} */ (click.target).dataset.acknowledge;
    if (joint) command(() => acknowledge([joint]));
  });
  byId("acknowledge-all").addEventListener("click", () => command(() => acknowledge(faulty)));
}
