// What the machine will do next, in words that somebody beside it can rely on.

import { byId, fixed, link } from "./elements.js";

const OPEN = ["waiting", "running"];
const MOVING = ["running", "pausing"];

// campaigns and diagnoses: the lists; running: the campaign that owns the machine, with its progress, or undefined
export function showIntent(campaigns, diagnoses, running) {
  const parts = running ? ofCampaign(running, diagnoses) : atRest(campaigns, diagnoses);
  byId("intent").replaceChildren(...parts);
  byId("intent").classList.toggle("moving", Boolean(running) || diagnoses.some(alone));
}

export const owner = (campaigns) => campaigns.find((one) => MOVING.includes(one.state));

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
  const paused = campaigns.find((one) => one.state === "paused");
  if (paused) return ["No motion is ordered. ", campaignLink(paused.id), " is paused and goes on only when somebody resumes it."];
  return ["No motion is ordered. The machine moves only when somebody starts a campaign or approves an experiment."];
}

const campaignLink = (id) => link(`Campaign ${id}`, `./#campaign-${id}`);
