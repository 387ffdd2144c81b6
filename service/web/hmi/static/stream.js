// The events of the service, over one connection for all pages of this browser (events.js).

import { authorization } from "./api.js";
import { follow } from "./following.js";
import { identified } from "./login.js";

const NAME = "sweepid-events";

// dispatches "open" at each connection, and each event by its kind
export function events() {
  const told = new EventTarget();
  identified.then(() => join((kind) => told.dispatchEvent(new Event(kind))));
  return told;
}

/** @param {(kind: string) => void} tell */
function join(tell) {
  if (!globalThis.SharedWorker) return lead(tell);
  const worker = new SharedWorker("events.js", { type: "module", name: NAME });
  const enter = () => worker.port.postMessage(authorization());
  worker.onerror = () => lead(tell); // this browser has no shared workers of modules
  worker.port.onmessage = ({ data }) => tell(data);
  addEventListener("pagehide", () => worker.port.postMessage(null));
  addEventListener("pageshow", ({ persisted }) => persisted && enter());
  enter();
}

// without shared workers the page that gets the lock has the connection, with its own key, and tells the others the kinds
// of events. The next page gets the lock when it is closed or when its login has ended
/** @param {(kind: string) => void} tell */
function lead(tell) {
  if (!navigator.locks) return keep(tell); // not a secure context: each page has its own
  const channel = new BroadcastChannel(NAME);
  channel.onmessage = ({ data }) => tell(data);
  tell("open"); // events were possibly missed
  navigator.locks.request(NAME, () => keep((kind) => {
    tell(kind);
    channel.postMessage(kind);
  }));
}

/** @param {(kind: string) => void} tell */
async function keep(tell) {
  const never = new AbortController().signal;
  while (await follow(authorization(), never, tell));
}
