// The head of every page: the machine's state, the stop, its release, the way out of trouble, what the machine does.

import { call, get, Refused, Unknown } from "./api.js";
import { byId, complain, tell } from "./elements.js";
import { showDoubt } from "./intent.js";
import { askWho, identify, presser, watchLogin } from "./login.js";
import { keepMoving } from "./moving.js";
import { showWayOut } from "./wayout.js";

const PATIENCE = 5000; // ms until a service that does not answer is called silent
const STOP_KEY = "F8";

let stopPort = null; // of the process that stops while the service has no time
let shown = []; // the stops that the person sees, and releases: none that came since

// {drives, stop}; null: no word of the machine. `silent`: none of the service either
async function ask() {
  const state = byId("machine");
  try {
    const stop = await get("/stop", PATIENCE); // nobody need be anybody for it
    stopPort = stop.port;
    await identify(PATIENCE);
    const drives = await get("/drives", PATIENCE);
    shown = stop.stops.map(({ id }) => id);
    byId("held").hidden = !stop.latched;
    if (stop.latched) tell("held-by", stop.stops.map(({ by, why }) => `Stopped by ${by}: ${why}`).join("; "));
    const troubles = inTrouble(drives, stop);
    tell("machine", troubles.join(", ") || "machine connected");
    state.className = `state ${troubles.length ? "bad" : "good"}`;
    byId("connect").hidden = drives.connected;
    showDoubt(drives, troubles);
    showSilence(false);
    return { drives, stop };
  } catch (error) {
    const answers = error instanceof Refused;
    const nobody = error instanceof Unknown;
    if (nobody) askWho(error);
    tell("machine", nobody ? "log in to see the machine" : answers ? error.message : "no word from the service");
    state.className = nobody ? "state" : "state bad";
    showDoubt(null, []);
    showSilence(!answers);
    return null;
  }
}

// what was known is grey and dead: nobody knows whether it still holds. The stop stays alive
function showSilence(silent) {
  byId("silence").hidden = !silent;
  document.body.classList.toggle("silent", silent);
  document.querySelector("main").inert = silent;
  for (const id of ["held", "way-out"]) byId(id).inert = silent;
}

const silent = () => document.body.classList.contains("silent");

export function inTrouble(drives, stop) {
  const faulty = drives.axes.filter((axis) => axis.fault);
  const troubles = [];
  if (faulty.some((axis) => axis.fault.emergency_stop)) troubles.push("EMERGENCY STOP");
  else if (faulty.length) troubles.push(`fault of ${faulty.map((axis) => axis.joint).join(", ")}`);
  if (stop.latched) troubles.push("stopped");
  if (!drives.connected) troubles.push(`no machine: ${drives.trouble}`);
  return troubles;
}

// by both ways at once; the service's answer alone says that the axes stand
async function stop() {
  const press = `${Date.now()}-${Math.random()}`;
  const words = `/stop?by=${encodeURIComponent(presser())}&why=stop%20button&press=${press}`;
  const beside = stopPort ? fetch(`${location.protocol}//${location.hostname}:${stopPort}${words}`, { method: "POST" }) : Promise.reject();
  const slow = setTimeout(async () => {
    const sent = await beside.then(({ ok }) => ok, () => false);
    complain(new Error(`STOP ${sent ? "SENT, NOT" : "NOT"} CONFIRMED YET: look at the machine, use the emergency stop`));
  }, 2000);
  beside.catch(() => {}); // the service's way is told of below
  try {
    await call("POST", words);
    complain(null);
  } catch (error) {
    complain(new Error(`STOP NOT CONFIRMED (${error.message}): use the emergency stop`));
  } finally {
    clearTimeout(slow);
  }
}

// once a second `show` gets {drives, stop} and the campaign that moves; `refresh` shows the rest of the page;
// `paused` tells which campaign waits
export function watchMachine(refresh, paused, show = () => {}) {
  let machine = null;
  const now = async () => {
    const before = silent();
    machine = await ask();
    if (machine === null) return;
    showWayOut(machine.drives, machine.stop, paused());
    show(machine);
    if (!before) return;
    complain(null); // of what failed meanwhile; how it stands now is told anew
    await refresh();
  };
  const command = async (run) => {
    try {
      await run();
      complain(null);
    } catch (error) {
      complain(error);
    }
    await Promise.all([now(), refresh()]);
  };
  const press = async () => {
    await stop();
    await now();
  };
  watchLogin();
  byId("stop").addEventListener("click", press);
  document.addEventListener("keydown", (event) => {
    if (event.key !== STOP_KEY) return;
    event.preventDefault();
    if (!event.repeat) press();
  });
  byId("held").addEventListener("submit", (event) => {
    event.preventDefault();
    command(() => call("POST", "/stop/reset", { by: byId("reset-by").value, stops: shown }));
  });
  byId("connect").addEventListener("click", () => command(() => call("POST", "/drives/connect")));
  const watch = async () => {
    if (!document.hidden) {
      await now();
      const moving = machine && (await keepMoving(refresh).catch(() => undefined));
      if (moving) show(machine, moving);
    }
    setTimeout(watch, 1000);
  };
  document.addEventListener("visibilitychange", () => document.hidden || now());
  watch();
}
