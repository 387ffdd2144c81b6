// Login at the identity provider: starts with a button and returns with a code in the address of this page.

import { call, forget, get } from "./api.js";
import { byId, tell } from "./elements.js";
import { outside, Told, told } from "./words.js";

let handedIn = null;

// the error of a login that returns to this page; null if there was no error or no login. Asks once.
export const cameBack = () => (handedIn ??= handIn());

async function handIn() {
  const brought = new URLSearchParams(location.search);
  const [state, code, error] = ["state", "code", "error"].map((name) => brought.get(name));
  if (!state || !(code || error)) return null;
  history.replaceState(null, "", location.pathname); // a code is valid once and must not stay in the browser history
  if (!code) return /^[a-z_]{1,40}$/.test(error) ? new Told("login.oidc-said", { error: outside("system", error) }) : new Told("login.oidc-refused");
  forget(); // a key would have priority over the session
  try {
    await call("POST", "/login/oidc/code", { code, state });
    return null;
  } catch (refused) {
    return refused;
  }
}

export async function showOidc() {
  const { oidc } = await get("/login");
  byId("oidc").hidden = !oidc;
  tell("oidc", oidc ?? "");
}

export async function leaveForOidc() {
  try {
    location.assign((await call("POST", "/login/oidc")).content.url);
  } catch (error) {
    tell("login-why", told(error));
  }
}
