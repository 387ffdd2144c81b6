// The user of this page, if the service has a login. STOP needs no login.

import { authorization, bearer, call, forget, get, keep, Refused, Unknown } from "./api.js";
import { PAGE } from "./causes.js";
import { byId, complain, element, tell } from "./elements.js";
import { cameBack, leaveForOidc, showOidc } from "./oidc.js";
import { kept, store, text, told, word } from "./words.js";

const NAME = "sweepid-name"; // kept until the tab is closed
const KNOWN = "sweepid-names"; // last ones of this browser, a line each
const NAMES = "input[autocomplete=name]";

/** @type {Api.Me | null} */
let me = null; // {login, name, role, session, refused}; null: not known yet
const NOTHING_GIVEN = "not authenticated"; // prefix of the answer to a request without credentials: no user error

/** @type {(Error & {parts?: () => Part[]}) | null} */
let refusal = null; // why no user is logged in

/** @type {(value?: unknown) => void} */
let known;
export const identified = new Promise((done) => (known = done));

// asks once and keeps an error until the page is reloaded: each refusal makes an entry in the audit
export async function identify(patience) {
  if (refusal) throw refusal;
  if (me) return;
  const why = await cameBack();
  try {
    me = await get("/me", patience);
  } catch (error) {
    if (!(error instanceof Unknown)) throw error;
    if (why) error.parts = () => told(why);
    else if (error.message.startsWith(NOTHING_GIVEN)) error.parts = () => []; // who has not tried yet did nothing wrong
    throw error;
  }
  byId("me").hidden = !me.login;
  fillIn(me.login ? me.name : (sessionStorage.getItem(NAME) ?? ""));
  showRights();
  known();
}

/** @returns {string[]} */
const namesKnown = () => (me.login ? [me.name] : kept(KNOWN)?.split("\n") ?? []);

// a stop is released by one press of a glove; drawn when a stop is shown, not while a finger is on the form
export function offerNames() {
  const names = !me || mayNot("POST /stop/reset") ? [] : namesKnown();
  byId("release-as").replaceChildren(...names.map((name) => {
    const button = element("button", text("stop.release-as", { name }));
    button.addEventListener("click", () => (byId("reset-by").value = name)); // before it submits the form
    return button;
  }));
}

// a person types the name once: with gloves every letter is work
/** @param {string} name */
function fillIn(name) {
  for (const input of /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll(NAMES))) input.value ||= name;
}

/** @param {Event} event */
function remember({ target }) {
  const input = /** @type {HTMLInputElement} */ (target);
  if (!input.matches(NAMES)) return;
  sessionStorage.setItem(NAME, input.value);
  fillIn(input.value);
  if (!me || me.login || !input.value.trim()) return;
  store(KNOWN, [...new Set([input.value.trim(), ...namesKnown()])].slice(0, 4).join("\n"));
}

// shows the user, and next to each disabled button the reason
export function showRights() {
  if (refusal) tellWhy();
  if (!me) return;
  offerNames();
  tell("me-who", `${me.name}, ${word("role", me.role)}`);
  for (const old of document.querySelectorAll("small.needs")) old.remove();
  for (const button of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("[data-needs]"))) {
    const reason = mayNot(button.dataset.needs);
    if (!reason) continue;
    button.disabled = true;
    button.after(element("small", reason, "needs"));
  }
}

// name for a stop
export const presser = () => (me?.login ? `${me.name} (${PAGE})` : PAGE);

// why this user may not; empty if allowed. command: method and path as in the API
/** @param {string} command */
export function mayNot(command) {
  const needed = me?.refused[command];
  return needed ? text("why.role", { needed: word("role", needed), role: word("role", me.role) }) : "";
}

const tellWhy = () => tell("login-why", told(refusal));

/** @param {Error} error */
export function askWho(error) {
  if (refusal) return;
  refusal = error;
  tellWhy();
  document.body.classList.add("nobody");
  for (const id of ["held", "connect", "way-out", "me"]) byId(id).hidden = true;
  byId("login").hidden = false;
  showOidc().catch(complain);
}

/** @param {SubmitEvent} event */
async function logIn(event) {
  event.preventDefault();
  const [name, password, key] = ["user", "password", "key"].map((id) => byId(id).value);
  if (!key && !(name && password)) return tell("login-why", text("login.incomplete"));
  forget(); // the old key
  try {
    if (key) await call("GET", "/me", undefined, bearer(key));
    else await call("POST", "/login", { name, password });
  } catch (error) {
    tell("login-why", told(error));
    return;
  }
  if (key) keep(key);
  location.reload();
}

async function logOut() {
  try {
    if (me.session) await call("POST", "/logout");
    forget();
    location.reload();
  } catch (error) {
    complain(error);
  }
}

// a link does not send the key: its target is fetched and saved
/** @param {HTMLAnchorElement} link */
async function save(link) {
  const answer = await fetch(link.href, { headers: authorization() });
  if (!answer.ok) throw new Refused(await answer.json());
  const name = link.pathname.split("/api/v1/")[1].replaceAll("/", "-");
  const saved = element("a");
  saved.href = URL.createObjectURL(await answer.blob());
  saved.download = name.includes(".") ? name : `${name}.html`;
  saved.click();
  URL.revokeObjectURL(saved.href);
}

export function watchLogin() {
  byId("login").addEventListener("submit", logIn);
  byId("oidc").addEventListener("click", leaveForOidc);
  byId("log-out").addEventListener("click", logOut);
  document.addEventListener("change", remember);
  document.addEventListener("click", (click) => {
    const link = /** @type {Element} */ (click.target).closest("a");
    if (!me?.login || me.session || !link?.pathname.includes("/api/v1/")) return;
    click.preventDefault();
    save(link).catch(complain);
  });
}
