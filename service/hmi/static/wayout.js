// Instructions for the operator to leave a state without motion: step by step, in the required order.

import { byId, element } from "./elements.js";
import { text } from "./words.js";

// of the machine, and the paused campaign, if any
export function showWayOut(drives, stop, paused) {
  const steps = ofMachine(drives, stop);
  if (steps.length && paused) steps.push(text("way.resume", { id: paused.id }));
  const list = byId("way-out-steps");
  const same = [...list.children].map((one) => one.textContent).join() === steps.join();
  if (!same) list.replaceChildren(...steps.map((step) => element("li", step)));
  byId("way-out").hidden = !steps.length;
}

const namesOf = (axes) => axes.map((axis) => axis.joint).join(", ");

function ofMachine(drives, stop) {
  const unknown = drives.axes.filter((axis) => axis.state === "unknown").map((axis) => axis.joint);
  const faulty = drives.axes.filter((axis) => axis.fault);
  const emergency = faulty.some((axis) => axis.fault.emergency_stop);
  const steps = [];
  if (!drives.connected || unknown.length) {
    steps.push(
      text("way.look-lost"),
      unknown.length && drives.connected ? text("way.power-of", { axes: unknown.join(", ") }) : text("way.power"),
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
