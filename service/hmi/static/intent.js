// What the machine will do next, in words that somebody beside it can rely on.

import { byId, fixed, link } from "./elements.js";

const OPEN = ["waiting", "running"];
const MOVING = ["running", "pausing"];

const NO_WORD = ["Nobody here knows what the machine does: take it that it may move."];
const UNKNOWN = "The state of the axes is not known. Look at the machine.";

let doubt = null; // sentences that go before the orders, none where the drives tell how they stand; null: not asked yet
let orders = []; // what is ordered, parts of a paragraph
let moving = false; // an order that moves

// campaigns and diagnoses: the lists; running: the campaign that owns the machine, with its progress, or undefined
export function showIntent(campaigns, diagnoses, running) {
  orders = running ? ofCampaign(running, diagnoses) : atRest(campaigns, diagnoses);
  moving = Boolean(running) || diagnoses.some(alone);
  draw();
}

// no drives: no word from the service
export function showDoubt(drives) {
  const silent = drives?.axes.filter((axis) => axis.state === "unknown").map((axis) => axis.joint);
  if (!drives) doubt = NO_WORD;
  else if (drives.connected && !silent.length) doubt = [];
  else doubt = [UNKNOWN, `Cause: ${drives.trouble || `no word from ${silent.join(", ")}`}.`];
  draw();
}

// green only where both are known: what is ordered, and how the axes stand
function draw() {
  const parts = (doubt ?? []).map((sentence) => `${sentence} `);
  byId("intent").replaceChildren(...parts, ...(doubt === NO_WORD ? [] : orders));
  byId("intent").className = parts.length ? "unknown" : moving ? "moving" : doubt && orders.length ? "still" : "";
}

export const owner = (campaigns) => campaigns.find((one) => MOVING.includes(one.state));

export const held = (campaigns) => campaigns.findLast((one) => one.state === "paused");

const alone = (one) => one.unattended && OPEN.includes(one.state);

function ofCampaign(campaign, diagnoses) {
  const { done, total, current } = campaign.progress;
  const parts = ["The machine moves: ", campaignLink(campaign.id), ` runs, sweep ${Math.min(done + 1, total)} of ${total}`];
  if (current) parts.push(`, ${current.spec.axis} at [${current.spec.pose.map((q) => fixed(q, 2)).join(", ")}] rad`);
  parts.push(campaign.state === "pausing" ? "; it holds after this sweep. " : ". ");
  const asking = diagnoses.find((one) => one.experiment?.campaign_id === campaign.id);
  if (asking?.unattended) {
    parts.push(`It belongs to diagnosis ${asking.id}, which runs alone: the next experiment may start by itself.`);
  } else if (asking) {
    parts.push(`When it is completed, diagnosis ${asking.id} goes on by itself; no motion follows without an approval.`);
  }
  return parts;
}

function atRest(campaigns, diagnoses) {
  const working = diagnoses.find(alone);
  if (working) return [`Diagnosis ${working.id} runs alone: the machine will start by itself as soon as it knows what to measure.`];
  const paused = held(campaigns);
  if (paused) {
    return ["No motion is ordered. ", campaignLink(paused.id), ` is paused (${paused.cause}) and goes on only when somebody resumes it.`];
  }
  return ["No motion is ordered. The next begins only when somebody starts a campaign or approves an experiment."];
}

const campaignLink = (id) => link(`Campaign ${id}`, `./#campaign-${id}`);
