// One connection to the events of the service. EventSource cannot be used because it cannot send a key.
// Runs in a page or in the worker that all pages share: no import that needs a document.

const PAUSE = 1000; // ms until a lost connection is opened again
const QUIET = 40_000; // ms without a byte until a connection counts as lost: the service sends one every 15 s

/** @type {Record<string, string>} */
let last = {}; // header with the id of the last event

// credential: the header with a key, or {} for a session. `tell` gets "open", then the kind of each event: never its content.
// Returns whether the service still accepts the credential; waits before it returns true.
/** @param {Record<string, string>} credential @param {AbortSignal} ended @param {(kind: string) => void} tell */
export async function follow(credential, ended, tell) {
  try {
    const quiet = new AbortController();
    const answer = await fetch("api/v1/events", { headers: { ...credential, ...last }, signal: AbortSignal.any([ended, quiet.signal]), cache: "no-store" });
    if (answer.status === 401) return false;
    if (answer.ok) {
      tell("open");
      for await (const line of lines(answer.body, quiet)) {
        const [, name, value] = line.match(/^(id|event): ?(.*)$/) ?? [];
        if (name === "id") last = { "Last-Event-ID": value };
        if (name === "event") tell(value);
      }
    }
  } catch {
    // the head of the page shows that the service does not answer
  }
  if (!ended.aborted) await new Promise((done) => setTimeout(done, PAUSE));
  return true;
}

/** @param {ReadableStream<Uint8Array<ArrayBuffer>>} body @param {AbortController} quiet */
async function* lines(body, quiet) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const late = setTimeout(() => quiet.abort(), QUIET);
    const { value, done } = await reader.read().finally(() => clearTimeout(late));
    if (done) return;
    const found = (rest + value).split(/\r?\n/);
    rest = found.pop();
    yield* found;
  }
}
