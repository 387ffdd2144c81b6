// The first of two steps to a start, where the service wants it: an engineer approves what will move.

import { call, get, Refused } from "./api.js";
import { byId, duration, tell } from "./elements.js";

let present = null; // {plan, needed, missing, sha256} of the plan shown, or null

// why this person may not start the campaign shown; empty for who may
export const unapproved = () => (present?.needed ? present.missing : "");

// a cell that cannot be read keeps a plan from starting as well
function whyNone(error) {
  if (!(error instanceof Refused)) throw error;
  return { needed: true, missing: error.message };
}

// plan: {id, document} or null; left: its sweeps that a start will run, in so many seconds
export async function showApproval(plan, left, seconds) {
  present = plan && left.length ? { plan: plan.id, ...(await get(`/plans/${plan.id}/approvals`).catch(whyNone)) } : null;
  byId("approve").hidden = unapproved() === "" || !present.sha256;
  if (byId("approve").hidden) return;
  tell("approve-why", present.missing);
  const axes = [...new Set(left.map((sweep) => sweep.spec.axis))].join(", ");
  tell("approve-it", `Approve: ${axes}, ${left.length} sweep${left.length === 1 ? "" : "s"}, ${duration(seconds)}`);
}

// run(work) does it and shows what came of it
export function watchApproval(run) {
  byId("approve").addEventListener("submit", (event) => {
    event.preventDefault();
    const { plan, sha256 } = present;
    run(() => call("POST", `/plans/${plan}/approvals`, { sha256, approved_by: byId("approve-by").value }));
  });
}
