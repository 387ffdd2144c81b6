// The page of results: estimate of a campaign, its uncertainty, earlier estimates, and the audit.

import { address, all, get, Refused } from "./api.js";
import { clear } from "./drawing.js";
import { byId, choices, complain, confidence, effectsTold, element, EMPTY, estimateTold, fixed, link, measured, number, row, tell } from "./elements.js";
import { campaignName, first, held, noCampaign } from "./intent.js";
import { identified } from "./login.js";
import { watchMachine } from "./machine.js";
import { unitsOf } from "./motion.js";
import { showMoving } from "./moving.js";
import { plot } from "./plots.js";
import { showAudit, showModels, table } from "./record.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";
import { foreign, language, text, word } from "./words.js";

const EARLIER = 5; // number of earlier campaigns
const TICKS = [-3, -2, -1, 0, 1, 2, 3].flatMap((decade) => [1, 2, 5].map((digit) => digit * 10 ** decade)); // plotly.js labels 0.5 between decades as 5
const BLUE = "#2f7ef0";

/** @type {Api.CampaignDocument[]} */
let campaigns = [];
/** @type {Api.Estimate | null} */
let found = null; // the estimate's document
/** @type {Units | null} */
let units = null; // of the campaign's robot
let shown = "";

async function showList() {
  const [listed, diagnoses] = await Promise.all([all("/campaigns"), all("/diagnoses")]);
  const new_ = listed.length !== campaigns.length;
  campaigns = listed;
  choices(byId("campaigns"), campaigns.map((one) => [one.id, campaignName(one)]).reverse());
  const asked = campaigns.find((one) => location.hash === `#campaign-${one.id}`);
  if (new_ && campaigns.length) byId("campaigns").value = (asked ?? first(campaigns)).id;
  await showMoving(campaigns, diagnoses);
}

async function showCampaign() {
  const id = byId("campaigns").value;
  if (!id) return tell("told", noCampaign());
  const campaign = await get(`/campaigns/${id}`);
  tell("campaign-state", word("campaign-state", campaign.state));
  byId("campaign-state").className = `badge ${campaign.state}`;
  const [estimate, itsUnits] = await Promise.all([latest(campaign.id), unitsOf(campaign.robot_id)]);
  const now = `${campaign.id}/${estimate?.revision}/${campaign.state}/${campaign.progress.done}/${language()}`;
  if (now === shown) return;
  found = estimate?.document ?? null;
  units = itsUnits;
  tell("told", estimate ? estimateTold(estimate) : text("estimate.none"));
  showDownloads(campaign, estimate);
  showTable();
  showTaken();
  await showConvergence(campaign.id);
  choices(byId("axis"), Object.keys(found?.axes ?? {}).map((joint) => [joint, joint]));
  showSweeps();
  await showEarlier(campaign);
  await showModels(campaign.robot_id);
  shown = now; // not before: what failed is asked for again
}

/** @param {number} id @returns {Promise<Api.EstimateDocument | null>} */
async function latest(id) {
  try {
    return await get(`/campaigns/${id}/estimates/latest`);
  } catch (error) {
    if (error instanceof Refused) return null;
    throw error;
  }
}

/** @param {Api.CampaignView} campaign @param {Api.EstimateDocument | null} estimate */
function showDownloads({ id, progress }, estimate) {
  const files = [];
  if (progress.done) files.push(["results.bundle", "bundle"]);
  const { pdf } = byId("downloads").dataset; // where the service makes PDF
  if (estimate) files.push(["report", "report"], ...(pdf ? [["results.pdf", pdf]] : []), ["results.tables", "report.json"]);
  if (Object.keys(estimate?.document.axes ?? {}).length) files.push(["results.sheet", "sheet.md"], ["results.urdf", "model.urdf"], ["results.mjcf", "model.xml"], ["results.yaml", "model.yaml"]);
  byId("downloads").replaceChildren(...files.map(([key, name]) => link(text(key), address(`/campaigns/${id}/${name}`))));
  if (!files.length) tell("downloads", text("results.nothing"));
}

/** @param {number | null} value */
const percent = (value) => (value === null ? EMPTY : `${fixed(value, 2)} %`);

function showTable() {
  table("table", [["axis"], ["results.sweeps", "number"], ["results.cad-measured", "number"], ["results.identified-measured", "number"], ["results.cad-identified", "number"], ["results.confidence", "number"]],
    Object.entries(found?.axes ?? {}).map(([joint, { inertia, rmse_percent: rmse, confidence_percent: own }]) => row([
      [joint], [inertia.length, "number"], [percent(rmse.reference_measured), "number"], [percent(rmse.identified_measured), "number"],
      [percent(rmse.reference_identified), "number"], [confidence(own), "number"],
    ])));
}

// what the accepted effects of the model did to this estimate
function showTaken() {
  const told = (found?.effects ?? []).map(({ axis, effect, used, how }) => [text(used ? "results.taken" : "results.left-out", { axis, effect: word("effect", effect) }), " ", foreign(how)]);
  byId("taken").replaceChildren(...[...told, ...effectsTold(found)].map((one) => element("p", one)));
}

/** @param {number} id */
async function showConvergence(id) {
  const { wanted, revisions } = await get(`/campaigns/${id}/estimates/convergence`);
  const gap = revisions.some((one) => Object.values(one.percent).includes(null)) ? text("results.gap") : "";
  tell("wanted", `${wanted === null ? text("results.all-sweeps") : text("results.wanted", { percent: wanted })} ${gap}`);
  if (!revisions.length) return clear("convergence");
  const x = revisions.map((one) => one.sweep);
  const joints = Object.keys(revisions[0].percent);
  /** @type {Record<string, any>[]} */
  const lines = joints.map((joint, k) => ({ type: "scatter", mode: "lines+markers", name: joint, x, y: revisions.map((one) => one.percent[joint]), marker: { symbol: k } }));
  const known = lines.flatMap((one) => one.y).filter((value) => value !== null);
  const far = Math.max(...known) / Math.min(...known);
  if (wanted !== null) lines.push({ type: "scatter", mode: "lines", name: text("results.limit"), x: [x[0], x.at(-1)], y: [wanted, wanted], line: { dash: "dash" } });
  plot("convergence", lines, { xaxis: { title: { text: text("chart.sweep") }, tick0: 1, dtick: Math.ceil(x.at(-1) / 10) }, yaxis: { title: { text: `${text("results.confidence")}, %` }, type: "log", ...(far > 1 && far < 8 ? {} : { tickvals: TICKS, ticktext: TICKS.map((tick) => number(tick)) }) } });
}

function showSweeps() {
  const inertia = found?.axes[byId("axis").value]?.inertia ?? [];
  choices(byId("sweep"), inertia.map((one) => [one.sweep, one.sweep]));
  showResponse();
}

/** @param {string} joint */
const linear = (joint) => units.prismatic.has(joint);
/** @param {string} joint */
const inertiaUnit = (joint) => text(linear(joint) ? "results.unit-linear" : "results.unit");

/** @param {Api.SweepInertia} sweep */
function inertiaOf({ value, std, reference, identified }) {
  const [value_, std_, cad, model] = measured(std, value, std, reference, identified);
  return { value: value_, std: std_, cad, model };
}

function showResponse() {
  const joint = byId("axis").value;
  const sweep = found?.axes[joint]?.inertia.find((one) => one.sweep === byId("sweep").value);
  tell("inertia", sweep ? text("results.inertia", { ...inertiaOf(sweep), unit: inertiaUnit(joint) }) : "");
  const lines = sweep?.frequency_response ?? [];
  if (!lines.length) return clear("response");
  const x = lines.map((one) => one.frequency);
  const size = lines.map((one) => Math.hypot(one.re, one.im));
  const amplitude = linear(joint) ? "results.amplitude-linear" : "results.amplitude";
  const bars = { type: "data", array: lines.map((one) => one.std) };
  plot("response", [
    { type: "scatter", mode: "lines+markers", name: text(amplitude), x, y: size, error_y: bars, line: { color: BLUE } },
    { type: "scatter", mode: "lines+markers", name: text("results.phase"), x, y: lines.map((one) => (Math.atan2(one.im, one.re) * 180) / Math.PI), yaxis: "y2", line: { color: "#d97706", dash: "dot" }, marker: { symbol: "square" } },
  ], {
    xaxis: { title: { text: text("results.frequency") }, anchor: "y2" }, yaxis: { title: { text: linear(joint) ? "N s/m" : "N m s/rad" }, domain: [0.55, 1] },
    yaxis2: { title: { text: "°" }, domain: [0, 0.45] },
  });
}

// what differs over the whole workspace is comparable between campaigns; the measured poses are others in each
/** @param {Api.CampaignView} campaign */
async function showEarlier({ id, robot_id }) {
  const others = campaigns.filter((one) => one.robot_id === robot_id && one.id < id).slice(-EARLIER).reverse();
  /** @type {[number, Api.Estimate][]} */
  const known = [];
  for (const one of others) {
    const estimate = await latest(one.id);
    if (estimate) known.push([one.id, estimate.document]);
  }
  if (found) known.unshift([id, found]);
  table("earlier", [["campaign.title"], ["axis"], ["results.sweeps", "number"], ["results.cad-identified", "number"], ["results.confidence", "number"]], known.flatMap(([number_, document]) => Object.entries(document.axes).map(([joint, axis]) => row([
    [number_], [joint], [axis.inertia.length, "number"], [percent(axis.rmse_percent.reference_identified), "number"], [confidence(axis.confidence_percent), "number"],
  ]))));
}

const refresh = refresher(async () => {
  await showList();
  await showCampaign();
});

byId("campaigns").addEventListener("change", () => showCampaign().catch(complain));
byId("axis").addEventListener("change", showSweeps);
byId("sweep").addEventListener("change", showResponse);
const record = refresher(async () => {
  await identified;
  await showAudit();
});
const stream = events();
for (const kind of ["open", "campaign", "estimate", "diagnosis", "stop"]) {
  stream.addEventListener(kind, refresh);
  stream.addEventListener(kind, record);
}
watchMachine(async () => void (await Promise.all([refresh(), record()])), () => held(campaigns));
