// The worker that all pages of this browser share: it holds their only connection to the events of the service.
// A browser opens at most six connections to a host over HTTP/1.1; one per page would leave none for STOP.

import { follow } from "./following.js";

const REFUSED = null;

/** @type {Map<MessagePort, Record<string, string> | null>} */
const pages = new Map(); // the credential of each page by its port; it never leaves this worker but to the service
/** @type {MessagePort | null} */
let user = null; // the port whose credential the connection has
let leaving = new AbortController();
let connected = false;
/** @type {(value?: unknown) => void} */
let wake = () => {};

globalThis.onconnect = (/** @type {MessageEvent} */ { ports: [port] }) => {
  port.onmessage = ({ data }) => (data === null ? leave(port) : join(port, data));
  port.onclose = () => leave(port); // a page that crashed
};

/** @param {MessagePort} port @param {Record<string, string>} credential */
function join(port, credential) {
  pages.set(port, credential);
  if (connected) port.postMessage("open");
  wake();
}

// the key of a person who left is not used any longer
/** @param {MessagePort} port */
function leave(port) {
  pages.delete(port);
  if (port === user) leaving.abort();
}

/** @param {string} kind */
function tell(kind) {
  connected = true;
  for (const port of pages.keys()) port.postMessage(kind);
}

// one login that ended does not end the events of others; pages with the same key are not asked again
/** @param {Record<string, string>} credential */
function refuse(credential) {
  for (const [port, own] of pages) if (own?.Authorization === credential.Authorization) pages.set(port, REFUSED);
}

serve();

async function serve() {
  for (;;) {
    const [port, credential] = [...pages].find(([, own]) => own !== REFUSED) ?? [];
    if (!port) {
      await new Promise((joined) => (wake = joined));
      continue;
    }
    user = port;
    leaving = new AbortController();
    const accepted = await follow(credential, leaving.signal, tell);
    connected = false;
    if (!accepted) refuse(credential);
  }
}
