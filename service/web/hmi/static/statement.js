// The state of the machine as the service states it: moves, energised, stands (reported and fresh), or unknown.

import { LIMIT } from "./fresh.js";
import { foreign, joined, text, word } from "./words.js";

// joints in that state
/** @param {Api.StatementView} statement @param {string} state */
export const jointsThat = (statement, state) => Object.entries(statement.axes).filter(([, axis]) => axis.state === state).map(([joint]) => joint);

// "joint_2 moves", "all axes stand without energy"
/** @param {Api.StatementView} statement */
export function stated(statement) {
  const { state, axes } = statement;
  const joints = jointsThat(statement, state);
  const all = !joints.length || joints.length === Object.keys(axes).length;
  return all ? word("statement", state) : text(`statement-of.${state}`, { axes: joints.join(", "), count: joints.length });
}

// why it is not known, as parts
/** @param {Api.StatementView} statement */
export function reasonOf(statement) {
  if (statement.reason) return [foreign(statement.reason)];
  const silent = Object.entries(statement.axes).filter(([, axis]) => axis.state === "unknown");
  if (!silent.length) return [text("intent.old", { seconds: LIMIT })];
  const told = silent.filter(([, axis]) => axis.reason).map(([joint, axis]) => [`${joint}: `, foreign(axis.reason)]);
  return told.length ? joined(told, "; ") : [text("intent.no-word", { axes: silent.map(([joint]) => joint).join(", ") })];
}
