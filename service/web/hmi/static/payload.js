// The payload page: one plan measured without the payload, then with it; mass, centre and inertia, and the sheet.

import { address, all, call, get } from "./api.js";
import { watchApproval } from "./approval.js";
import { showCommands, watchCommands } from "./commands.js";
import { byId, complain, duration, element, EMPTY, link, measured, row, tell } from "./elements.js";
import { held, owner } from "./intent.js";
import { watchMachine } from "./machine.js";
import { unitsOf } from "./motion.js";
import { showMoving } from "./moving.js";
import { order, questionOf, showOrdered } from "./ordered.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";
import { showSubjects, typedNames } from "./subject.js";
import { decimal, figures, foreign, parts, text, Told, word } from "./words.js";

const OPEN = ["waiting", "running"];
const MM = 1e3; // in a metre
const SPEED = 0.5; // rad/s (m/s), between the motions, and what is offered for them
/** @typedef {"plan" | "bare" | "empty" | "mount" | "loaded" | "result"} Step */
/** @type {Step[][]} */
const STEPS = [["plan"], ["bare", "empty"], ["mount"], ["loaded"], ["result"]];

/** @type {Step[]} */
const AT_MACHINE = ["bare", "mount"]; // a person goes to the machine

/** @type {Api.CampaignDocument[]} */
let campaigns = [];
/** @type {(Api.PlanView & {document: Api.TrajectoryPlan}) | null} */
let plan = null; // of the pair; null: not planned yet, or imported
/** @type {(Api.CampaignDocument | undefined)[]} */
let pair = []; // without the payload, with it
/** @type {Api.CampaignView | null} */
let campaign = null; // the one to run or running
let etag = "";
/** @type {Api.PayloadView | null} */
let payload = null;
/** @type {Units | null} */
let units = null;
/** @type {Machine | null} */
let machine = null;

// -- where the person is

async function find() {
  /** @type {Api.PayloadEntry[]} */
  let payloads;
  let diagnoses;
  [campaigns, diagnoses, payloads] = await Promise.all([all("/campaigns"), all("/diagnoses"), all("/payloads")]);
  await showMoving(campaigns, diagnoses);
  const asked = payloads.find((one) => location.hash === `#${one.id}`);
  const newest = campaigns.findLast((one) => one.here)?.plan_id;
  const wanted = location.hash ? location.hash.match(/^#plan-(\d+)$/)?.[1] : newest;
  if (asked) {
    pair = [asked.before, asked.after].map((id) => campaigns.find((one) => one.id === id));
    await choosePlan(pair[0]?.plan_id);
  } else {
    await choosePlan(wanted ?? null);
    if (plan && !("trajectories" in plan.document.request)) plan = null; // another kind of campaign is the newest
    const runs = campaigns.filter((one) => one.here && one.plan_id === plan?.id && one.state !== "aborted");
    pair = plan ? [runs[0], runs.slice(1).at(-1)] : [];
  }
  const known = asked ?? payloads.findLast((one) => one.before === pair[0]?.id && one.after === pair[1]?.id);
  payload = known ? await get(`/payloads/${known.id}`) : null;
  const due = pair.find((one) => one && one.state !== "completed");
  if (due) {
    const answer = await call("GET", `/campaigns/${due.id}`);
    [campaign, etag, units] = [answer.content, answer.etag, await unitsOf(due.robot_id)];
  } else campaign = null;
  byId("list").hidden = !payloads.length;
  byId("payloads").replaceChildren(...payloads.toReversed().map(listed));
}

/** @param {string | number | null | undefined} id */
async function choosePlan(id) {
  if (id === null || id === undefined) plan = null;
  else if (String(plan?.id) !== String(id)) plan = /** @type {typeof plan} */ (await get(`/plans/${Number(id)}`));
}

const stands = () => machine?.drives.statement.state === "stands";

/** @returns {Step} */
function stepNow() {
  if (payload) return "result";
  const [before, after] = pair;
  if (!plan) return "plan";
  if (!before) return "bare";
  if (before.state !== "completed") return "empty";
  if (!after) return "mount";
  return after.state === "completed" ? "result" : "loaded";
}

// what the machine will do next, and by whose press
/** @param {Step} step @returns {Part[]} */
function nextOf(step) {
  if (campaign) return parts(`payload-run.${campaign.state}`, { run: text(step === "empty" ? "payload.without" : "payload.with") });
  if (AT_MACHINE.includes(step) && !stands()) return parts("payload-next.waiting");
  if (step !== "result") return parts(`payload-next.${step}`);
  if (!payload) return parts("payload-next.compute");
  if (OPEN.includes(payload.state)) return parts("payload-next.computing");
  return payload.document ? parts("payload-next.done") : parts("payload-next.failed", { why: foreign(payload.cause.replace(/^\w+: /, "")) }); // without the kind of the error
}

async function show() {
  await find();
  const step = stepNow();
  const place = STEPS.findIndex((one) => one.includes(step));
  byId("steps").replaceChildren(...STEPS.map(([first], k) => {
    const run = first === "bare" ? pair[0] : first === "loaded" ? pair[1] : undefined;
    const about = first === "plan" && plan ? promise() : run ? [campaignLink(run), ` (${word("campaign-state", run.state)})`] : [];
    const item = element("li", [text(`payload-step.${first}`), ...(about.length ? [": ", ...about] : [])], k > place ? "quiet" : "");
    if (k === place) item.setAttribute("aria-current", "step");
    return item;
  }));
  tell("next", nextOf(step));
  byId("next").className = `verdict ${step === "result" && payload?.document ? "settled" : "open"}`;
  byId("request").hidden = step !== "plan";
  byId("anew").hidden = step === "plan";
  if (step === "plan") await showSubjects();
  byId("mount").hidden = !AT_MACHINE.includes(step) || !stands();
  tell("mounted", text(step === "bare" ? "payload.nothing-mounted" : "payload.mounted"));
  byId("compute").hidden = step !== "result" || (payload !== null && (OPEN.includes(payload.state) || payload.document !== null));
  await showRun();
  showResult();
}

/** @param {Api.CampaignDocument} one */
const campaignLink = ({ id }) => link(text("experiment.campaign", { id }), `./#campaign-${id}`);

function promise() {
  const { payload_std: std = [], sweeps } = plan.document;
  const told = [text("plan.number", { id: plan.id }), text("payload.takes", { count: new Set(sweeps.map((one) => one.spec.block)).size, time: duration(plan.expected_time) })];
  if (std.length) told.push(text("payload.at-best", { std: figures(Math.max(...std), 2) }));
  return [told.join(", ")];
}

// -- a run

async function showRun() {
  byId("run").hidden = !campaign;
  if (!campaign) {
    byId("ordered").hidden = true;
    return;
  }
  tell("campaign", [campaignLink(campaign)]);
  tell("campaign-state", word("campaign-state", campaign.state));
  byId("campaign-state").className = `badge ${campaign.state}`;
  showProgress();
  await showOrdered(campaign, plan, units, machine, owner(campaigns));
  nowCommands();
}

function showProgress() {
  const { done, total } = campaign.progress;
  byId("progress").max = total;
  byId("progress").value = done;
  tell("progress-text", text("campaign.done", { done, total }));
}

const nowCommands = () => showCommands(campaign, machine, owner(campaigns));

// -- the result

function showResult() {
  const found = payload?.document;
  byId("result").hidden = !found;
  if (!found) return;
  tell("result-title", text("payload.number", { id: payload.id, before: payload.before, after: payload.after }));
  tell("frame", text("payload.frame", { link: found.link, joint: found.frame }));
  const centre = Object.entries(found.center).map(([axis, one]) => line(text("payload.centre", { axis }), one, "mm", MM));
  const inertia = Object.entries(found.inertia).map(([name, one]) => line(name, one, "kg m²"));
  byId("body").replaceChildren(line(text("mass.mass"), found.mass, "kg"), ...centre, ...inertia);
  byId("notes").replaceChildren(...found.sentences.map((one) => element("p", foreign(one), "finding")));
  const { id, no_sheet: why } = payload;
  tell("downloads", why ? parts("payload.no-sheet", { why: foreign(why) }) : [link(text("payload.sheet"), address(`/payloads/${id}/sheet.md`))]);
}

/** @param {string} name @param {Api.BodyFigure} figure @param {string} unit */
function line(name, { value, std, std_total: total, excited }, unit, factor = 1) {
  const shown = measured(std && std * factor, ...[value, std, total].map((one) => one && one * factor));
  return row([[name], ...(excited ? shown : [text("payload.not-excited"), EMPTY, EMPTY]).map((one) => [one, "number"]), [unit]]);
}

/** @param {Api.PayloadEntry} one */
function listed(one) {
  const state = one.cause ? text("diagnosis-state.failed") : one.state === "cancelled" ? text("campaign-state.aborted") : word("diagnosis-state", one.state);
  const made = row([[one.here ? "" : one.machine, "", link(one.id, `#${one.id}`)], [one.before], [one.after], [state]]);
  if (one.id === payload?.id) made.setAttribute("aria-current", "true");
  return made;
}

// -- what a person does

/** @param {string} id */
function given(id) {
  const value = Number(byId(id).value.trim().replace(",", "."));
  if (!(value > 0)) throw new Told("plan.no-number", { given: byId(id).value });
  return value;
}

async function makePlan() {
  const robot = Number(byId("robot").value);
  const { joints } = await unitsOf(robot);
  const wanted = { kind: "trajectory", robot_id: robot, cell: byId("cell").value, axes: joints, trajectories: given("trajectories"), velocity: given("speed"), move_velocity: SPEED };
  const made = await call("POST", `/plans${typedNames()}`, wanted);
  location.hash = `#plan-${made.content.id}`;
}

// a campaign, which moves nothing until it is started
const prepare = () => call("POST", "/campaigns", { plan_id: plan.id });

async function compute() {
  const [before, after] = pair.map((one) => one.id);
  await call("POST", "/payloads", { before, after });
}

// -- event handlers

const refresh = refresher(show);

/** @param {() => Promise<unknown>} run */
async function command(run) {
  await Promise.resolve().then(run).then(() => complain(null), complain);
  await refresh();
}

for (const [id, run] of /** @type {[string, () => Promise<unknown>][]} */ ([["request", makePlan], ["mount", prepare], ["compute", compute]])) {
  byId(id).addEventListener("submit", async (event) => {
    event.preventDefault();
    const { submitter } = /** @type {SubmitEvent & {submitter: HTMLButtonElement}} */ (event);
    submitter.disabled = true; // one press is one request
    tell("working", id === "request" ? text("plan.working") : "");
    await command(run);
    tell("working", "");
    submitter.disabled = false;
  });
}
byId("speed").value = decimal(SPEED);
watchApproval(command);
watchCommands((name) => command(() => order(campaign, etag, name)), () => questionOf(campaign));
byId("repeat").addEventListener("change", refresh);
window.addEventListener("hashchange", refresh);

const stream = events();
stream.addEventListener("open", refresh); // events were possibly missed
for (const kind of ["campaign", "sweep", "check_move", "diagnosis", "batch", "stop"]) stream.addEventListener(kind, refresh);
watchMachine(refresh, () => held(campaigns), (heard, moving) => {
  const before = stands();
  machine = heard;
  if (stands() !== before) refresh();
  if (campaign) nowCommands();
  if (moving && moving.id === campaign?.id) {
    campaign.progress = moving.progress;
    showProgress();
  }
});
