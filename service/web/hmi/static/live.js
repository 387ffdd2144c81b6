// Torque and speed of the moving axis, as the service sends them: decimated; the service never waits for the page.

import { protocols } from "./api.js";
import { clear } from "./drawing.js";
import { byId, tell } from "./elements.js";
import { unitsOf } from "./motion.js";
import { plot } from "./plots.js";
import { named } from "./statement.js";
import { text } from "./words.js";

const SHOWN = 20; // s
const PAUSE = 250; // ms between two redraws, at any data rate
const OVER = 1500; // ms without a block: the sweep has ended

/** @type {WebSocket | null} */
let socket = null;
/** @type {number | null} */
let campaign = null; // id
let samples = []; // [time, effort, velocity]
let joint = "";
let plotted = ""; // the axis whose samples the plot shows
/** @type {Api.StatementView | null} */
let stated = null; // of the headline
let waiting = false;
let heard = 0; // ms, time of the last block
let changed = () => {}; // asks what moves
/** @type {Units | null} */
let units = null; // of the moving robot
let si = false; // rad and m instead of deg and mm

// ask: called when another axis sweeps
/** @param {() => void} ask */
export const watchLive = (ask) => (changed = ask);

// with the headline: a sweep of an axis that it does not name is the last one
/** @param {Api.StatementView} statement */
export function titleLive(statement) {
  stated = statement;
  const now = plotted === joint && named(statement).includes(joint) && performance.now() - heard <= OVER;
  tell("live-title", plotted ? text(now ? "live.title" : "live.last", { axis: plotted }) : text("live.waits"));
}

// moving: the campaign that moves, or undefined
/** @param {Api.CampaignDocument | undefined} moving @param {boolean} inSi */
export function showLive(moving, inSi) {
  const id = moving?.id ?? null;
  si = inSi;
  byId("live").hidden = id === null;
  if (id === campaign) return;
  campaign = id;
  socket?.close();
  socket = null;
  samples = [];
  plotted = "";
  clear("live-chart");
  if (id !== null) open(id, moving.robot_id);
}

/** @param {number} id @param {number} robot */
function open(id, robot) {
  units = null;
  unitsOf(robot).then((found) => (units = found), () => {}); // without units nothing is drawn
  const own = new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}/api/v1/campaigns/${id}/live?form=json`, protocols());
  socket = own;
  own.onmessage = ({ data }) => own === socket && take(JSON.parse(data));
  own.onclose = () => {
    if (own !== socket) return;
    socket = campaign = null; // opened again at the next status of the machine
  };
}

/** @param {{joint: string, time: number[], effort: number[], velocity: number[]}} block as in docs/reference/http-api.md */
function take(block) {
  const last = samples.at(-1)?.[0];
  if (block.joint !== joint || block.time[0] < last) samples = [];
  if (block.joint !== joint) changed();
  joint = block.joint;
  heard = performance.now();
  samples.push(...block.time.map((time, k) => [time, block.effort[k], block.velocity[k]]));
  while (samples[0][0] < samples.at(-1)[0] - SHOWN) samples.shift();
  if (waiting) return;
  waiting = true;
  setTimeout(draw, PAUSE);
}

function draw() {
  waiting = false;
  if (byId("live").hidden || document.hidden || !samples.length || !units) return;
  const linear = units.prismatic.has(joint);
  const [factor, unit] = si ? [1, linear ? " m" : " rad"] : units.scale(joint);
  const effort = linear ? "N" : "N m";
  const speed = `${unit.trim()}/s`;
  const x = samples.map(([time]) => time - samples[0][0]);
  /** @param {string} name @param {number[]} y @param {string} yaxis @param {string} color */
  const line = (name, y, yaxis, color) => ({ type: "scatter", mode: "lines", name, x, y, yaxis, line: { color, width: 1.5 } });
  plot("live-chart", [
    line(`${text(linear ? "live.force" : "live.effort")}, ${effort}`, samples.map((one) => one[1]), "y", "#2f7ef0"),
    line(`${text("live.velocity")}, ${speed}`, samples.map((one) => one[2] * factor), "y2", "#d97706"),
  ], {
    xaxis: { title: { text: text("live.time") }, anchor: "y2" },
    yaxis: { title: { text: effort }, domain: [0.55, 1] },
    yaxis2: { title: { text: speed }, domain: [0, 0.45] },
  });
  plotted = joint;
  if (stated) titleLive(stated);
}
