// The head of every page: the machine's state, the stop, its release, and what the machine does next.

import { call, get, Refused } from "./api.js";
import { byId, complain } from "./elements.js";
import { showDoubt } from "./intent.js";

let stopPort = null; // of the process that stops while the service has no time
let shown = []; // the stops that the person sees, and releases: none that came since

// whether the service answered
async function showMachine(show = () => {}) {
  const state = byId("machine");
  try {
    const [drives, stop] = await Promise.all([get("/drives"), get("/stop")]);
    stopPort = stop.port;
    shown = stop.stops.map(({ id }) => id);
    byId("held").hidden = !stop.latched;
    if (stop.latched) byId("held-by").textContent = stop.stops.map(({ by, why }) => `Stopped by ${by}: ${why}`).join("; ");
    const troubles = inTrouble(drives, stop);
    state.textContent = troubles.join(", ") || "machine connected";
    state.className = `state ${troubles.length ? "bad" : "good"}`;
    byId("connect").hidden = drives.connected;
    showDoubt(drives);
    show(drives);
    return true;
  } catch (error) {
    state.textContent = error instanceof Refused ? error.message : "no word from the service";
    state.className = "state bad";
    showDoubt(null);
    return false;
  }
}

function inTrouble(drives, stop) {
  const troubles = [];
  if (drives.axes.some((axis) => axis.fault?.emergency_stop)) troubles.push("EMERGENCY STOP");
  if (stop.latched) troubles.push("stopped");
  if (!drives.connected) troubles.push(`no machine: ${drives.trouble}`);
  return troubles;
}

export function showCheckMove(move) {
  byId("check-move").hidden = !move;
  if (!move) return;
  const [way, unit] = move.unit === "rad" ? [(move.way * 180) / Math.PI, "\u00b0"] : [move.way * 1e3, " mm"];
  byId("check-move").textContent =
    `Check move: ${move.axis} goes ${way > 0 ? "+" : "\u2212"}${Math.abs(way).toFixed(1)}${unit} and back. ` +
    "Is it this axis, and does it go that way? If not: STOP.";
}

// by both ways at once; the service's answer alone says that the axes stand
async function stop() {
  const press = `${Date.now()}-${Math.random()}`;
  const words = `/stop?by=operator%20page&why=stop%20button&press=${press}`;
  const beside = stopPort ? fetch(`http://${location.hostname}:${stopPort}${words}`, { method: "POST" }) : Promise.reject();
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

// once a second `show` gets the drives; `refresh` shows the rest of the page
export function watchMachine(refresh, show) {
  let heard = true;
  const now = async () => {
    const silent = !heard;
    heard = await showMachine(show);
    if (heard && silent) await refresh();
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
  byId("stop").addEventListener("click", async () => {
    await stop();
    await now();
  });
  byId("held").addEventListener("submit", (event) => {
    event.preventDefault();
    command(() => call("POST", "/stop/reset", { by: byId("reset-by").value, stops: shown }));
  });
  byId("connect").addEventListener("click", () => command(() => call("POST", "/drives/connect")));
  const watch = async () => {
    if (!document.hidden) await now();
    if (!byId("check-move").hidden) await refresh(); // nothing tells its end
    setTimeout(watch, 1000);
  };
  watch();
}
