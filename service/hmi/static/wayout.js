// Instructions for the operator to leave a state without motion: step by step, in the required order.

import { axisOf, byFault, causeParts } from "./causes.js";
import { byId, element } from "./elements.js";
import { jointsThat } from "./statement.js";
import { parts, text } from "./words.js";

// machine: as of `watchMachine`; paused: the paused campaign, if any
/** @param {Machine} machine @param {Api.CampaignDocument} [paused] */
export function showWayOut({ drives, stop }, paused) {
  const steps = ofMachine(drives, stop);
  const broken = paused && byFault(paused.cause);
  if (!steps.length && broken) steps.push(parts("way.look-cause", { axes: axisOf(paused.cause) ?? text("cause.machine"), cause: causeParts(paused.cause) }));
  if (steps.length && paused) steps.push(text("way.resume", { id: paused.id }));
  const made = steps.map((step) => element("li", step));
  const list = byId("way-out-steps");
  const same = [...list.children].map((one) => one.textContent).join() === made.map((one) => one.textContent).join();
  if (!same) list.replaceChildren(...made);
  byId("way-out").hidden = !steps.length;
}

/** @param {Api.AxisView[]} axes */
const namesOf = (axes) => axes.map((axis) => axis.joint).join(", ");

/** @param {Api.DrivesView} drives @param {Api.StopView} stop @returns {Content[]} */
function ofMachine(drives, stop) {
  const unknown = jointsThat(drives.statement, "unknown");
  const faulty = drives.axes.filter((axis) => axis.fault);
  const emergency = faulty.some((axis) => axis.fault.emergency_stop);
  const steps = [];
  if (!drives.connected || drives.statement.state === "unknown") {
    steps.push(
      text("way.look-lost"),
      drives.connected && unknown.length ? text("way.power-of", { axes: unknown.join(", ") }) : text("way.power"),
    );
    if (!drives.connected) steps.push(text("way.connect"));
  } else if (faulty.length || stop.latched) {
    const whole = emergency || stop.latched;
    steps.push(whole ? text("way.look") : text("way.look-at", { axes: namesOf(faulty) }));
  }
  if (emergency) steps.push(text("way.unlock"));
  if (faulty.length) {
    const all = faulty.length === drives.axes.length;
    steps.push(all ? text("way.acknowledge-all") : text("way.acknowledge", { axes: namesOf(faulty) }));
  }
  if (stop.latched) steps.push(text("way.release"));
  return steps;
}
