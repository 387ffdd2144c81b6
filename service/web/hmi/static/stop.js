// STOP: by every way at once, and what is known of it. Sent is not stopped: only what the drives report confirms it.

import { address, authorization } from "./api.js";
import { PRESSED } from "./causes.js";
import { byId, tell } from "./elements.js";
import { presser } from "./login.js";
import { heard, LIMIT, pressed, told } from "./pressed.js";
import { foreign, joined, parts, text } from "./words.js";

/** @typedef {import("./pressed.js").Press} Press @typedef {import("./pressed.js").StopAnswer} StopAnswer */

/** @type {Press | null} */
let last = null; // what is known of the last press

// port: of the stop process, or null. Returns when every way has answered or failed
/** @param {number | null} port */
export async function stop(port) {
  const press = `${Date.now()}-${Math.random()}`; // the same by every way: one stop
  const words = `/stop?by=${encodeURIComponent(presser())}&why=${encodeURIComponent(PRESSED)}&press=${press}`;
  const now = pressed(1);
  const ways = [toService(address(words), () => know(now, { left: true }))];
  if (port) ways.push(toProcess(`${location.protocol}//${location.hostname}:${port}${words}`));
  const { proxied } = byId("stop").dataset; // address of the stop process at the proxy
  if (proxied) ways.push(toProcess(words.replace("/stop", proxied)));
  now.waiting = ways.length;
  last = now;
  showStop();
  setTimeout(() => know(now, { late: true }), LIMIT);
  await Promise.all(ways.map((way) => way.then((answer) => heard(answer, now), () => /** @type {Partial<Press>} */ ({})).then((more) => know(now, { ...more, waiting: now.waiting - 1 }))));
}

/** @param {Press} press @param {Partial<Press>} more */
function know(press, more) {
  Object.assign(press, more);
  if (press === last) showStop();
}

// not `fetch`: only this tells when a request has left the browser. A page that is closed meanwhile sends it all the same
/** @param {string} url @param {() => void} left @returns {Promise<StopAnswer>} */
function toService(url, left) {
  const again = () => fetch(url, { method: "POST", keepalive: true });
  addEventListener("pagehide", again);
  return new Promise((done, failed) => {
    const request = new XMLHttpRequest();
    request.upload.onload = left;
    request.onload = () => done({ status: request.status, content: request.response ?? {} });
    request.onerror = failed;
    request.open("POST", url);
    request.responseType = "json";
    for (const [name, value] of Object.entries(authorization())) request.setRequestHeader(name, value);
    request.send("stop"); // without a body the browser does not tell that it was sent
  }).finally(() => removeEventListener("pagehide", again));
}

// the stop process, directly or through a proxy: it needs no login and works while the service is busy
/** @param {string} url @returns {Promise<StopAnswer>} */
async function toProcess(url) {
  const answer = await fetch(url, { method: "POST", keepalive: true, priority: "high" });
  /** @type {StopAnswer["content"]} */
  const content = await answer.json();
  if (answer.status !== 503 && !answer.ok) throw new Error(content.detail); // not the stop process
  return { status: answer.status, content: { confirmed: content.confirmed, unconfirmed: content.unconfirmed } };
}

// after a change of the language, too
export function showStop() {
  const place = byId("stop-told");
  place.hidden = last === null;
  if (last === null) return;
  const now = told(last);
  tell("stop-told", inWords(now));
  place.className = `banner ${now.text === "stop.confirmed" ? "confirmed" : now.over ? "" : "open"}`;
}

/** @param {ReturnType<typeof told>} now @returns {Content} */
function inWords({ text: key, axes, refusal }) {
  if (key === "stop.refused") return parts(key, { why: foreign(refusal) });
  if (key !== "stop.unconfirmed") return text(key);
  return parts(key, { axes: joined(Object.entries(axes).map(([joint, reason]) => [`${joint}: `, foreign(reason)]), "; ") });
}

// latched: whether the machine is held. A person who released it has seen what became of the press
/** @param {boolean} latched */
export function settleStop(latched) {
  if (last?.latched && !latched) last = null;
  else if (last) last.latched = latched;
  showStop();
}
