// The page of the plant: control charts of all robots of a type, changes, outliers, and due measurements.

import { address, all, get } from "./api.js";
import { clear } from "./drawing.js";
import { byId, choices, EMPTY, fixed, link, row, tell } from "./elements.js";
import { held } from "./intent.js";
import { watchMachine } from "./machine.js";
import { showMoving } from "./moving.js";
import { plot } from "./plots.js";
import { table } from "./record.js";
import { refresher } from "./refresh.js";
import { events } from "./stream.js";
import { moment, text } from "./words.js";

const DAY = 86_400_000; // ms

/** @type {Api.CampaignDocument[]} */
let campaigns = [];
/** @type {Api.FleetType[]} */
let types = [];

/** @param {Api.FleetRobot} robot */
const label = (robot) => robot.serial ?? `${robot.machine} (${text("fleet.without-serial")})`;
const shownType = () => types.find((one) => one.name === byId("type").value);

async function show() {
  const [listed, diagnoses, fleet] = await Promise.all([all("/campaigns"), all("/diagnoses"), get("/fleet")]);
  campaigns = listed;
  types = fleet.types;
  choices(byId("type"), types.map(({ name }) => [name, name]));
  showType();
  await showMoving(campaigns, diagnoses);
}

function showType() {
  const type = shownType();
  tell("rules", type ? text("fleet.rules", { campaigns: type.campaigns, percent: 100 * type.probability, days: type.remeasure_days }) : text("fleet.none"));
  table("robots", [["fleet.robot"], ["fleet.machine"], ["fleet.campaigns", "number"], ["fleet.measured"], ["fleet.due"], ["fleet.changed"], ["fleet.outlier"]],
    (type?.robots ?? []).map((robot) => row([
      [label(robot)], [robot.machine ?? EMPTY], [robot.campaigns, "number"], [robot.measured_at ? moment(robot.measured_at) : text("fleet.never")],
      [robot.due ? text("fleet.due-now") : moment(robot.due_at)], [robot.changed.join(", ") || EMPTY], [robot.outlier.join(", ") || EMPTY],
    ])));
  const query = type ? `?type=${encodeURIComponent(type.name)}` : "";
  const files = type ? [["report", "report"], ["results.pdf", "report.pdf"], ["results.tables", "report.json"]] : [];
  byId("downloads").replaceChildren(...files.map(([key, name]) => link(text(key), address(`/fleet/${name}${query}`))));
  choices(byId("axis"), (type?.axes ?? []).map((axis) => [axis, axis]));
  showAxis();
}

function showAxis() {
  const type = shownType();
  const axis = byId("axis").value;
  const robots = (type?.robots ?? []).filter((robot) => axis in robot.axes);
  const repeated = robots.some((robot) => robot.axes[axis].points.length > 1);
  tell("between", repeated ? text("fleet.between", { percent: fixed(type.between_percent[axis], 2) }) : "");
  showChart(axis, robots);
  showChanges(axis, robots);
}

/** @param {string} axis @param {Api.FleetRobot[]} robots */
function showChart(axis, robots) {
  if (!robots.length) return clear("chart");
  plot("chart", robots.map((robot, k) => ({
    type: "scatter", mode: "lines+markers", name: label(robot), x: robot.axes[axis].points.map(({ at }) => at),
    y: robot.axes[axis].points.map((one) => one.difference_percent), marker: { symbol: k }, line: { width: robot.changed.includes(axis) ? 4 : 1 },
    error_y: { type: "data", array: robot.axes[axis].points.map((one) => one.std_percent), thickness: 1 },
  })), { xaxis: { title: { text: text("fleet.campaign") }, ...days(robots.flatMap((robot) => robot.axes[axis].points.map(({ at }) => Date.parse(at)))) }, yaxis: { title: { text: text("fleet.change") } } });
}

// axis of whole days, in the same format for each language; a single campaign is in the middle
/** @param {number[]} times */
function days(times) {
  const [first, last] = [Math.min(...times), Math.max(...times)];
  const room = Math.max(DAY, 0.03 * (last - first));
  return { type: "date", tickformat: "%Y-%m-%d", range: [first - room, last + room], ...(last - first < 6 * DAY ? { dtick: DAY } : {}) };
}

/** @param {string} axis @param {Api.FleetRobot[]} robots */
function showChanges(axis, robots) {
  /** @param {number} value */
  const percent = (value) => (value > 0 ? `+${fixed(value, 2)}` : fixed(value, 2));
  /** @param {Api.FleetDifference} one */
  const outlier = (one) => text(!one.outlier ? "fleet.no" : one.by_gain ? "fleet.by-gain" : "fleet.yes");
  table("changes", [["fleet.robot"], ["fleet.change", "number"], ["fleet.std", "number"], ["fleet.kind"], ["fleet.statistic", "number"], ["fleet.alarm"], ["fleet.others", "number"], ["fleet.outlier"]],
    robots.map((robot) => {
      const { change, difference } = robot.axes[axis];
      return row([
        [label(robot)],
        ...(change ? [
          [percent(change.change_percent), "number"], [fixed(change.std_percent, 2), "number"], [change.since === null ? text("fleet.drift") : text("fleet.step", { campaign: change.since })],
          [`${fixed(Math.abs(change.statistic), 1)} (${fixed(change.limit, 1)})`, "number"], [text(change.alarm ? "fleet.yes" : "fleet.no")],
        ] : [[EMPTY, "number"], [EMPTY, "number"], [EMPTY], [EMPTY, "number"], [EMPTY]]),
        ...(difference ? [[percent(difference.difference_percent), "number"], [outlier(difference)]] : [[EMPTY, "number"], [EMPTY]]),
      ]);
    }));
}

const refresh = refresher(show);
byId("type").addEventListener("change", showType);
byId("axis").addEventListener("change", showAxis);
const stream = events();
for (const kind of ["open", "campaign", "estimate"]) stream.addEventListener(kind, refresh);
watchMachine(refresh, () => held(campaigns));
