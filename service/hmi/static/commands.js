// Start, Pause, Resume and Abort: what cannot work is dead, with the reason beside it.

import { unapproved } from "./approval.js";
import { byId, tell } from "./elements.js";
import { mayNot } from "./login.js";

const FITS = {
  start: ["planned"],
  pause: ["running"],
  resume: ["paused", "pausing"],
  abort: ["planned", "running", "pausing", "paused"],
};
const NAMES = Object.keys(FITS);

// campaign: the one shown, or null; machine: {drives, stop}, null: not known; owner: the campaign that runs, or undefined
export function showCommands(campaign, machine, owner) {
  for (const name of NAMES) {
    const reason = whyNot(name, campaign, machine, owner);
    byId(name).disabled = reason !== "";
    tell(`why-${name}`, reason);
  }
  if (byId("abort").disabled) ask(false);
}

function whyNot(name, campaign, machine, owner) {
  const forbidden = mayNot(`POST /campaigns/{campaign_id}/${name}`);
  if (forbidden) return forbidden;
  if (!campaign) return "no campaign";
  if (!FITS[name].includes(campaign.state)) return ofState(name, campaign);
  if (name === "pause" || name === "abort" || campaign.state === "pausing") return "";
  if (owner && owner.id !== campaign.id) return `campaign ${owner.id} runs`;
  if (!machine) return "no word of the machine";
  if (unapproved()) return unapproved();
  if (machine.stop.latched) return "the machine is stopped: release it first";
  const faulty = machine.drives.axes.filter((axis) => axis.fault).map((axis) => axis.joint);
  if (faulty.length > 2) return "acknowledge the axes first";
  return faulty.length ? `acknowledge ${faulty.join(", ")} first` : "";
}

function ofState(name, { state }) {
  if (["measured", "completed", "aborted"].includes(state)) return `${state} already`;
  if (name === "pause") return state === "pausing" ? "holds after this sweep" : "nothing runs";
  if (state === "planned") return "not started yet";
  return state === "paused" ? "started already: resume it" : "runs already";
}

function ask(asked) {
  byId("abort-question").hidden = !asked;
  byId("abort").hidden = asked;
}

// run(name) has the command done
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
