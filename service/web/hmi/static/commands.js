// Start, Pause, Resume and Abort: those that fit the campaign's state; what hinders one stands next to its button.

import { unapproved } from "./approval.js";
import { byId, tell } from "./elements.js";
import { mayNot } from "./login.js";
import { text } from "./words.js";

/** @type {Record<string, string[]>} */
const FITS = {
  start: ["planned"],
  pause: ["running"],
  resume: ["paused", "pausing"],
  abort: ["planned", "running", "pausing", "paused"],
};
const NAMES = Object.keys(FITS);

// campaign: displayed, or null; machine: {drives, stop}, null: not known; owner: the running campaign, or undefined
/** @param {Api.CampaignView | null} campaign @param {Machine | null} machine @param {Api.CampaignDocument} [owner] */
export function showCommands(campaign, machine, owner) {
  for (const name of NAMES) {
    const fits = campaign ? FITS[name].includes(campaign.state) : name === "start";
    const reason = fits ? whyNot(name, campaign, machine, owner) : "";
    byId(name).parentElement.hidden = !fits;
    byId(name).disabled = !fits || reason !== "";
    tell(`why-${name}`, reason);
  }
  if (byId("abort").disabled) ask(false);
}

// text or parts; empty if the command is possible
/** @param {string} name @param {Api.CampaignView | null} campaign @param {Machine | null} machine @param {Api.CampaignDocument} [owner] @returns {Content} */
function whyNot(name, campaign, machine, owner) {
  const forbidden = mayNot(`POST /campaigns/{campaign_id}/${name}`);
  if (forbidden) return forbidden;
  if (!campaign) return text("why.no-campaign");
  if (name === "pause" || name === "abort" || campaign.state === "pausing") return "";
  if (owner && owner.id !== campaign.id) return text("why.another-runs", { id: owner.id });
  if (!machine) return text("why.no-word");
  if (unapproved()) return unapproved();
  if (machine.stop.latched) return text("why.stopped");
  const faulty = machine.drives.axes.filter((axis) => axis.fault).map((axis) => axis.joint);
  if (faulty.length > 2) return text("why.faults");
  return faulty.length ? text("why.fault", { axes: faulty.join(", ") }) : "";
}

function ask(asked) {
  byId("abort-question").hidden = !asked;
  byId("abort").hidden = asked;
}

// run(name) executes the command
/** @param {(name: string) => void} run @param {() => string} question */
export function watchCommands(run, question) {
  for (const name of ["start", "pause", "resume"]) byId(name).addEventListener("click", () => run(name));
  byId("abort").addEventListener("click", () => {
    tell("abort-text", question());
    ask(true);
    byId("abort-not").focus();
  });
  byId("abort-not").addEventListener("click", () => {
    ask(false);
    byId("abort").focus();
  });
  byId("abort-yes").addEventListener("click", () => {
    ask(false);
    run("abort");
  });
}
