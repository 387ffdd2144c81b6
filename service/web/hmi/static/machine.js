// The head of every page: state of the machine, stop, release, instructions after a stop, present motion.

import { call, get, Refused, Silent, Unknown } from "./api.js";
import { byFault, causeParts, stopParts } from "./causes.js";
import { byId, complain, complainAgain, tell } from "./elements.js";
import { showDoubt } from "./intent.js";
import { askWho, identify, showRights, watchLogin } from "./login.js";
import { keepMoving } from "./moving.js";
import { stated } from "./statement.js";
import { settleStop, showStop, stop } from "./stop.js";
import { showWayOut } from "./wayout.js";
import { foreign, joined, parts, text, told, watchLanguage } from "./words.js";

const PATIENCE = 5000; // ms until the service counts as not answering
const STOP_KEY = "F8";
const LOOKS = { moves: "warn", energised: "warn", stands: "good", unknown: "bad" };

let stopPort = null; // port of the stop process, which works while the service is busy
/** @type {number[]} */
let shown = []; // the displayed stops; only these are released, not later ones

// null: state of its axes not known. Only GET /stop tells whether the service is silent: it
// needs neither login nor database nor drives, and is not late because a plan is computed or an axis answers slowly
/** @param {Api.CampaignDocument} [paused] @returns {Promise<Machine | null>} */
async function ask(paused) {
  /** @type {Api.StopView | null} */
  let stop = null;
  try {
    stop = await get("/stop", PATIENCE);
    stopPort = stop.port;
    showSilence(false);
    showHeld(stop);
    await identify(PATIENCE);
    const drives = await get("/drives", PATIENCE);
    showState(drives, stop, paused);
    return { drives, stop };
  } catch (error) {
    const nobody = error instanceof Unknown;
    if (nobody) askWho(error);
    if (!stop) showSilence(!(error instanceof Refused));
    tell("machine", nobody ? text("machine.nobody") : error instanceof Silent ? text(stop ? "machine.late" : "machine.silent") : told(error));
    tell("stated", stop ? stated(stop.statement) : "");
    byId("machine").className = nobody ? "state" : "state bad";
    showDoubt(stop?.statement.state === "unknown" ? stop.statement : null, false);
    return null;
  }
}

/** @param {Api.StopView} stop */
function showHeld(stop) {
  shown = stop.stops.map(({ id }) => id);
  byId("held").hidden = !stop.latched;
  if (stop.latched) tell("held-by", joined(stop.stops.map(stopParts), "; "));
  settleStop(stop.latched);
}

// first what is wrong, then the state of the axes; green only if nothing is wrong and every axis reports that it stands
/** @param {Api.DrivesView} drives @param {Api.StopView} stop @param {Api.CampaignDocument} [paused] */
function showState(drives, stop, paused) {
  const broken = paused && byFault(paused.structured_cause);
  const troubles = inTrouble(drives, stop);
  if (broken && !troubles.length) troubles.push(text("machine.broken", { id: paused.id }));
  tell("machine", troubles.length ? joined(troubles, ", ") : stated(drives.statement));
  tell("stated", troubles.length && drives.connected ? stated(drives.statement) : "");
  byId("machine").className = `state ${troubles.length ? "bad" : LOOKS[drives.statement.state]}`;
  byId("connect").hidden = drives.connected;
  showDoubt(drives.statement, !troubles.length, drives.trouble_cause);
}

// old values are grey and disabled because they may be out of date. STOP stays enabled
/** @param {boolean} silent */
function showSilence(silent) {
  byId("silence").hidden = !silent;
  document.body.classList.toggle("silent", silent);
  document.querySelector("main").inert = silent;
  for (const id of ["held", "way-out"]) byId(id).inert = silent;
}

const silent = () => document.body.classList.contains("silent");

// as parts
/** @param {Api.DrivesView} drives @param {Api.StopView} stop */
export function inTrouble(drives, stop) {
  const faulty = drives.axes.filter((axis) => axis.fault);
  /** @type {(Part | Part[])[]} */
  const troubles = [];
  if (faulty.some((axis) => axis.fault.emergency_stop)) troubles.push(text("machine.emergency"));
  else if (faulty.length) troubles.push(text("machine.fault", { axes: faulty.map((axis) => axis.joint).join(", ") }));
  if (stop.latched) troubles.push(text("machine.stopped"));
  if (!drives.connected) troubles.push(parts("machine.none", { trouble: drives.trouble_cause ? causeParts(drives.trouble_cause) : foreign(drives.trouble) }));
  return troubles;
}

// once a second `show` gets {drives, stop} and the moving campaign; `refresh` updates the rest of the page;
// `paused` returns the waiting campaign
/** @param {() => Promise<void>} refresh @param {() => Api.CampaignDocument | undefined} paused @param {(machine: Machine, moving?: Api.CampaignView) => void} [show] */
export function watchMachine(refresh, paused, show = () => {}) {
  /** @type {Machine | null} */
  let machine = null;
  const now = async () => {
    const before = silent();
    machine = await ask(paused());
    if (machine === null) return;
    showWayOut(machine, paused());
    show(machine);
    if (!before) return;
    complain(null); // old errors are removed; the state is shown again
    await refresh();
  };
  /** @param {() => Promise<unknown>} run */
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
    await stop(stopPort);
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
    showStop();
    Promise.all([now(), refresh()]);
  });
  document.addEventListener("visibilitychange", () => document.hidden || now());
  watch();
}
