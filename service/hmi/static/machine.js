// The head of every page: state of the machine, stop, release, instructions after a stop, present motion.

import { call, get, Refused, Unknown } from "./api.js";
import { PRESSED, stopParts } from "./causes.js";
import { byId, complain, complainAgain, tell } from "./elements.js";
import { showDoubt } from "./intent.js";
import { askWho, identify, presser, showRights, watchLogin } from "./login.js";
import { keepMoving } from "./moving.js";
import { showWayOut } from "./wayout.js";
import { foreign, joined, parts, text, Told, told, watchLanguage } from "./words.js";

const PATIENCE = 5000; // ms until the service counts as not answering
const STOP_KEY = "F8";

let stopPort = null; // port of the stop process, which works while the service is busy
let shown = []; // the displayed stops; only these are released, not later ones

// {drives, stop}; null: state of the machine not known. `silent`: the service does not answer
async function ask() {
  const state = byId("machine");
  try {
    const stop = await get("/stop", PATIENCE); // needs no login
    stopPort = stop.port;
    await identify(PATIENCE);
    const drives = await get("/drives", PATIENCE);
    shown = stop.stops.map(({ id }) => id);
    byId("held").hidden = !stop.latched;
    if (stop.latched) tell("held-by", joined(stop.stops.map(({ by, why }) => stopParts(by, why)), "; "));
    const troubles = inTrouble(drives, stop);
    tell("machine", troubles.length ? joined(troubles, ", ") : text("machine.connected"));
    state.className = `state ${troubles.length ? "bad" : "good"}`;
    byId("connect").hidden = drives.connected;
    showDoubt(drives, troubles);
    showSilence(false);
    return { drives, stop };
  } catch (error) {
    const answers = error instanceof Refused;
    const nobody = error instanceof Unknown;
    if (nobody) askWho(error);
    tell("machine", nobody ? text("machine.nobody") : answers ? told(error) : text("machine.silent"));
    state.className = nobody ? "state" : "state bad";
    showDoubt(null, []);
    showSilence(!answers);
    return null;
  }
}

// old values are grey and disabled because they may be out of date. STOP stays enabled
function showSilence(silent) {
  byId("silence").hidden = !silent;
  document.body.classList.toggle("silent", silent);
  document.querySelector("main").inert = silent;
  for (const id of ["held", "way-out"]) byId(id).inert = silent;
}

const silent = () => document.body.classList.contains("silent");

// as parts
export function inTrouble(drives, stop) {
  const faulty = drives.axes.filter((axis) => axis.fault);
  const troubles = [];
  if (faulty.some((axis) => axis.fault.emergency_stop)) troubles.push(text("machine.emergency"));
  else if (faulty.length) troubles.push(text("machine.fault", { axes: faulty.map((axis) => axis.joint).join(", ") }));
  if (stop.latched) troubles.push(text("machine.stopped"));
  if (!drives.connected) troubles.push(parts("machine.none", { trouble: foreign(drives.trouble) }));
  return troubles;
}

// to both ports at the same time; only the answer of the service confirms the standstill of the axes
async function stop() {
  const press = `${Date.now()}-${Math.random()}`;
  const words = `/stop?by=${encodeURIComponent(presser())}&why=${encodeURIComponent(PRESSED)}&press=${press}`;
  const beside = stopPort ? fetch(`${location.protocol}//${location.hostname}:${stopPort}${words}`, { method: "POST" }) : Promise.reject();
  const slow = setTimeout(async () => {
    const sent = await beside.then(({ ok }) => ok, () => false);
    complain(new Told(sent ? "stop.sent" : "stop.not-yet"));
  }, 2000);
  beside.catch(() => {}); // the result of the service is shown below
  try {
    await call("POST", words);
    complain(null);
  } catch (error) {
    complain(new Told("stop.not-confirmed", { why: error }));
  } finally {
    clearTimeout(slow);
  }
}

// once a second `show` gets {drives, stop} and the moving campaign; `refresh` updates the rest of the page;
// `paused` returns the waiting campaign
export function watchMachine(refresh, paused, show = () => {}) {
  let machine = null;
  const now = async () => {
    const before = silent();
    machine = await ask();
    if (machine === null) return;
    showWayOut(machine.drives, machine.stop, paused());
    show(machine);
    if (!before) return;
    complain(null); // old errors are removed; the state is shown again
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
  tell("machine", text("machine.connecting"));
  byId("stop").addEventListener("click", (event) => {
    event.preventDefault(); // prevents the form's own request, which stops the machine if no script runs
    press();
  });
  document.addEventListener("keydown", (event) => {
    if (event.key !== STOP_KEY) return;
    event.preventDefault();
    if (!event.repeat) press();
  });
  byId("dead").hidden = true;
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
  watchLanguage(() => {
    showRights();
    complainAgain();
    Promise.all([now(), refresh()]);
  });
  document.addEventListener("visibilitychange", () => document.hidden || now());
  watch();
}
