// The planning page: the requested measurement, its motion, and a campaign of it. Nothing moves here.

import { all, call, get } from "./api.js";
import { byId, choices, complain, confidence, duration, element, link, tell } from "./elements.js";
import { held } from "./intent.js";
import { watchMachine } from "./machine.js";
import { showMotion, unitsOf } from "./motion.js";
import { showMoving } from "./moving.js";
import { showGrid, showPicture } from "./picture.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";
import { aheadOf, showSubjects, typedNames } from "./subject.js";
import { foreign, formula, joined, language, text, Told } from "./words.js";

const USUAL = { poses: ["24", "5"], confidence: [text("plan.usual-confidence"), "5"], duration: ["60", "5"], diagnosis: ["4", "10"] }; // amount and step
const MINUTE = 60; // s

/** @type {Api.CampaignDocument | undefined} */
let paused; // the paused campaign
/** @type {(Api.PlanView & {document: Api.PlanDocument}) | null} */
let plan = null; // {id, robot_id, document}
let diagnosing = false; // whether it is for a diagnosis
/** @type {Units | null} */
let units = null;
/** @type {Api.PoseGrid | null} */
let grid = null;

// -- the request

async function showRobots() {
  const [campaigns, diagnoses] = await Promise.all([all("/campaigns"), all("/diagnoses")]);
  paused = held(campaigns);
  await showMoving(campaigns, diagnoses);
  if (await showSubjects()) await showJoints();
  if (plan) await showPlan();
}

async function showJoints() {
  const id = byId("robot").value;
  if (!id) return;
  const joints = (await get(`/robots/${id}`)).description.axes.map((axis) => axis.joint);
  for (const [id, first] of /** @type {[string, number][]} */ ([["axes-measured", 0], ["axes-varied", 1]])) {
    byId(id).replaceChildren(byId(id).firstElementChild, ...joints.map((joint, k) => box(joint, k >= first && k < 3)));
  }
}

function box(joint, checked) {
  const input = element("input");
  input.type = "checkbox";
  input.value = joint;
  input.checked = checked;
  const label = element("label");
  label.append(input, ` ${joint}`);
  return label;
}

const chosen = (/** @type {string} */ id) => [...byId(id).querySelectorAll(/** @type {"input"} */ (":checked"))].map((one) => one.value);

// comma or point, depending on the keyboard
function given(id) {
  const value = Number(byId(id).value.trim().replace(",", "."));
  if (!(value > 0)) throw new Told("plan.no-number", { given: byId(id).value });
  return value;
}

async function makePlan() {
  const budget = byId("budget").value;
  const amount = given("amount") * (budget === "duration" ? MINUTE : 1);
  const request = { robot_id: Number(byId("robot").value), cell: byId("cell").value, axes: chosen("axes-measured"), varied: chosen("axes-varied"), step: given("step") };
  if (!request.axes.length || !request.varied.length) throw new Told("plan.no-axes");
  const wanted = budget === "diagnosis" ? { ...request, kind: "diagnosis", poses: amount } : { ...request, [budget]: amount, simultaneous: byId("at-once").checked };
  const made = await call("POST", `/plans${typedNames()}`, wanted);
  diagnosing = budget === "diagnosis";
  plan = /** @type {typeof plan} */ (made.content);
  byId("taken").replaceChildren();
  units = await unitsOf(plan.robot_id);
  grid = diagnosing ? null : await get(`/plans/${plan.id}/grid`);
  choices(byId("sweep"), plan.document.sweeps.map((sweep, k) => [k + 1, `${k + 1}: ${sweep.spec.axis}`]));
  byId("sweep").value = "1";
  showLegs();
  await showPlan();
}

// -- the plan

async function showPlan() {
  const { document: content, id } = plan;
  byId("planned").hidden = false;
  tell("planned-title", text("plan.number", { id }));
  const expected = diagnosing ? null : content.confidence.at(-1);
  tell("promise", diagnosing ? text("plan.diagnosis") : expected === null ? openPromise(content) : text("plan.promise", { confidence: confidence(expected) }));
  tell("groups", diagnosing ? "" : groupsOf(content));
  const shown = `${id}/${language()}`;
  if (byId("motion").dataset.shown === shown) return;
  showMotion(byId("motion"), { ...content, duration: plan.expected_time }, units, await get("/drives"), await aheadOf(`/plans/${id}/ahead`));
  byId("motion").dataset.shown = shown;
  showGrid(grid, units);
  await showArm();
}

// plans of older versions do not name the parameters
/** @param {Api.PlanDocument} document */
function openPromise({ undetermined = [], enough_poses: poses = null }) {
  if (undetermined.length === 0) return text("plan.open");
  return `${text("plan.undetermined", { parameters: undetermined.map(formula).join(", ") })} ${poses === null ? text("plan.more") : text("plan.enough", { poses })}`;
}

// which axes move at once, and what one axis at a time would take
/** @param {Api.PlanDocument} document @returns {Content} */
function groupsOf({ request, groups = [], compared = [], alone = "" }) {
  if (!request.simultaneous) return "";
  const single = compared.find((one) => !one.groups.length);
  const time = single?.duration ? text("plan.single", { time: duration(single.duration) }) : "";
  const sets = groups.filter((one) => one.length > 1).map((one) => one.join(" + "));
  return joined([sets.length ? text("plan.groups", { sets: sets.join("; ") }) : text("plan.no-groups"), sets.length ? time : "", foreign(alone)].filter(Boolean), " ");
}

const sweepOf = () => plan.document.sweeps[Number(byId("sweep").value) - 1];

function showLegs() {
  const legs = sweepOf().legs.map((leg, k) => [k + 1, `${k + 1}: ${leg.joint}`]);
  choices(byId("leg"), [[0, text("plan.before")], ...legs]);
  byId("leg").value = String(legs.length);
}

async function showArm() {
  const picture = await get(`/plans/${plan.id}/picture?sweep=${byId("sweep").value}&step=${byId("leg").value}`);
  const told = picture.joints.map((joint, k) => `${joint} ${units.length(joint, picture.pose[k])}`).join(", ");
  tell("picture-told", told);
  showPicture(picture);
}

async function take() {
  const made = await call("POST", "/campaigns", { plan_id: plan.id });
  const { id } = made.content;
  byId("taken").replaceChildren(link(text("plan.taken", { id }), `./#campaign-${id}`));
}

// -- event handlers

const refresh = refresher(showRobots);

const busy = (/** @type {string} */ button, /** @type {() => Promise<void>} */ run) => async (/** @type {Event} */ event) => {
  event.preventDefault();
  byId(button).disabled = true;
  tell("working", button === "make" ? text("plan.working") : "");
  await run().then(() => complain(null), complain);
  tell("working", "");
  byId(button).disabled = false;
};

byId("request").querySelector("button").id = "make";
byId("request").addEventListener("submit", busy("make", makePlan));
byId("take").addEventListener("click", busy("take", take));
byId("robot").addEventListener("change", () => showJoints().catch(complain));
byId("budget").addEventListener("change", () => {
  const budget = byId("budget").value;
  [byId("amount").value, byId("step").value] = USUAL[budget];
  byId("at-once-choice").hidden = budget === "diagnosis";
});
byId("sweep").addEventListener("change", () => {
  showLegs();
  showArm().catch(complain);
});
byId("leg").addEventListener("change", () => showArm().catch(complain));
const stream = events();
stream.addEventListener("open", refresh);
for (const kind of ["campaign", "diagnosis", "stop"]) stream.addEventListener(kind, refresh);
watchMachine(refresh, () => paused);
