// The motion that Start or Resume of a campaign will cause, and these commands.

import { call, get } from "./api.js";
import { showApproval } from "./approval.js";
import { byId, duration, tell } from "./elements.js";
import { showMotion } from "./motion.js";
import { aheadOf } from "./subject.js";
import { language, text } from "./words.js";

/** @type {Api.Ahead["range"] | null} */
let seen = null; // ranges of the axes that the page shows for a start; null: none

// owner: the running campaign, or undefined
/** @param {Api.CampaignView} campaign @param {Plan | null} plan @param {Units | null} units @param {Machine | null} machine @param {Api.CampaignDocument} [owner] */
export async function showOrdered({ state, progress, id }, plan, units, machine, owner) {
  const command = { planned: "ordered.start", paused: "ordered.resume" }[state];
  const again = state === "paused" && byId("repeat").checked;
  const waits = plan !== null && command !== undefined;
  const sweeps = waits ? await get(`/campaigns/${id}/sweeps`) : [];
  const due = again ? ["planned", "failed", "interrupted"] : ["planned"];
  const left = plan?.document.sweeps.filter((_, k) => due.includes(sweeps[k]?.state)) ?? [];
  const seconds = progress.remaining + (again ? progress.repeat : 0);
  await showApproval(plan, left, seconds);
  byId("repeat-choice").hidden = state !== "paused";
  byId("ordered").hidden = !left.length;
  const ahead = left.length && !owner ? await aheadOf(`/campaigns/${id}/ahead?repeat=${again}`) : null;
  tell("takes", left.length ? text(progress.pace === 1 ? "campaign.takes-planned" : "campaign.takes", { time: duration(seconds) }) : "");
  const shown = `${plan?.id}/${command}/${left.length}/${language()}/${progress.pace}/${machine?.drives.connected}/${JSON.stringify([ahead?.range, ahead?.trouble])}`;
  seen = ahead?.range ?? null;
  if (!left.length || byId("motion").dataset.shown === shown) return;
  tell("ordered-title", text(command));
  showMotion(byId("motion"), { ...plan.document, sweeps: left, duration: seconds, pace: progress.pace }, units, machine?.drives, ahead);
  byId("motion").dataset.shown = shown;
}

/** @param {Api.CampaignView} campaign @param {string} etag @param {string} name */
export const order = ({ id }, etag, name) =>
  call("POST", `/campaigns/${id}/${name}`, { start: { seen }, resume: { repeat: byId("repeat").checked, seen } }[name], { "If-Match": etag });

/** @param {Api.CampaignView} campaign */
export const questionOf = ({ id, progress }) => text("abort.question", { id, left: progress.total - progress.done });
