// The present and next motion of the machine, as reliable text for a person near the machine.

import { causeParts } from "./causes.js";
import { byId, duration, element, link } from "./elements.js";
import { inWords } from "./motion.js";
import { reasonOf } from "./statement.js";
import { joined, parts, text, word } from "./words.js";

const OPEN = ["waiting", "running"];
const MOVING = ["running", "pausing"];

/** @type {Part[] | null} */
let doubt = null; // parts before the orders; empty if all drives report their state; null: not requested yet
let sound = false; // no problem of the machine is known
/** @type {Part[]} */
let orders = []; // current orders, as parts of a paragraph
let moving = false; // an order causes motion
let waits = false; // a campaign waits for a person

// campaigns and diagnoses: the lists; running: the campaign that owns the machine, with its progress, or undefined;
// units: of its robot
/** @param {Api.CampaignDocument[]} campaigns @param {Api.DiagnosisEntry[]} diagnoses @param {Api.CampaignView | undefined} running @param {Units | null} units */
export function showIntent(campaigns, diagnoses, running, units) {
  orders = running ? ofCampaign(running, diagnoses, units) : atRest(campaigns, diagnoses);
  moving = Boolean(running) || diagnoses.some(alone);
  waits = held(campaigns) !== undefined;
  draw();
}

// statement: of the machine's state; null: none, which is shown elsewhere. well: no trouble of the machine is known;
// cause: why it is not connected, if a code tells it
/** @param {Api.StatementView | null} statement @param {boolean} well @param {Api.Cause | null} [cause] */
export function showDoubt(statement, well, cause = null) {
  sound = well && statement !== null && statement.state !== "unknown";
  if (statement === null) doubt = null;
  else doubt = statement.state === "unknown" ? parts("intent.unknown", { cause: cause ? causeParts(cause) : reasonOf(statement) }) : [];
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
/** @param {Api.CampaignDocument} one */
export const campaignName = (one) => [`${one.id} (${word("campaign-state", one.state)})`, ...(one.here ? [] : [one.machine])].join(" \u00b7 ");

// of this service's machine: other cells can have campaigns in the same database
/** @param {Api.CampaignDocument[]} campaigns */
export const owner = (campaigns) => campaigns.find((one) => one.here && MOVING.includes(one.state));

/** @param {Api.CampaignDocument[]} campaigns */
export const held = (campaigns) => campaigns.findLast((one) => one.here && one.state === "paused");

// the most important one: the present motion, a waiting campaign, the next one, or the last one
/** @param {Api.CampaignDocument[]} campaigns */
export const first = (campaigns) =>
  owner(campaigns) ?? held(campaigns) ?? campaigns.find((one) => one.here && one.state === "planned") ?? campaigns.at(-1);

/** @param {Api.DiagnosisEntry} one */
const alone = (one) => one.here && one.unattended && OPEN.includes(one.state);

/** @param {Api.CampaignView} campaign @param {Api.DiagnosisEntry[]} diagnoses @param {Units} units */
function ofCampaign(campaign, diagnoses, units) {
  const { done, total, remaining } = campaign.progress;
  const steps = campaign.motion.length ? `: ${inWords(campaign.motion, units)}` : "";
  /** @type {(Part | Part[])[]} */
  const sentences = [parts(campaign.state === "pausing" ? "intent.pausing" : "intent.runs", {
    campaign: campaignLink(campaign.id), number: Math.min(done + 1, total), total, steps,
  })];
  if (remaining) sentences.push(text("intent.left", { time: duration(remaining) }));
  if (campaign.attended) sentences.push(text("intent.attended", { seconds: campaign.attended.within_s }));
  const asking = diagnoses.find((one) => one.experiment?.campaign_id === campaign.id);
  if (asking) sentences.push(text(asking.unattended ? "intent.belongs" : "intent.then", { id: asking.id }));
  return joined(sentences, " ");
}

/** @param {Api.CampaignDocument[]} campaigns @param {Api.DiagnosisEntry[]} diagnoses */
function atRest(campaigns, diagnoses) {
  const working = diagnoses.find(alone);
  if (working) return [text("intent.alone", { id: working.id })];
  const paused = held(campaigns);
  if (paused) return parts("intent.paused", { campaign: campaignLink(paused.id), cause: paused.structured_cause ? [" (", ...causeParts(paused.structured_cause), ")"] : "" });
  return [text("intent.rest")];
}

/** @param {number} id */
const campaignLink = (id) => link(text("intent.campaign", { id }), `./#campaign-${id}`);
