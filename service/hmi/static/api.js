// The public API only: another program can do everything that these pages can do.

import { foreign, knows, parts, Told } from "./words.js";

const API = "api/v1";
const KEY = "sweepid-key"; // stored for this browser tab only

// problem: as in RFC 9457; its kind is shown in the language of the page, its detail unchanged
export class Refused extends Error {
  constructor({ type = "", detail }) {
    super(detail);
    const kind = `problem.${type.split(":").at(-1)}`;
    this.parts = () => (knows(kind) ? parts(kind, { detail: foreign(detail) }) : [foreign(detail)]);
  }
}

// the service requires a login: the head of the page asks for it
export class Unknown extends Refused {}

// no answer: the head of the page shows it
export class Silent extends Told {}

export const address = (path) => `${API}${path}`;

export const keep = (key) => sessionStorage.setItem(KEY, key);
export const forget = () => sessionStorage.removeItem(KEY);
export const bearer = (key) => ({ Authorization: `Bearer ${key}` });

export function authorization() {
  const key = sessionStorage.getItem(KEY);
  return key ? bearer(key) : {};
}

// a browser cannot send headers when it opens a WebSocket: the key is sent as a subprotocol
export function protocols() {
  const key = sessionStorage.getItem(KEY);
  return ["sweepid.live", ...(key ? [`sweepid.key.${key}`] : [])];
}

let epoch = null; // of the machine's state that the page got last: a command given before a stop is refused after it

// patience: ms, for requests that a page repeats
export async function call(method, path, body, headers = {}, patience = null) {
  headers = { ...authorization(), ...headers };
  if (epoch && method !== "GET") headers["Sweepid-Epoch"] = epoch;
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const signal = patience === null ? undefined : AbortSignal.timeout(patience);
  let answer, content;
  try {
    answer = await fetch(address(path), { method, headers, body: body && JSON.stringify(body), signal });
    content = await answer.json();
  } catch (error) {
    throw new Silent("error.silent", { why: foreign(error.message) });
  }
  if (!answer.ok) throw new (answer.status === 401 ? Unknown : Refused)({ type: content.type, detail: content.detail ?? answer.statusText });
  epoch = content?.epoch ?? epoch;
  return { content, etag: answer.headers.get("ETag") };
}

export const get = async (path, patience = null) => (await call("GET", path, undefined, {}, patience)).content;

export async function all(path) {
  let items = [];
  let page = { next: 0 };
  while (page.next !== null) {
    page = await get(`${path}${path.includes("?") ? "&" : "?"}limit=200&after=${page.next}`);
    items = items.concat(page.items);
  }
  return items;
}
