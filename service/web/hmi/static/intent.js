// The present and next motion of the machine, as reliable text for a person near the machine.

import { causeParts, toldAbove } from "./causes.js";
import { byId, duration, element, link } from "./elements.js";
import { inWords } from "./motion.js";
import { reasonOf, stepsFrom } from "./statement.js";
import { joined, parts, text, word } from "./words.js";

const OPEN = ["waiting", "running"];
const MOVING = ["running", "pausing"];

/** @type {[Api.CampaignDocument[], Api.DiagnosisEntry[], Api.CampaignView | undefined, Units | null] | null} */
let known = null; // as of `showIntent`; null: not requested yet
/** @type {Api.StatementView | null} */
let statement = null; // of the headline; null: none, which is shown elsewhere
/** @type {Machine | null} */
let machine = null; // what the headline and the banners tell
let sound = false; // no problem of the machine is known

// campaigns and diagnoses: the lists; running: the campaign that owns the machine, with its progress, or undefined;
// units: of its robot
/** @param {Api.CampaignDocument[]} campaigns @param {Api.DiagnosisEntry[]} diagnoses @param {Api.CampaignView | undefined} running @param {Units | null} units */
export function showIntent(campaigns, diagnoses, running, units) {
  known = [campaigns, diagnoses, running, units];
  draw();
}

// now: the machine's state as the headline has it, or null; well: no trouble of the machine is known; told: its answers
/** @param {Api.StatementView | null} now @param {boolean} well @param {Machine | null} told */
export function showDoubt(now, well, told) {
  [statement, machine, sound] = [now, told, well && now !== null && now.state !== "unknown"];
  document.body.classList.toggle("sound", sound);
  draw();
}

// what moves by the headline's statement: one moment for all; green only if the orders and the state of all axes are
// known and nothing holds the machine
function draw() {
  const orders = statement === null ? [] : ordersNow();
  const made = element("p");
  if (statement !== null) made.append(...doubt(), ...orders);
  if (byId("intent").innerHTML !== made.innerHTML) byId("intent").replaceChildren(...made.childNodes);
  byId("intent").className = kind(orders.length > 0);
}

// before the orders; empty if all drives report their state. Why there is no machine stands in the headline
/** @returns {Part[]} */
function doubt() {
  if (statement.state !== "unknown") return [];
  const cause = machine && !machine.drives.connected ? [] : [" ", ...parts("intent.cause", { cause: reasonOf(statement) })];
  return [text("intent.unknown"), ...cause, " "];
}

/** @returns {Part[]} as of a paragraph */
function ordersNow() {
  if (known === null) return [];
  const [campaigns, diagnoses, running, units] = known;
  return running ? ofCampaign(running, diagnoses, units) : atRest(campaigns, diagnoses);
}

/** @param {boolean} ordered */
function kind(ordered) {
  const [campaigns, diagnoses, running] = known ?? [[], []];
  if (statement?.state === "unknown") return "unknown";
  if (running || diagnoses.some(alone)) return "moving";
  if (held(campaigns)) return "held";
  return sound && ordered ? "still" : "";
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
  const { done, total, remaining, pace } = campaign.progress;
  const ahead = stepsFrom(campaign.motion, statement);
  const steps = ahead.length ? `: ${inWords(ahead, units)}` : "";
  /** @type {(Part | Part[])[]} */
  const sentences = [parts(campaign.state === "pausing" ? "intent.pausing" : "intent.runs", {
    campaign: campaignLink(campaign.id), number: Math.min(done + 1, total), total, steps,
  })];
  if (remaining) sentences.push(text(pace === 1 ? "intent.left-planned" : "intent.left", { time: duration(remaining) }));
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
  const cause = paused?.structured_cause;
  const told = !cause || (machine && toldAbove(cause, machine)) ? "" : [" (", ...causeParts(cause), ")"];
  if (paused) return parts("intent.paused", { campaign: campaignLink(paused.id), cause: told });
  return [text("intent.rest")];
}

/** @param {number} id */
const campaignLink = (id) => link(text("intent.campaign", { id }), `./#campaign-${id}`);
