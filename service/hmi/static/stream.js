// The service's events. EventSource would do, but cannot show a key.

import { address, authorization } from "./api.js";
import { identified } from "./login.js";

const PAUSE = 1000; // ms until a lost stream is taken up again

// tells "open" whenever it is connected, and each event by its kind
export function events() {
  const told = new EventTarget();
  follow(told);
  return told;
}

async function follow(told) {
  await identified;
  let last = {}; // header that names the event seen last
  for (;;) {
    try {
      const answer = await fetch(address("/events"), { headers: { ...authorization(), ...last } });
      if (answer.status === 401) return; // the head of the page asks who it is, and loads it anew
      if (answer.ok) {
        told.dispatchEvent(new Event("open"));
        for await (const line of lines(answer.body)) {
          const [, name, value] = line.match(/^(id|event): ?(.*)$/) ?? [];
          if (name === "id") last = { "Last-Event-ID": value };
          if (name === "event") told.dispatchEvent(new Event(value));
        }
      }
    } catch {
      // the head of the page tells a service that is silent
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
