// The head of every page: state of the machine, stop, release, instructions after a stop, present motion.

import { call, get, Refused, Silent, Unknown } from "./api.js";
import { byFault, causeParts, stopParts } from "./causes.js";
import { byId, complain, complainAgain, tell } from "./elements.js";
import { asOf, LIMIT } from "./fresh.js";
import { showDoubt } from "./intent.js";
import { askWho, identify, offerNames, showRights, watchLogin } from "./login.js";
import { keepMoving } from "./moving.js";
import { stated } from "./statement.js";
import { settleStop, showStop, stop } from "./stop.js";
import { showWayOut } from "./wayout.js";
import { foreign, joined, parts, text, told, watchLanguage } from "./words.js";

/** @typedef {import("./fresh.js").Report} Report */

const PATIENCE = 5000; // ms until the service counts as not answering
const STOP_KEY = "F8";
const LOOKS = { moves: "warn", energised: "warn", stands: "good", unknown: "bad" };

let stopPort = null; // port of the stop process, which works while the service is busy
/** @type {number[]} */
let shown = []; // the displayed stops; only these are released, not later ones

/** @type {Api.StopView | null} */
let held = null; // of the last answer
/** @type {Report | null} */
let report = null; // the youngest statement
const asked = { stop: -Infinity, drives: -Infinity }; // ms, when the shown answers were asked for: an earlier one may come later
/** @type {(statement: Api.StatementView) => void} */
let follows = () => {}; // what is drawn with the headline, by the same statement
let draw = () => {}; // the head, with the statement as old as it is now

const statement = () => asOf(report, performance.now());

/** @param {"stop" | "drives"} what @param {number} at @param {Api.StatementView} statement */
function overtaken(what, at, statement) {
  if (at < asked[what]) return true;
  asked[what] = at;
  if (!report || at >= report.asked) report = { statement, asked: at };
  return false;
}

// only this tells whether the service is silent: it needs neither login nor database nor drives, and is not late because
// a plan is computed or an axis answers slowly
async function hear() {
  const at = performance.now();
  const stop = await get("/stop", PATIENCE);
  if (overtaken("stop", at, stop.statement)) return;
  held = stop;
  stopPort = stop.port;
  showSilence(false);
  showHeld(stop);
}

// null: state of its axes not known
/** @param {Api.CampaignDocument} [paused] @returns {Promise<Machine | null>} */
async function ask(paused) {
  const began = performance.now();
  let heard = false;
  try {
    await hear();
    heard = true;
    await identify(PATIENCE);
    const at = performance.now();
    const drives = await get("/drives", PATIENCE);
    if (overtaken("drives", at, drives.statement)) return null;
    draw = () => showState(drives, held, paused);
    draw();
    return { drives, stop: held };
  } catch (error) {
    if (began < asked.drives) return null;
    const nobody = error instanceof Unknown;
    if (nobody) askWho(error);
    if (!heard && began >= asked.stop) showSilence(!(error instanceof Refused));
    draw = () => {
      tell("machine", nobody ? text("machine.nobody") : error instanceof Silent ? text(silent() ? "machine.silent" : "machine.late") : told(error));
      showStated(!silent());
      byId("machine").className = nobody ? "state" : "state bad";
      showDoubt(!silent() && statement().state === "unknown" ? statement() : null, false, null);
    };
    draw();
    return null;
  }
}

/** @param {boolean} shown */
function showStated(shown) {
  follows(statement());
  tell("stated", shown ? stated(statement()) : "");
  tell("within", silent() || statement().state === "unknown" ? "" : text("head.within", { seconds: LIMIT }));
}

/** @param {Api.StopView} stop */
function showHeld(stop) {
  shown = stop.stops.map(({ id }) => id);
  if (stop.latched && byId("held").hidden) offerNames();
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
  tell("machine", troubles.length ? joined(troubles, ", ") : stated(statement()));
  showStated(troubles.length > 0 && drives.connected);
  byId("machine").className = `state ${troubles.length ? "bad" : LOOKS[statement().state]}`;
  byId("connect").hidden = drives.connected;
  showDoubt(statement(), !troubles.length, { drives, stop });
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
// `paused` returns the waiting campaign; `follow` gets the statement of the headline whenever that is drawn.
// Returns what asks at once
/** @param {() => Promise<void>} refresh @param {() => Api.CampaignDocument | undefined} paused @param {(machine: Machine, moving?: Api.CampaignView) => void} [show] @param {(statement: Api.StatementView) => void} [follow] */
export function watchMachine(refresh, paused, show = () => {}, follow = () => {}) {
  follows = follow;
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
  const look = async () => {
    await now();
    const moving = machine && (await keepMoving(refresh).catch(() => undefined));
    if (moving) show(machine, moving);
  };
  const watch = async () => {
    if (!document.hidden) {
      const meanwhile = setInterval(() => hear().catch(() => {}), 1000); // while the database or a drive lets the rest wait
      await look();
      clearInterval(meanwhile);
    }
    setTimeout(watch, 1000);
  };
  watchLanguage(() => {
    showRights();
    complainAgain();
    showStop();
    Promise.all([now(), refresh()]);
  });
  document.addEventListener("visibilitychange", () => {
    draw();
    if (!document.hidden) now();
  });
  setInterval(() => draw(), 250);
  watch();
  return look;
}
