// Instructions for the operator to leave a state without motion: step by step, in the required order.

import { axisOf, byFault } from "./causes.js";
import { byId, element, tell } from "./elements.js";
import { jointsThat } from "./statement.js";
import { foreign, text } from "./words.js";

/** @typedef {{code: string, joint?: string, detail?: string}} Known */

// machine: as of `watchMachine`; paused: the paused campaign, if any
/** @param {Machine} machine @param {Api.CampaignDocument} [paused] */
export function showWayOut({ drives, stop }, paused) {
  const causes = causesOf(drives, stop, paused);
  const steps = stepsOf(drives, stop, causes);
  if (steps.length && paused) steps.push(text("way.resume", { id: paused.id }));
  const list = byId("way-out-steps");
  const same = [...list.children].map((one) => one.textContent).join() === steps.join();
  if (!same) list.replaceChildren(...steps.map((step) => element("li", step)));
  byId("way-out").hidden = !steps.length;
  const details = causes.findLast((one) => one.detail)?.detail; // of the campaign, if it has one
  byId("way-out-details").hidden = !details;
  tell("way-out-told", details ? foreign(details) : "");
}

/** @param {Api.AxisView[]} axes */
const namesOf = (axes) => axes.map((axis) => axis.joint).join(", ");

// what nobody wanted: of the machine, of its stops, of its axes and of the campaign
/** @param {Api.DrivesView} drives @param {Api.StopView} stop @param {Api.CampaignDocument} [paused] @returns {Known[]} */
function causesOf(drives, stop, paused) {
  const faults = drives.axes.filter((axis) => axis.fault);
  return [
    ...[drives.trouble_cause, ...stop.stops.map((one) => one.cause)].filter(byFault),
    ...faults.map(({ joint, fault }) => (fault.emergency_stop ? { code: "emergency_stop", joint: "" } : { code: "drive_fault", joint })),
    ...[paused?.structured_cause ?? null].filter(byFault),
  ];
}

/** @param {Api.DrivesView} drives @param {Api.StopView} stop @param {Known[]} causes */
function stepsOf(drives, stop, causes) {
  const unknown = jointsThat(drives.statement, "unknown");
  const faulty = drives.axes.filter((axis) => axis.fault);
  const lost = !drives.connected || drives.statement.state === "unknown";
  const whole = stop.latched || faulty.some((axis) => axis.fault.emergency_stop);
  const steps = [];
  if (lost) steps.push(text("way.look-lost"));
  else if (whole) steps.push(text("way.look"));
  else if (causes.length) steps.push(text("way.look-at", { axes: namesOf(faulty) || axisOf(causes[0]) }));
  if (lost && drives.connected && unknown.length) steps.push(text("way.power-of", { axes: unknown.join(", ") }));
  else if (lost && !causes.length) steps.push(text("way.power"));
  steps.push(...new Set(causes.map((cause) => text(`step.${cause.code}`, { axis: axisOf(cause) }))));
  if (!drives.connected) steps.push(text("way.connect"));
  if (faulty.length) {
    const all = faulty.length === drives.axes.length;
    steps.push(all ? text("way.acknowledge-all") : text("way.acknowledge", { axes: namesOf(faulty) }));
  }
  if (stop.latched) steps.push(text("way.release"));
  return steps;
}
