// The campaign that moves the machine, asked once a second while it does: its steps are shorter than its events.

import { call, get } from "./api.js";
import { byId, tell } from "./elements.js";
import { showIntent } from "./intent.js";
import { mayNot } from "./login.js";
import { unitsOf } from "./motion.js";

const STATES = ["running", "pausing"];
const PATIENCE = 5000; // ms

let lists = [[], []]; // campaigns and diagnoses, as they were told last
let owner = null; // id

// of the lists: the campaign with its progress, or undefined
export async function showMoving(campaigns, diagnoses) {
  lists = [campaigns, diagnoses];
  const found = campaigns.find((one) => STATES.includes(one.state));
  owner = found?.id ?? null;
  return draw();
}

// again, while something moves; `ended` is told once it does no more
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

// who sees this page looks after the machine; without, the axes stop
function showLife({ id, attended }) {
  if (!attended || document.hidden || mayNot("POST /campaigns/{campaign_id}/sign_of_life")) return;
  if (attended.left_s > (2 / 3) * attended.within_s) return;
  call("POST", `/campaigns/${id}/sign_of_life`, undefined, {}, PATIENCE).catch(() => {}); // the state tells what comes of it
}

function showCheckMove(move) {
  byId("check-move").hidden = !move;
  if (!move) return;
  const [way, unit] = move.unit === "rad" ? [(move.way * 180) / Math.PI, "\u00b0"] : [move.way * 1e3, " mm"];
  tell("check-move", `Check move: ${move.axis} goes ${way > 0 ? "+" : "\u2212"}${Math.abs(way).toFixed(1)}${unit} and back. ` +
    "Is it this axis, and does it go that way? If not: STOP.");
}
