// Who works with this page, where the service asks. STOP needs nobody.

import { authorization, bearer, call, forget, get, keep, Refused } from "./api.js";
import { byId, complain, element, tell } from "./elements.js";

let me = null; // {login, name, role, session, refused}; null: not known yet
let refusal = null; // why nobody is logged in

let known;
export const identified = new Promise((done) => (known = done));

// asks once; what it throws is the same until the page is loaded anew: each refusal has its line in the audit
export async function identify(patience) {
  if (refusal) throw refusal;
  if (me) return;
  me = await get("/me", patience);
  byId("me").hidden = !me.login;
  tell("me-who", `${me.name}, ${me.role}`);
  if (me.login) for (const input of document.querySelectorAll("[autocomplete=name]")) input.value ||= me.name;
  for (const button of document.querySelectorAll("[data-needs]")) {
    const reason = mayNot(button.dataset.needs);
    if (!reason) continue;
    button.disabled = true;
    button.after(element("small", reason, "needs"));
  }
  known();
}

// who stops
export const presser = () => (me?.login ? `${me.name} (operator page)` : "operator page");

// why this person may not; empty for who may. command: method and path as the API has them
export function mayNot(command) {
  const needed = me?.refused[command];
  return needed ? `needs ${needed}, you are ${me.role}` : "";
}

export function askWho(error) {
  if (refusal) return;
  refusal = error;
  tell("login-why", error.message);
  document.body.classList.add("nobody");
  for (const id of ["held", "connect", "way-out", "me"]) byId(id).hidden = true;
  byId("login").hidden = false;
}

async function logIn(event) {
  event.preventDefault();
  const [name, password, key] = ["user", "password", "key"].map((id) => byId(id).value);
  if (!key && !(name && password)) return tell("login-why", "name and password, or a key");
  forget(); // of what opens no longer
  try {
    if (key) await call("GET", "/me", undefined, bearer(key));
    else await call("POST", "/login", { name, password });
  } catch (error) {
    tell("login-why", error.message);
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

// a link shows no key: what it leads to is fetched and saved
async function save(link) {
  const answer = await fetch(link.href, { headers: authorization() });
  if (!answer.ok) throw new Refused((await answer.json()).detail);
  const name = link.pathname.split("/api/v1/")[1].replaceAll("/", "-");
  const saved = element("a");
  saved.href = URL.createObjectURL(await answer.blob());
  saved.download = name.includes(".") ? name : `${name}.html`;
  saved.click();
  URL.revokeObjectURL(saved.href);
}

export function watchLogin() {
  byId("login").addEventListener("submit", logIn);
  byId("log-out").addEventListener("click", logOut);
  document.addEventListener("click", (click) => {
    const link = click.target.closest("a");
    if (!me?.login || me.session || !link?.pathname.includes("/api/v1/")) return;
    click.preventDefault();
    save(link).catch(complain);
  });
}
