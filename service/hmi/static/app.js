// The operator's page. It speaks only the public API: what it can do, another program can.

const API = "api/v1";
const EMPTY = "\u2013";
const byId = (id) => document.getElementById(id);
let campaign = null; // the one shown
let etag = "";
let shownRevision = "";

class Refused extends Error {}

async function call(method, path, body, headers = {}) {
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const answer = await fetch(`${API}${path}`, { method, headers, body: body && JSON.stringify(body) });
  const content = await answer.json();
  if (!answer.ok) throw new Refused(content.detail ?? answer.statusText);
  return { content, etag: answer.headers.get("ETag") };
}

const get = async (path) => (await call("GET", path)).content;

function complain(error) {
  byId("error").hidden = !error;
  byId("error").textContent = error ? `${error.message}` : "";
}

// -- cells and numbers

function row(cells) {
  const tr = document.createElement("tr");
  for (const [text, kind, control] of cells) {
    const td = document.createElement("td");
    td.textContent = text;
    if (kind) td.className = kind;
    if (control) td.append(" ", control);
    tr.append(td);
  }
  return tr;
}

function number(value, unit = "") {
  return value === null || value === undefined ? EMPTY : `${Number(value.toPrecision(4))}${unit}`;
}

function fixed(value, digits) {
  return value === null ? EMPTY : (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);
}

function duration(seconds) {
  if (seconds === null) return "";
  const minutes = Math.floor(seconds / 60);
  return minutes ? `about ${minutes} min ${Math.round(seconds % 60)} s left` : `about ${Math.round(seconds)} s left`;
}

function choices(select, entries) {
  const chosen = select.value;
  select.replaceChildren(...entries.map(([value, text]) => new Option(text, value)));
  if (entries.some(([value]) => String(value) === chosen)) select.value = chosen;
}

// -- machine

async function showMachine() {
  const state = byId("machine");
  try {
    const [drives, stop] = await Promise.all([get("/drives"), get("/stop")]);
    byId("held").hidden = !stop.latched;
    if (stop.latched) byId("held-by").textContent = `Stopped by ${stop.stop.by}: ${stop.stop.why}`;
    state.textContent = stop.latched ? "stopped" : drives.connected ? "machine connected" : `no machine: ${drives.trouble}`;
    state.className = `state ${stop.latched || !drives.connected ? "bad" : "good"}`;
    byId("connect").hidden = drives.connected;
    byId("axes").replaceChildren(...drives.axes.map((axis) => row([
      [axis.joint],
      [axis.state],
      [fixed(axis.position, 4), "number"],
      [fixed(axis.velocity, 4), "number"],
      [fixed(axis.effort, 1), "number"],
      ...faultCells(axis),
    ])));
  } catch (error) {
    state.textContent = error instanceof Refused ? error.message : "no word from the service";
    state.className = "state bad";
  }
}

function faultCells(axis) {
  if (!axis.fault) return [["", "fault"]];
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.acknowledge = axis.joint;
  button.textContent = "I looked: acknowledge";
  return [[`${axis.fault.code.toString(16)}h ${axis.fault.text}`, "fault", button]];
}

async function acknowledge(click) {
  const joint = click.target.dataset.acknowledge;
  if (!joint) return;
  await command(() => call("POST", `/drives/${joint}/acknowledge`));
  await showMachine();
}

async function connect() {
  await command(() => call("POST", "/drives/connect"));
  await showMachine();
}

async function stop() {
  try {
    await call("POST", "/stop?by=operator%20page&why=stop%20button");
    complain(null);
  } catch (error) {
    complain(new Error(`STOP NOT CONFIRMED (${error.message}): use the emergency stop`));
  }
  await showMachine();
}

async function release(event) {
  event.preventDefault();
  await command(() => call("POST", "/stop/reset", { by: byId("reset-by").value }));
  await showMachine();
}

// -- campaign

const COMMANDS = {
  start: ["planned"],
  pause: ["running"],
  resume: ["paused", "pausing"],
  abort: ["planned", "running", "pausing", "paused"],
};

async function listCampaigns() {
  let campaigns = [];
  let page = { next: 0 };
  while (page.next !== null) {
    page = await get(`/campaigns?limit=200&after=${page.next}`);
    campaigns = campaigns.concat(page.items);
  }
  const select = byId("campaigns");
  const newest = campaigns.at(-1);
  const known = select.options.length;
  choices(select, campaigns.map((one) => [one.id, `${one.id} (${one.state})`]).reverse());
  const running = campaigns.find((one) => one.state === "running" || one.state === "pausing");
  if (running) select.value = running.id;
  else if (newest && known !== campaigns.length) select.value = newest.id;
}

async function showCampaign() {
  const id = byId("campaigns").value;
  for (const button of document.querySelectorAll("[data-command]")) button.disabled = true;
  if (!id) {
    showCheckMove(null);
    byId("progress-text").textContent = "no campaign yet: sweepid plan, then sweepid measure";
    return;
  }
  const answer = await call("GET", `/campaigns/${id}`);
  [campaign, etag] = [answer.content, answer.etag];
  const { done, total, remaining, current } = campaign.progress;
  const now = current ? `sweep ${current.number}: ${current.spec.axis} at [${current.spec.pose.map((q) => fixed(q, 2)).join(", ")}] rad` : "";
  byId("progress").max = total;
  byId("progress").value = done;
  byId("progress-text").textContent = [`${done} of ${total} sweeps`, now, done < total ? duration(remaining) : ""].filter(Boolean).join(" \u00b7 ");
  showCheckMove(campaign.check_move);
  byId("cause").textContent = campaign.cause;
  byId("campaign-state").textContent = campaign.state;
  byId("campaign-state").className = `badge ${campaign.state}`;
  for (const button of document.querySelectorAll("[data-command]")) {
    button.disabled = !COMMANDS[button.dataset.command].includes(campaign.state);
  }
  byId("repeat-choice").hidden = campaign.state !== "paused";
  await showEstimate(id);
}

function showCheckMove(move) {
  byId("check-move").hidden = !move;
  if (!move) return;
  const [way, unit] = move.unit === "rad" ? [(move.way * 180) / Math.PI, "\u00b0"] : [move.way * 1e3, " mm"];
  byId("check-move").textContent =
    `Check move: ${move.axis} goes ${way > 0 ? "+" : "\u2212"}${Math.abs(way).toFixed(1)}${unit} and back. ` +
    "Is it this axis, and does it go that way? If not: STOP.";
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
  const trace = {
    type: "scatter", mode: "markers", marker: { color: "#2f7ef0", size: 7 },
    x: inertia.map((point) => point.sweep),
    y: inertia.map((point) => point.value),
    error_y: { type: "data", array: inertia.map((point) => point.std), color: "#2f7ef0" },
  };
  Plotly.react("chart", [trace], {
    margin: { l: 60, r: 10, t: 10, b: 45 }, paper_bgcolor: "transparent", plot_bgcolor: "transparent", font: { color: ink },
    xaxis: { title: { text: "sweep" }, type: "category", gridcolor: grid },
    yaxis: { title: { text: "inertia, kg m\u00b2" }, gridcolor: grid, zeroline: false },
  }, { displayModeBar: false, responsive: true });
}

// -- what happens when

let refreshing = false;
let again = false;

async function refresh() {
  again = true;
  if (refreshing) return;
  refreshing = true;
  try {
    while (again) {
      again = false;
      await listCampaigns();
      await showCampaign();
    }
  } catch (error) {
    complain(error);
  } finally {
    refreshing = false;
  }
}

byId("stop").addEventListener("click", stop);
byId("held").addEventListener("submit", release);
byId("axes").addEventListener("click", acknowledge);
byId("connect").addEventListener("click", connect);
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

const events = new EventSource(`${API}/events`);
events.addEventListener("open", refresh); // whatever was missed meanwhile
for (const kind of ["campaign", "sweep", "check_move", "estimate"]) events.addEventListener(kind, refresh);
events.addEventListener("stop", showMachine);

async function watchMachine() {
  if (!document.hidden) await showMachine();
  if (!byId("check-move").hidden) await refresh(); // nothing tells its end
  setTimeout(watchMachine, 1000);
}
watchMachine();
