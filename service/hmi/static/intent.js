// What the machine does now and next, in words that somebody beside it can rely on.

import { byId, duration, element, link } from "./elements.js";
import { inWords } from "./motion.js";

const OPEN = ["waiting", "running"];
const MOVING = ["running", "pausing"];

const UNKNOWN = "The state of the axes is not known. Look at the machine.";

let doubt = null; // sentences that go before the orders, none where the drives tell how they stand; null: not asked yet
let sound = false; // nothing is wrong with the machine, as far as it is known
let orders = []; // what is ordered, parts of a paragraph
let moving = false; // an order that moves
let waits = false; // a campaign that somebody has to look after

// campaigns and diagnoses: the lists; running: the campaign that owns the machine, with its progress, or undefined;
// units: of its robot
export function showIntent(campaigns, diagnoses, running, units) {
  orders = running ? ofCampaign(running, diagnoses, units) : atRest(campaigns, diagnoses);
  moving = Boolean(running) || diagnoses.some(alone);
  waits = held(campaigns) !== undefined;
  draw();
}

// no drives: no word from the service, which the page tells elsewhere; troubles: of the machine
export function showDoubt(drives, troubles) {
  const silent = drives?.axes.filter((axis) => axis.state === "unknown").map((axis) => axis.joint);
  sound = Boolean(drives) && !troubles.length && !silent.length;
  if (!drives) doubt = null;
  else if (drives.connected && !silent.length) doubt = [];
  else doubt = [UNKNOWN, `Cause: ${drives.trouble || `no word from ${silent.join(", ")}`}.`];
  document.body.classList.toggle("sound", sound);
  draw();
}

// green only where all is known and well: what is ordered, how the axes stand, and that nothing holds them
function draw() {
  const made = element("p");
  if (doubt !== null) made.append(...doubt.map((sentence) => `${sentence} `), ...orders);
  if (byId("intent").innerHTML !== made.innerHTML) byId("intent").replaceChildren(...made.childNodes);
  byId("intent").className = kind();
}

function kind() {
  if (doubt?.length) return "unknown";
  if (moving) return "moving";
  if (waits) return "held";
  return sound && orders.length ? "still" : "";
}

export const owner = (campaigns) => campaigns.find((one) => MOVING.includes(one.state));

export const held = (campaigns) => campaigns.findLast((one) => one.state === "paused");

// the one that matters: what moves, what waits for somebody, what is to come, what was last
export const first = (campaigns) =>
  owner(campaigns) ?? held(campaigns) ?? campaigns.find((one) => one.state === "planned") ?? campaigns.at(-1);

const alone = (one) => one.unattended && OPEN.includes(one.state);

function ofCampaign(campaign, diagnoses, units) {
  const { done, total, remaining } = campaign.progress;
  const parts = ["The machine moves: ", campaignLink(campaign.id), ` runs, sweep ${Math.min(done + 1, total)} of ${total}`];
  if (campaign.motion.length) parts.push(`: ${inWords(campaign.motion, units)}`);
  parts.push(campaign.state === "pausing" ? "; it holds after this sweep. " : ". ");
  if (remaining) parts.push(`About ${duration(remaining)} left. `);
  if (campaign.attended) {
    parts.push(`It stops when nobody shows a sign of life for ${campaign.attended.within_s} s; this page shows one while it is seen. `);
  }
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
