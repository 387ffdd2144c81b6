// The operator page: campaigns and their estimates.

import { address, all, call, get, Refused } from "./api.js";
import { watchApproval } from "./approval.js";
import { showAxes, watchAxes } from "./axes.js";
import { showCommands, watchCommands } from "./commands.js";
import { byFault, causeWithDetails } from "./causes.js";
import { clear } from "./drawing.js";
import { byId, choices, complain, effectsTold, element, estimateTold, measured, row, tell } from "./elements.js";
import { findingParts } from "./findings.js";
import { campaignName, first, held, noCampaign, owner } from "./intent.js";
import { showLive, titleLive, watchLive } from "./live.js";
import { watchMachine } from "./machine.js";
import { unitsOf, unitsOfMachine } from "./motion.js";
import { showMoving } from "./moving.js";
import { order, questionOf, showOrdered } from "./ordered.js";
import { plot } from "./plots.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";
import { formula, language, text, word } from "./words.js";

/** @type {Api.CampaignDocument[]} */
let campaigns = [];
/** @type {Machine | null} */
let machine = null; // {drives, stop} of the last answer
/** @type {Api.CampaignView | null} */
let campaign = null; // the displayed campaign
let etag = "";
/** @type {Plan | null} */
let plan = null; // its plan {id, document}; null for an imported campaign
/** @type {Units | null} */
let units = null; // of its robot; without a campaign, of the robot of the drives
let sought = false; // whether that robot was requested
let shownRevision = "";

// -- campaign

async function listCampaigns() {
  campaigns = await all("/campaigns");
  const select = byId("campaigns");
  const known = select.options.length;
  choices(select, campaigns.map((one) => [one.id, campaignName(one)]).reverse());
  const asked = location.hash.match(/^#campaign-(\d+)$/)?.[1];
  const running = owner(campaigns);
  if (running) select.value = running.id;
  else if (!known && campaigns.some((one) => String(one.id) === asked)) select.value = asked;
  else if (campaigns.length && known !== campaigns.length) select.value = first(campaigns).id;
  await showMoving(campaigns, await all("/diagnoses"));
}

async function showCampaign() {
  const id = byId("campaigns").value;
  if (String(campaign?.id) !== id) campaign = null;
  nowCommands();
  byId("choice").hidden = byId("progress").hidden = !id;
  if (!id) {
    tell("progress-text", noCampaign());
    tell("estimate-text", text("estimate.none"));
    return;
  }
  const answer = await call("GET", `/campaigns/${id}`);
  const [planned, known] = await Promise.all([planOf(answer.content), unitsOf(answer.content.robot_id)]);
  if (byId("campaigns").value !== id) return; // another campaign was selected meanwhile
  [campaign, etag, plan, units] = [answer.content, answer.etag, planned, known];
  if (machine) showAxes(machine.drives, units);
  showProgress();
  tell("cause", held(campaigns)?.id === campaign.id ? "" : causeWithDetails(campaign.structured_cause)); // of that one, the head tells it
  showDataCheck(campaign.data_check);
  tell("campaign-state", word("campaign-state", campaign.state));
  byId("campaign-state").className = `badge ${campaign.state}${byFault(campaign.structured_cause) ? " broken" : ""}`;
  nowCommands();
  await ordered();
  await showEstimate(id);
}

function showProgress() {
  const { done, total } = campaign.progress;
  byId("progress").max = total;
  byId("progress").value = done;
  tell("progress-text", text("campaign.done", { done, total })); // the head of the page tells the rest
}

const nowCommands = () => showCommands(campaign, machine, owner(campaigns));

async function ordered() {
  await showOrdered(campaign, plan, units, machine, owner(campaigns));
  nowCommands();
}

/** @param {Api.DataCheck | null} check */
function showDataCheck(check) {
  byId("data-check").replaceChildren(...(check ? findingParts(check.findings) : []));
  if (check && !check.findings.length) byId("data-check").append(element("p", text("campaign.data-sound"), "quiet"));
}

/** @param {Api.CampaignDocument} campaign @returns {Promise<Plan | null>} */
async function planOf({ plan_id }) {
  if (plan_id === null) return null;
  if (plan?.id === plan_id) return plan;
  const { document } = await get(`/plans/${plan_id}`);
  return { id: plan_id, document };
}

/** @param {() => Promise<unknown>} run */
async function command(run) {
  await Promise.resolve().then(run).then(() => complain(null), complain);
  await refresh();
}

// -- estimate

/** @param {string} id */
async function showEstimate(id) {
  let estimate;
  try {
    estimate = await get(`/campaigns/${id}/estimates/latest`);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    tell("estimate-text", text("estimate.none"));
    byId("report").hidden = byId("estimate").hidden = true;
    byId("parameters").replaceChildren();
    choices(byId("axis"), []);
    shownRevision = "";
    drawChart(null);
    return;
  }
  const revision = `${id}/${estimate.revision}/${language()}`;
  if (revision === shownRevision) return;
  shownRevision = revision;
  const found = estimate.document;
  byId("report").href = address(`/campaigns/${id}/report`);
  byId("report").hidden = byId("estimate").hidden = false; // a plot needs the width of its element
  tell("estimate-text", [estimateTold(estimate), ...effectsTold(found)].join(". "));
  byId("parameters").replaceChildren(...found.base_parameters.map(({ symbolic, name, reference, value, std }) => row([
    [symbolic ?? formula(name)], ...measured(std, reference ?? null, value, std).map((shown) => [shown, "number"]),
  ])));
  choices(byId("axis"), Object.keys(found.axes).map((joint) => [joint, joint]));
  drawChart(found);
  byId("axis").onchange = () => drawChart(found);
}

/** @param {Api.Estimate | null} found */
function drawChart(found) {
  const inertia = found?.axes[byId("axis").value]?.inertia;
  if (!inertia) {
    clear("chart");
    return;
  }
  const room = Math.max(2, Math.floor(byId("chart").clientWidth / 60)); // number of sweep names that fit on the axis
  const trace = {
    type: "scatter", mode: "markers", marker: { color: "#2f7ef0", size: 7 },
    x: inertia.map((point) => point.sweep),
    y: inertia.map((point) => point.value),
    error_y: { type: "data", array: inertia.map((point) => point.std), color: "#2f7ef0" },
  };
  plot("chart", [trace], {
    xaxis: { title: { text: text("chart.sweep"), standoff: 10 }, type: "category", nticks: room },
    yaxis: { title: { text: text(units?.prismatic.has(byId("axis").value) ? "chart.inertia-linear" : "chart.inertia") } },
  });
}

async function findUnits() {
  if (sought || units || !machine.drives.axes.length) return;
  sought = true;
  const found = await unitsOfMachine(machine.drives);
  units ??= found;
}

// -- event handlers

const refresh = refresher(async () => {
  await listCampaigns();
  await showCampaign();
});

watchAxes(command);
watchApproval(command);
byId("campaigns").addEventListener("change", () => showCampaign().catch(complain));
byId("repeat").addEventListener("change", () => campaign && ordered().catch(complain));
watchCommands(
  (name) => command(() => order(campaign, etag, name)),
  () => questionOf(campaign),
);

const stream = events();
stream.addEventListener("open", refresh); // events were possibly missed
for (const kind of ["campaign", "sweep", "check_move", "estimate", "data_check", "diagnosis", "stop"]) stream.addEventListener(kind, refresh);
watchLive(watchMachine(refresh, () => held(campaigns), (heard, moving) => {
  machine = heard;
  findUnits().catch(complain);
  showAxes(heard.drives, units);
  showLive(owner(campaigns), byId("si").checked);
  nowCommands();
  if (moving && moving.id === campaign?.id) {
    campaign.progress = moving.progress;
    campaign.motion = moving.motion;
    showProgress();
  }
}, titleLive));
