// The public API, and nothing else: what these pages can do, another program can.

const API = "api/v1";

export class Refused extends Error {}

// no answer at all: the head of the page tells it
export class Silent extends Error {}

export const address = (path) => `${API}${path}`;

// patience: ms, for what a page asks again and again
export async function call(method, path, body, headers = {}, patience = null) {
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const signal = patience === null ? undefined : AbortSignal.timeout(patience);
  let answer, content;
  try {
    answer = await fetch(address(path), { method, headers, body: body && JSON.stringify(body), signal });
    content = await answer.json();
  } catch (error) {
    throw new Silent(`no answer from the service (${error.message})`);
  }
  if (!answer.ok) throw new Refused(content.detail ?? answer.statusText);
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

export const events = () => new EventSource(address("/events"));
