// What a page may say of the machine now: a statement that is too old says nothing.

export const LIMIT = 3; // s between the question to the drives and what a person reads

/** @typedef {{statement: Api.StatementView, asked: number}} Report asked: ms, before its request was sent */

// the time of the answer on its way and of the page that waited counts: the drives were asked no earlier than so
/** @param {Report | null} report @param {number} now ms @returns {Api.StatementView} */
export function asOf(report, now) {
  const age = report && report.statement.age !== null ? report.statement.age + (now - report.asked) / 1000 : null;
  if (report && (report.statement.state === "unknown" || (age !== null && age <= LIMIT))) return { ...report.statement, age };
  return { state: "unknown", age, reason: "", axes: {} };
}
