// The public API, and nothing else: what these pages can do, another program can.

const API = "api/v1";
const KEY = "sweepid-key"; // of this tab alone, and gone with it

export class Refused extends Error {}

// the service wants to know who it is: the head of the page asks
export class Unknown extends Refused {}

// no answer at all: the head of the page tells it
export class Silent extends Error {}

export const address = (path) => `${API}${path}`;

export const keep = (key) => sessionStorage.setItem(KEY, key);
export const forget = () => sessionStorage.removeItem(KEY);
export const bearer = (key) => ({ Authorization: `Bearer ${key}` });

export function authorization() {
  const key = sessionStorage.getItem(KEY);
  return key ? bearer(key) : {};
}

// patience: ms, for what a page asks again and again
export async function call(method, path, body, headers = {}, patience = null) {
  headers = { ...authorization(), ...headers };
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const signal = patience === null ? undefined : AbortSignal.timeout(patience);
  let answer, content;
  try {
    answer = await fetch(address(path), { method, headers, body: body && JSON.stringify(body), signal });
    content = await answer.json();
  } catch (error) {
    throw new Silent(`no answer from the service (${error.message})`);
  }
  if (!answer.ok) throw new (answer.status === 401 ? Unknown : Refused)(content.detail ?? answer.statusText);
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
