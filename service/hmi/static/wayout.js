// How to get out of a state in which nothing may move: step by step, in the order in which it works.

import { byId, element } from "./elements.js";

// of the machine, and the paused campaign, if there is one
export function showWayOut(drives, stop, paused) {
  const steps = ofMachine(drives, stop);
  if (steps.length && paused) steps.push(`Resume campaign ${paused.id}, or abort it: until then it stays as it is.`);
  const list = byId("way-out-steps");
  const same = [...list.children].map((one) => one.textContent).join() === steps.join();
  if (!same) list.replaceChildren(...steps.map((step) => element("li", step)));
  byId("way-out").hidden = !steps.length;
}

function ofMachine(drives, stop) {
  const unknown = drives.axes.filter((axis) => axis.state === "unknown").map((axis) => axis.joint);
  const faulty = drives.axes.filter((axis) => axis.fault);
  const emergency = faulty.some((axis) => axis.fault.emergency_stop);
  const steps = [];
  if (!drives.connected || unknown.length) {
    steps.push(
      "Look at the machine with its emergency stop at hand: an axis may still move.",
      `Look at power and cable of the drives${unknown.length && drives.connected ? ` of ${unknown.join(", ")}` : ""}.`,
    );
    if (!drives.connected) steps.push("Press Connect: nothing moves by this.");
  } else if (faulty.length || stop.latched) {
    const where = emergency || stop.latched ? "the machine" : faulty.map((axis) => axis.joint).join(", ");
    steps.push(`Look at ${where}: does every axis stand, is nobody in danger, is the cause gone?`);
  }
  if (emergency) steps.push("Unlock the machine's own emergency stop.");
  if (faulty.length) {
    const which = faulty.length === drives.axes.length ? "all axes" : faulty.map((axis) => axis.joint).join(", ");
    steps.push(`Acknowledge ${which} in the table of axes: nothing moves by this.`);
  }
  if (stop.latched) steps.push("Type your name and release the stop: nothing moves by this.");
  return steps;
}
