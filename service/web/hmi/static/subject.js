// Robot, cell and machine of a plan; names of a robot or cell that is not the machine's are typed by a person.

import { get, Refused } from "./api.js";
import { byId, tell } from "./elements.js";
import { foreign, parts, text } from "./words.js";

/** @type {{robot: string | undefined, cell: string | null} | null} */
let asked = null; // names that were chosen

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
