// The present and next motion of the machine, as reliable text for a person near the machine.

import { causeParts } from "./causes.js";
import { byId, duration, element, link } from "./elements.js";
import { inWords } from "./motion.js";
import { foreign, joined, parts, text, word } from "./words.js";

const OPEN = ["waiting", "running"];
const MOVING = ["running", "pausing"];

let doubt = null; // parts before the orders; empty if all drives report their state; null: not requested yet
let sound = false; // no problem of the machine is known
let orders = []; // current orders, as parts of a paragraph
let moving = false; // an order causes motion
let waits = false; // a campaign waits for a person

// campaigns and diagnoses: the lists; running: the campaign that owns the machine, with its progress, or undefined;
// units: of its robot
export function showIntent(campaigns, diagnoses, running, units) {
  orders = running ? ofCampaign(running, diagnoses, units) : atRest(campaigns, diagnoses);
  moving = Boolean(running) || diagnoses.some(alone);
  waits = held(campaigns) !== undefined;
  draw();
}

// no drives: no answer of the service, which is shown elsewhere; troubles: of the machine
export function showDoubt(drives, troubles) {
  const silent = drives?.axes.filter((axis) => axis.state === "unknown").map((axis) => axis.joint);
  sound = Boolean(drives) && !troubles.length && !silent.length;
  if (!drives) doubt = null;
  else if (drives.connected && !silent.length) doubt = [];
  else doubt = parts("intent.unknown", { cause: drives.trouble ? foreign(drives.trouble) : text("intent.no-word", { axes: silent.join(", ") }) });
  document.body.classList.toggle("sound", sound);
  draw();
}

// green only if the orders and the state of all axes are known and nothing holds the machine
function draw() {
  const made = element("p");
  if (doubt !== null) made.append(...doubt, doubt.length ? " " : "", ...orders.map((part) => (part instanceof Node ? part.cloneNode(true) : part)));
  if (byId("intent").innerHTML !== made.innerHTML) byId("intent").replaceChildren(...made.childNodes);
  byId("intent").className = kind();
}

function kind() {
  if (doubt?.length) return "unknown";
  if (moving) return "moving";
  if (waits) return "held";
  return sound && orders.length ? "still" : "";
}

export const noCampaign = () => parts("campaign.none", { page: link(text("head.plan"), "plan") });

// with the name of its machine if it belongs to another cell
export const campaignName = (one) => [`${one.id} (${word("campaign-state", one.state)})`, ...(one.here ? [] : [one.machine])].join(" \u00b7 ");

// of this service's machine: other cells can have campaigns in the same database
export const owner = (campaigns) => campaigns.find((one) => one.here && MOVING.includes(one.state));

export const held = (campaigns) => campaigns.findLast((one) => one.here && one.state === "paused");

// the most important one: the present motion, a waiting campaign, the next one, or the last one
export const first = (campaigns) =>
  owner(campaigns) ?? held(campaigns) ?? campaigns.find((one) => one.here && one.state === "planned") ?? campaigns.at(-1);

const alone = (one) => one.here && one.unattended && OPEN.includes(one.state);

function ofCampaign(campaign, diagnoses, units) {
  const { done, total, remaining } = campaign.progress;
  const steps = campaign.motion.length ? `: ${inWords(campaign.motion, units)}` : "";
  const sentences = [parts(campaign.state === "pausing" ? "intent.pausing" : "intent.runs", {
    campaign: campaignLink(campaign.id), number: Math.min(done + 1, total), total, steps,
  })];
  if (remaining) sentences.push(text("intent.left", { time: duration(remaining) }));
  if (campaign.attended) sentences.push(text("intent.attended", { seconds: campaign.attended.within_s }));
  const asking = diagnoses.find((one) => one.experiment?.campaign_id === campaign.id);
  if (asking) sentences.push(text(asking.unattended ? "intent.belongs" : "intent.then", { id: asking.id }));
  return joined(sentences, " ");
}

function atRest(campaigns, diagnoses) {
  const working = diagnoses.find(alone);
  if (working) return [text("intent.alone", { id: working.id })];
  const paused = held(campaigns);
  if (paused) return parts("intent.paused", { campaign: campaignLink(paused.id), cause: causeParts(paused.cause) });
  return [text("intent.rest")];
}

const campaignLink = (id) => link(text("intent.campaign", { id }), `./#campaign-${id}`);
