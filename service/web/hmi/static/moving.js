// The campaign that moves the machine, requested once a second: its steps are shorter than its events.

import { call, get } from "./api.js";
import { byId, fixed, minus, tell } from "./elements.js";
import { showIntent } from "./intent.js";
import { mayNot } from "./login.js";
import { unitsOf } from "./motion.js";
import { text } from "./words.js";

const STATES = ["running", "pausing"];
const PATIENCE = 5000; // ms

/** @type {[Api.CampaignDocument[], Api.DiagnosisEntry[]]} */
let lists = [[], []]; // campaigns and diagnoses of the last answer
let owner = null; // id

// from the lists: the campaign with its progress, or undefined
/** @param {Api.CampaignDocument[]} campaigns @param {Api.DiagnosisEntry[]} diagnoses */
export async function showMoving(campaigns, diagnoses) {
  lists = [campaigns, diagnoses];
  const found = campaigns.find((one) => STATES.includes(one.state));
  owner = found?.id ?? null;
  return draw();
}

// again, while the machine moves; `ended` is called when the motion has ended
/** @param {() => Promise<void>} ended */
export async function keepMoving(ended) {
  const before = owner;
  const campaign = await draw();
  if (before !== null && campaign === undefined) await ended();
  return campaign;
}

async function draw() {
  const asked = owner;
  const campaign = asked === null ? undefined : await get(`/campaigns/${asked}`, PATIENCE);
  if (asked !== owner) return undefined; // the lists have changed meanwhile
  const moves = campaign && STATES.includes(campaign.state);
  if (campaign && !moves) owner = null;
  showIntent(...lists, moves ? campaign : undefined, moves ? await unitsOf(campaign.robot_id) : null);
  showCheckMove(moves ? campaign.check_move : null);
  if (moves) showLife(campaign);
  return moves ? campaign : undefined;
}

// a visible page sends the sign of life of its user; without it, the axes stop
/** @param {Api.CampaignView} campaign */
function showLife({ id, attended }) {
  if (!attended || document.hidden || mayNot("POST /campaigns/{campaign_id}/sign_of_life")) return;
  if (attended.left_s > (2 / 3) * attended.within_s) return;
  call("POST", `/campaigns/${id}/sign_of_life`, undefined, {}, PATIENCE).catch(() => {}); // the state shows the result
}

/** @param {Api.CheckMoveView | null} move */
function showCheckMove(move) {
  byId("check-move").hidden = !move;
  if (!move) return;
  const [way, unit] = move.unit === "rad" ? [(move.way * 180) / Math.PI, "\u00b0"] : [move.way * 1e3, " mm"];
  tell("check-move", text("check-move.asks", { axis: move.axis, way: minus(`${way > 0 ? "+" : ""}${fixed(way, 1)}${unit}`) }));
}
