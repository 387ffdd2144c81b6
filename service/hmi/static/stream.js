// The events of the service. EventSource cannot be used because it cannot send a key.

import { address, authorization } from "./api.js";
import { identified } from "./login.js";

const PAUSE = 1000; // ms until a lost stream is opened again

// dispatches "open" at each connection, and each event by its kind
export function events() {
  const told = new EventTarget();
  follow(told);
  return told;
}

async function follow(told) {
  await identified;
  let last = {}; // header with the id of the last event
  for (;;) {
    try {
      const answer = await fetch(address("/events"), { headers: { ...authorization(), ...last } });
      if (answer.status === 401) return; // the head of the page asks for the login and reloads the page
      if (answer.ok) {
        told.dispatchEvent(new Event("open"));
        for await (const line of lines(answer.body)) {
          const [, name, value] = line.match(/^(id|event): ?(.*)$/) ?? [];
          if (name === "id") last = { "Last-Event-ID": value };
          if (name === "event") told.dispatchEvent(new Event(value));
        }
      }
    } catch {
      // the head of the page shows that the service does not answer
    }
    await new Promise((done) => setTimeout(done, PAUSE));
  }
}

async function* lines(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const found = (rest + value).split(/\r?\n/);
    rest = found.pop();
    yield* found;
  }
}
