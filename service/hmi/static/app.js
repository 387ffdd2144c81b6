// The operator's page: campaigns and their estimates.

import { all, call, events, get, Refused } from "./api.js";
import { showAxes, watchAxes } from "./axes.js";
import { byId, choices, complain, duration, element, fixed, number, row } from "./elements.js";
import { findingParts } from "./findings.js";
import { held, owner, showIntent } from "./intent.js";
import { showCheckMove, watchMachine } from "./machine.js";
import { showMotion, unitsOf } from "./motion.js";
import { refresher } from "./refresh.js";

let campaign = null; // the one shown
let etag = "";
let plan = null; // its plan {id, document, units}; none of an imported one
let shownRevision = "";

// -- campaign

const COMMANDS = {
  start: ["planned"],
  pause: ["running"],
  resume: ["paused", "pausing"],
  abort: ["planned", "running", "pausing", "paused"],
};

async function listCampaigns() {
  const campaigns = await all("/campaigns");
  const select = byId("campaigns");
  const newest = campaigns.at(-1);
  const known = select.options.length;
  choices(select, campaigns.map((one) => [one.id, `${one.id} (${one.state})`]).reverse());
  const asked = location.hash.match(/^#campaign-(\d+)$/)?.[1];
  const running = owner(campaigns);
  if (running) select.value = running.id;
  else if (!known && campaigns.some((one) => String(one.id) === asked)) select.value = asked;
  else if (newest && known !== campaigns.length) select.value = (held(campaigns) ?? newest).id;
  const [diagnoses, moving] = await Promise.all([all("/diagnoses"), running && get(`/campaigns/${running.id}`)]);
  showIntent(campaigns, diagnoses, moving);
}

async function showCampaign() {
  const id = byId("campaigns").value;
  if (String(campaign?.id) !== id) {
    for (const button of document.querySelectorAll("[data-command]")) button.disabled = true;
  }
  if (!id) {
    showCheckMove(null);
    byId("progress-text").textContent = "no campaign yet: sweepid plan, then sweepid measure";
    return;
  }
  const answer = await call("GET", `/campaigns/${id}`);
  const planned = await planOf(answer.content);
  if (byId("campaigns").value !== id) return; // another was chosen meanwhile
  [campaign, etag, plan] = [answer.content, answer.etag, planned];
  const { done, total, current } = campaign.progress;
  const left = timeLeft();
  const now = current ? `sweep ${current.number}: ${current.spec.axis} at [${current.spec.pose.map((q) => fixed(q, 2)).join(", ")}] rad` : "";
  byId("progress").max = total;
  byId("progress").value = done;
  byId("progress-text").textContent = [`${done} of ${total} sweeps`, now, done < total && left !== null ? `about ${duration(left)} left` : ""].filter(Boolean).join(" \u00b7 ");
  showCheckMove(campaign.check_move);
  byId("cause").textContent = campaign.cause;
  showDataCheck(campaign.data_check);
  byId("campaign-state").textContent = campaign.state;
  byId("campaign-state").className = `badge ${campaign.state}`;
  for (const button of document.querySelectorAll("[data-command]")) {
    button.disabled = !COMMANDS[button.dataset.command].includes(campaign.state);
  }
  byId("repeat-choice").hidden = campaign.state !== "paused";
  showStart();
  await showEstimate(id);
}

function showDataCheck(check) {
  byId("data-check").replaceChildren(...(check ? findingParts(check.findings) : []));
  if (check && !check.findings.length) byId("data-check").append(element("p", "Check of the data: nothing found.", "quiet"));
}

async function planOf({ plan_id, robot_id }) {
  if (plan_id === null) return null;
  if (plan?.id === plan_id) return plan;
  const [{ document }, units] = await Promise.all([get(`/plans/${plan_id}`), unitsOf(robot_id)]);
  return { id: plan_id, document, units };
}

// what Start will move
function showStart() {
  const starts = campaign.state === "planned" && plan !== null;
  byId("ordered").hidden = !starts;
  byId("takes").textContent = starts ? `takes ${duration(plan.document.duration)}` : "";
  if (!starts || byId("motion").dataset.plan === String(plan.id)) return;
  showMotion(byId("motion"), plan.document, plan.units);
  byId("motion").dataset.plan = plan.id;
}

// s, null where it cannot be told. The plan knows the ways between poses
function timeLeft() {
  const { remaining } = campaign.progress;
  if (remaining === null || !plan) return remaining;
  const over = campaign.progress.total - (campaign.sweeps.planned ?? 0) - (campaign.sweeps.running ?? 0);
  return plan.document.sweeps.slice(over).reduce((sum, sweep) => sum + sweep.duration, 0);
}

async function command(run) {
  try {
    await run();
    complain(null);
  } catch (error) {
    complain(error);
  }
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
byId("campaigns").addEventListener("change", () => showCampaign().catch(complain));
for (const button of document.querySelectorAll("[data-command]")) {
  const name = button.dataset.command;
  button.addEventListener("click", () => command(() => call(
    "POST",
    `/campaigns/${campaign.id}/${name}`,
    name === "resume" ? { repeat: byId("repeat").checked } : undefined,
    { "If-Match": etag },
  )));
}

const stream = events();
stream.addEventListener("open", refresh); // whatever was missed meanwhile
for (const kind of ["campaign", "sweep", "check_move", "estimate", "data_check", "diagnosis", "stop"]) stream.addEventListener(kind, refresh);
watchMachine(refresh, showAxes);
