// How the axes stand, their faults, and the acknowledgement of who looked.

import { call } from "./api.js";
import { byId, element, fixed, row } from "./elements.js";

let faulty = []; // joints

export function showAxes(drives) {
  byId("axes").replaceChildren(...drives.axes.map((axis) => row([
    [axis.joint],
    [axis.state],
    [fixed(axis.position, 4), "number"],
    [fixed(axis.velocity, 4), "number"],
    [fixed(axis.effort, 1), "number"],
    ...faultCells(axis),
  ])));
  faulty = drives.axes.filter((axis) => axis.fault).map((axis) => axis.joint);
  byId("acknowledge-all").hidden = faulty.length < 2;
}

function faultCells(axis) {
  if (!axis.fault) return [["", "fault"]];
  const button = element("button", "I looked: acknowledge");
  button.type = "button";
  button.dataset.acknowledge = axis.joint;
  return [[inWords(axis.fault), "fault", button]];
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
  byId("axes").addEventListener("click", (click) => {
    const joint = click.target.dataset.acknowledge;
    if (joint) command(() => acknowledge([joint]));
  });
  byId("acknowledge-all").addEventListener("click", () => command(() => acknowledge(faulty)));
}
