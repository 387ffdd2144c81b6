// Robot, cell and machine of a plan; names of a robot or cell that is not the machine's are typed by a person.

import { all, get, Refused } from "./api.js";
import { byId, choices, tell } from "./elements.js";
import { foreign, parts, text } from "./words.js";

/** @type {{robot: string | undefined, cell: string | null} | null} */
let asked = null; // names that were chosen
/** @type {Api.RobotEntry[]} */
let robots = [];
/** @type {Here | null} */
let present = null; // machine of this service, with its robot and cell; null: not requested yet

// without a machine, its names are null
/** @returns {Promise<Here>} */
export async function machineHere() {
  const { items, missing } = await get("/machines");
  return { name: null, robot_id: null, robot: null, cell: null, ...items.find((one) => one.here), missing };
}

// of /plans/N/ahead, /campaigns/N/ahead; null while a campaign runs
/** @param {`/plans/${number}/ahead` | `/campaigns/${number}/ahead?repeat=${boolean}`} path @returns {Promise<Api.Ahead | null>} */
export async function aheadOf(path) {
  return await get(path).catch((error) => {
    if (!(error instanceof Refused)) throw error;
    return null;
  });
}

// robot, cell: the chosen ones
/** @param {Here} machine @param {{id: number, name: string} | undefined} robot @param {string | null} cell */
export function askNames(machine, robot, cell) {
  const others = { robot: robot && robot.id !== machine.robot_id, cell: cell && cell !== machine.cell };
  byId("confirm").hidden = !others.robot && !others.cell;
  const own = machine.robot && machine.cell ? parts("confirm.own", { robot: machine.robot, cell: machine.cell }) : machine.missing.map(foreign);
  if (!byId("confirm").hidden) tell("confirm-why", parts("confirm.why", { machine: machine.name ?? "", own }));
  for (const [what, name, key] of [["robot", robot?.name, "confirm.robot"], ["cell", cell, "confirm.cell"]]) {
    const input = byId(`confirm-${what}`);
    byId(`confirm-${what}-choice`).hidden = !others[what];
    if (asked?.[what] !== name) input.value = "";
    tell(`confirm-${what}-text`, text(key, { name: name ?? "" }));
  }
  asked = { robot: robot?.name, cell };
}

// robots and cells to choose from, those of the machine first; whether the robots are others than before
export async function showSubjects() {
  const [known, cells, here] = await Promise.all([all("/robots"), get("/cells"), machineHere()]);
  choices(byId("cell"), cells.names.map((name) => [name, name]));
  const changed = known.length !== robots.length;
  robots = known;
  choices(byId("robot"), robots.map((one) => [one.id, `${one.name} (${one.id})`]).reverse());
  if (!present) {
    byId("robot").value = here.robot_id ?? ""; // without a robot or cell of the machine a person chooses one
    byId("cell").value = here.cell ?? "";
    for (const id of ["robot", "cell"]) byId(id).addEventListener("change", askChosen);
  }
  present = here;
  askChosen();
  return changed;
}

const askChosen = () => askNames(present, robots.find((one) => String(one.id) === byId("robot").value), byId("cell").value);

// of the request: the service compares the names
/** @returns {"" | `?${string}`} */
export function typedNames() {
  const query = new URLSearchParams();
  for (const what of ["robot", "cell"]) {
    const input = byId(`confirm-${what}`);
    if (!byId(`confirm-${what}-choice`).hidden && input.value) query.set(`confirm_${what}`, input.value.trim());
  }
  return query.size ? `?${query}` : "";
}

/** @param {Api.PlanSubject} subject @returns {Part[]} */
export function subjectParts({ robot, robot_id: number, cell, machine, confirmed, confirmed_by: by }) {
  const told = parts("subject.told", { robot, number, cell, machine: machine || text("subject.unknown") });
  const names = Object.values(confirmed).join(", ");
  return names ? [...told, " ", ...parts(by ? "subject.confirmed-by" : "subject.confirmed", { names, by })] : told;
}
