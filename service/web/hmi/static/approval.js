// The first of two steps to a start, if the service requires it: an engineer approves the motion.

import { call, get, Refused } from "./api.js";
import { byId, duration, tell } from "./elements.js";
import { subjectParts } from "./subject.js";
import { foreign, text, told } from "./words.js";

/** @type {{plan: number, needed: boolean, missing: string | Error, sha256?: string, subject?: Api.PlanSubject} | null} */
let present = null; // of the displayed plan

// why this person may not start the displayed campaign, as parts; empty if allowed
export const unapproved = () => (present?.needed && present.missing ? why(present.missing) : "");

/** @param {string | Error} missing */
const why = (missing) => (missing instanceof Error ? told(missing) : [foreign(missing)]);

// an unreadable cell also prevents the start of a plan
/** @param {Error} error */
function whyNone(error) {
  if (!(error instanceof Refused)) throw error;
  return { needed: true, missing: error };
}

// plan: {id, document} or null; left: the sweeps that a start will run; seconds: their duration
/** @param {Plan | null} plan @param {Sweep[]} left @param {number} seconds */
export async function showApproval(plan, left, seconds) {
  present = plan && left.length ? { plan: plan.id, ...(await get(`/plans/${plan.id}/approvals`).catch(whyNone)) } : null;
  byId("approve").hidden = unapproved() === "" || !present.sha256;
  if (byId("approve").hidden) return;
  tell("approve-why", unapproved());
  const axes = [...new Set(left.map((sweep) => sweep.spec.axis))].join(", ");
  tell("approve-it", text("approval.approve", { axes, count: left.length, time: duration(seconds), subject: subjectParts(present.subject).join("") }));
}

// run(work) executes it and shows the result
/** @param {(run: () => Promise<unknown>) => void} run */
export function watchApproval(run) {
  byId("approve").addEventListener("submit", (event) => {
    event.preventDefault();
    const { plan, sha256 } = present;
    run(() => call("POST", `/plans/${plan}/approvals`, { sha256, approved_by: byId("approve-by").value }));
  });
}
