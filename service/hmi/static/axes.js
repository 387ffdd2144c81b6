// How the axes stand, their faults, and the acknowledgement of who looked.

import { call } from "./api.js";
import { byId, element, EMPTY, fixed, row } from "./elements.js";
import { mayNot } from "./login.js";

let faulty = []; // joints
let last = null; // the drives

// units: of the robot, or null while none is known
export function showAxes(drives, units) {
  last = [drives, units];
  byId("axes").replaceChildren(...drives.axes.map((axis) => {
    const [factor, unit, effort] = scaleOf(axis.joint, units);
    const digits = factor === 1 ? 4 : 2;
    return row([
      [axis.joint],
      [axis.state],
      [shown(axis.position, factor, unit, digits), "number"],
      [shown(axis.velocity, factor, unit && `${unit}/s`, digits), "number"],
      [shown(axis.effort, 1, effort, 1), "number"],
      ...faultCells(axis),
    ]);
  }));
  faulty = drives.axes.filter((axis) => axis.fault).map((axis) => axis.joint);
  byId("acknowledge-all").hidden = faulty.length < 2;
}

function scaleOf(joint, units) {
  const effort = units?.prismatic.has(joint) ? " N" : " N m";
  if (units === null) return [1, "", effort]; // what kind of joint it is, the robot alone tells
  if (byId("si").checked) return [1, units.prismatic.has(joint) ? " m" : " rad", effort];
  return [...units.scale(joint), effort];
}

const shown = (value, factor, unit, digits) =>
  value === null ? EMPTY : `${fixed(value * factor, digits)}${unit}`.replace("-", "\u2212");

function faultCells(axis) {
  if (!axis.fault) return [["", "fault"]];
  const button = element("button", "I looked: acknowledge");
  button.type = "button";
  button.dataset.acknowledge = axis.joint;
  const reason = mayNot("POST /drives/{joint}/acknowledge");
  button.disabled = reason !== "";
  return [[reason ? `${inWords(axis.fault)} (${reason})` : inWords(axis.fault), "fault", button]];
}

function inWords({ code, text, emergency_stop }) {
  const hexadecimal = `${code.toString(16).toUpperCase().padStart(4, "0")}h`;
  const told = text.includes(hexadecimal) || !code ? text : `${hexadecimal} ${text}`;
  return emergency_stop ? `EMERGENCY STOP: ${told}` : told;
}

async function acknowledge(joints) {
  const refused = [];
  for (const joint of joints) {
    await call("POST", `/drives/${joint}/acknowledge`).catch((error) => refused.push(`${joint}: ${error.message}`));
  }
  if (refused.length) throw new Error(refused.join("; "));
}

export function watchAxes(command) {
  byId("si").addEventListener("change", () => last && showAxes(...last));
  byId("axes").addEventListener("click", (click) => {
    const joint = click.target.dataset.acknowledge;
    if (joint) command(() => acknowledge([joint]));
  });
  byId("acknowledge-all").addEventListener("click", () => command(() => acknowledge(faulty)));
}
