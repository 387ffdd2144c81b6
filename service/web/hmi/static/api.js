// The public API only: another program can do everything that these pages can do.

import { foreign, knows, outside, parts, Told } from "./words.js";

const API = "api/v1";
const TURN = 250; // ms for an answer that arrived while the page drew a plan: it is not late
const KEY = "sweepid-key"; // stored for this browser tab only

// The types in the comments of these scripts (`Api.NAME`) are those of the OpenAPI document; a test checks them.

// problem: as in RFC 9457; its kind is shown in the language of the page, its detail unchanged
export class Refused extends Error {
  /** @param {{type?: string, detail: string}} problem */
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
/** @param {string} key @returns {Record<string, string>} */
export const bearer = (key) => ({ Authorization: `Bearer ${key}` });

/** @returns {Record<string, string>} */
export function authorization() {
  const key = sessionStorage.getItem(KEY);
  return key ? bearer(key) : {};
}

// a browser cannot send headers when it opens a WebSocket: the key is sent as a subprotocol
export function protocols() {
  const key = sessionStorage.getItem(KEY);
  return ["sweepid.live", ...(key ? [`sweepid.key.${key}`] : [])];
}

/** @type {string | null} */
let epoch = null; // of the machine's state that the page got last: a command given before a stop is refused after it

/**
 * patience: ms, for requests that a page repeats
 * @template {string} M
 * @template {string} P
 * @param {M} method
 * @param {P} path
 * @param {object} [body]
 * @param {Record<string, string>} [headers]
 * @param {number | null} [patience]
 * @returns {Promise<{content: Api.Answer<M, P>, etag: string}>}
 */
export async function call(method, path, body, headers = {}, patience = null) {
  headers = { ...authorization(), ...headers };
  if (epoch && method !== "GET") headers["Sweepid-Epoch"] = epoch;
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const late = new AbortController();
  const timer = patience === null ? null : setTimeout(() => setTimeout(() => late.abort(), TURN), patience);
  let answer;
  let content = /** @type {Partial<Api.Problem>} */ ({});
  try {
    // the cache of a browser lets a page wait for the answer to an equal request of another page
    answer = await fetch(address(path), { method, headers, body: body && JSON.stringify(body), signal: late.signal, cache: "no-store" });
    content = await answer.json();
  } catch (error) {
    throw new Silent("error.silent", { why: outside("system", /** @type {Error} */ (error).message) });
  } finally {
    clearTimeout(timer);
  }
  if (!answer.ok) throw new (answer.status === 401 ? Unknown : Refused)({ type: content.type, detail: content.detail ?? answer.statusText });
  epoch = /** @type {{epoch?: string}} */ (content)?.epoch ?? epoch;
  return /** @type {any} */ ({ content, etag: answer.headers.get("ETag") });
}

/**
 * @template {string} P
 * @param {P} path
 * @param {number | null} [patience]
 */
export const get = async (path, patience = null) => (await call("GET", path, undefined, {}, patience)).content;

/**
 * @template {string} P
 * @param {P} path
 * @returns {Promise<Api.Items<P>>}
 */
export async function all(path) {
  let items = /** @type {object[]} */ ([]);
  let next = 0;
  while (next !== null) {
    /** @type {{items: object[], next: number}} */
    const page = (await call("GET", /** @type {string} */ (`${path}${path.includes("?") ? "&" : "?"}limit=200&after=${next}`))).content;
    items = items.concat(page.items);
    next = page.next;
  }
  return /** @type {any} */ (items);
}
