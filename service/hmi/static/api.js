// The public API, and nothing else: what these pages can do, another program can.

const API = "api/v1";

export class Refused extends Error {}

export const address = (path) => `${API}${path}`;

export async function call(method, path, body, headers = {}) {
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const answer = await fetch(address(path), { method, headers, body: body && JSON.stringify(body) });
  const content = await answer.json();
  if (!answer.ok) throw new Refused(content.detail ?? answer.statusText);
  return { content, etag: answer.headers.get("ETag") };
}

export const get = async (path) => (await call("GET", path)).content;

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
