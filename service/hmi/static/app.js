// The operator's page: campaigns and their estimates.

import { address, all, call, get, Refused } from "./api.js";
import { showApproval, watchApproval } from "./approval.js";
import { showAxes, watchAxes } from "./axes.js";
import { showCommands, watchCommands } from "./commands.js";
import { byId, choices, complain, duration, element, number, row, tell } from "./elements.js";
import { findingParts } from "./findings.js";
import { first, held, owner } from "./intent.js";
import { watchMachine } from "./machine.js";
import { inWords, showMotion, unitsOf } from "./motion.js";
import { showMoving } from "./moving.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";

let campaigns = [];
let machine = null; // {drives, stop} as the page heard last
let campaign = null; // the one shown
let etag = "";
let plan = null; // its plan {id, document}; none of an imported one
let units = null; // of its robot
let shownRevision = "";

// -- campaign

async function listCampaigns() {
  campaigns = await all("/campaigns");
  const select = byId("campaigns");
  const known = select.options.length;
  choices(select, campaigns.map((one) => [one.id, `${one.id} (${one.state})`]).reverse());
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
  if (!id) {
    tell("progress-text", "no campaign yet: sweepid plan, then sweepid measure");
    return;
  }
  const answer = await call("GET", `/campaigns/${id}`);
  const [planned, known] = await Promise.all([planOf(answer.content), unitsOf(answer.content.robot_id)]);
  if (byId("campaigns").value !== id) return; // another was chosen meanwhile
  [campaign, etag, plan, units] = [answer.content, answer.etag, planned, known];
  showProgress();
  tell("cause", campaign.cause);
  showDataCheck(campaign.data_check);
  tell("campaign-state", campaign.state);
  byId("campaign-state").className = `badge ${campaign.state}`;
  byId("repeat-choice").hidden = campaign.state !== "paused";
  nowCommands();
  await showOrdered();
  await showEstimate(id);
}

function showProgress() {
  const { done, total, remaining } = campaign.progress;
  byId("progress").max = total;
  byId("progress").value = done;
  const now = campaign.motion.length ? `sweep ${Math.min(done + 1, total)}: ${inWords(campaign.motion, units)}` : "";
  const left = done < total && remaining !== null && campaign.state !== "paused" ? `about ${duration(remaining)} left` : "";
  tell("progress-text", [`${done} of ${total} sweeps`, now, left].filter(Boolean).join(" \u00b7 "));
}

const nowCommands = () => showCommands(campaign, machine, owner(campaigns));

function showDataCheck(check) {
  byId("data-check").replaceChildren(...(check ? findingParts(check.findings) : []));
  if (check && !check.findings.length) byId("data-check").append(element("p", "Check of the data: nothing found.", "quiet"));
}

async function planOf({ plan_id }) {
  if (plan_id === null) return null;
  if (plan?.id === plan_id) return plan;
  const { document } = await get(`/plans/${plan_id}`);
  return { id: plan_id, document };
}

// what Start or Resume will move
async function showOrdered() {
  const { state, progress, id } = campaign;
  const command = { planned: "Start", paused: "Resume" }[state];
  const again = state === "paused" && byId("repeat").checked;
  const waits = plan !== null && command !== undefined;
  const sweeps = waits ? await get(`/campaigns/${id}/sweeps`) : [];
  const due = again ? ["planned", "failed", "interrupted"] : ["planned"];
  const left = plan?.document.sweeps.filter((_, k) => due.includes(sweeps[k]?.state)) ?? [];
  const seconds = progress.remaining + (again ? progress.repeat : 0);
  await showApproval(plan, left, seconds);
  nowCommands();
  byId("ordered").hidden = !left.length;
  tell("takes", left.length ? `takes ${duration(seconds)}` : "");
  const shown = `${plan?.id}/${command}/${left.length}`;
  if (!left.length || byId("motion").dataset.shown === shown) return;
  tell("ordered-title", `What ${command} will move`);
  showMotion(byId("motion"), { ...plan.document, sweeps: left, duration: seconds }, units);
  byId("motion").dataset.shown = shown;
}

async function command(run) {
  await Promise.resolve().then(run).then(() => complain(null), complain);
  await refresh();
}

// -- estimate

async function showEstimate(id) {
  let estimate;
  try {
    estimate = await get(`/campaigns/${id}/estimates/latest`);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    byId("estimate-text").textContent = "none yet";
    byId("report").hidden = true;
    byId("parameters").replaceChildren();
    choices(byId("axis"), []);
    shownRevision = "";
    drawChart(null);
    return;
  }
  const revision = `${id}/${estimate.revision}`;
  if (revision === shownRevision) return;
  shownRevision = revision;
  const found = estimate.document;
  byId("report").href = address(`/campaigns/${id}/report`);
  byId("report").hidden = false;
  byId("estimate-text").textContent =
    `revision ${estimate.revision}, after sweep ${estimate.number}; condition number ${number(found.condition_number)}`;
  byId("parameters").replaceChildren(...found.base_parameters.map((parameter) => row([
    [parameter.symbolic ?? parameter.name], [number(parameter.value), "number"], [number(parameter.std), "number"],
  ])));
  choices(byId("axis"), Object.keys(found.axes).map((joint) => [joint, joint]));
  drawChart(found);
  byId("axis").onchange = () => drawChart(found);
}

function drawChart(found) {
  const inertia = found?.axes[byId("axis").value]?.inertia;
  if (!inertia) {
    Plotly.purge("chart");
    return;
  }
  const ink = getComputedStyle(document.body).color;
  const grid = "rgba(128,128,128,.25)";
  const room = Math.max(2, Math.floor(byId("chart").clientWidth / 60)); // for names of sweeps side by side
  const trace = {
    type: "scatter", mode: "markers", marker: { color: "#2f7ef0", size: 7 },
    x: inertia.map((point) => point.sweep),
    y: inertia.map((point) => point.value),
    error_y: { type: "data", array: inertia.map((point) => point.std), color: "#2f7ef0" },
  };
  Plotly.react("chart", [trace], {
    margin: { l: 60, r: 10, t: 10, b: 45 }, paper_bgcolor: "transparent", plot_bgcolor: "transparent", font: { color: ink },
    xaxis: { title: { text: "sweep", standoff: 10 }, type: "category", gridcolor: grid, nticks: room, automargin: true },
    yaxis: { title: { text: "inertia, kg m\u00b2" }, gridcolor: grid, zeroline: false },
  }, { displayModeBar: false, responsive: true });
}

// -- what happens when

const refresh = refresher(async () => {
  await listCampaigns();
  await showCampaign();
});

watchAxes(command);
watchApproval(command);
byId("campaigns").addEventListener("change", () => showCampaign().catch(complain));
byId("repeat").addEventListener("change", () => campaign && showOrdered().catch(complain));
watchCommands(
  (name) => command(() => call(
    "POST",
    `/campaigns/${campaign.id}/${name}`,
    name === "resume" ? { repeat: byId("repeat").checked } : undefined,
    { "If-Match": etag },
  )),
  () => `Give campaign ${campaign.id} up for good? Its present sweep stops now, ${campaign.progress.total - campaign.progress.done} sweeps are not measured; what is recorded stays.`,
);

const stream = events();
stream.addEventListener("open", refresh); // whatever was missed meanwhile
for (const kind of ["campaign", "sweep", "check_move", "estimate", "data_check", "diagnosis", "stop"]) stream.addEventListener(kind, refresh);
watchMachine(refresh, () => held(campaigns), (heard, moving) => {
  machine = heard;
  showAxes(heard.drives, units);
  nowCommands();
  if (moving && moving.id === campaign?.id) {
    campaign.progress = moving.progress;
    campaign.motion = moving.motion;
    showProgress();
  }
});
