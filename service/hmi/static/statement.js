// The state of the machine as the service states it: moves, energised, stands (reported and fresh), or unknown.

import { foreign, joined, text, word } from "./words.js";

const WITHOUT_ENERGY = ["disabled", "fault"]; // states of an axis

// of the answer for the drives; from its axes if the service gives no statement
/** @param {Api.DrivesView} drives @returns {Api.Statement} */
export function statementOf({ statement, connected, trouble, axes }) {
  if (statement) return statement;
  /** @param {Api.AxisView} axis */
  const one = ({ state }) => (state === "unknown" ? "unknown" : WITHOUT_ENERGY.includes(state) ? "stands" : "energised");
  const states = axes.map(one);
  const state = !connected || states.includes("unknown") ? "unknown" : states.includes("energised") ? "energised" : "stands";
  return { state, age: 0, reason: trouble, axes: Object.fromEntries(axes.map((axis, k) => [axis.joint, { state: states[k], age: 0, reason: "" }])) };
}

// joints in that state
/** @param {Api.Statement} statement @param {string} state */
export const jointsThat = (statement, state) => Object.entries(statement.axes).filter(([, axis]) => axis.state === state).map(([joint]) => joint);

// "joint_2 moves", "all axes stand without energy"
/** @param {Api.Statement} statement */
export function stated(statement) {
  const { state, axes } = statement;
  const joints = jointsThat(statement, state);
  const all = !joints.length || joints.length === Object.keys(axes).length;
  return all ? word("statement", state) : text(`statement-of.${state}`, { axes: joints.join(", "), count: joints.length });
}

// why it is not known, as parts
/** @param {Api.Statement} statement */
export function reasonOf(statement) {
  if (statement.reason) return [foreign(statement.reason)];
  const silent = Object.entries(statement.axes).filter(([, axis]) => axis.state === "unknown");
  const told = silent.filter(([, axis]) => axis.reason).map(([joint, axis]) => [`${joint}: `, foreign(axis.reason)]);
  return told.length ? joined(told, "; ") : [text("intent.no-word", { axes: silent.map(([joint]) => joint).join(", ") })];
}
