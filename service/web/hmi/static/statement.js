// The state of the machine as the service states it: moves, energised, stands (reported and fresh), or unknown.

import { LIMIT } from "./fresh.js";
import { foreign, joined, text, word } from "./words.js";

// joints in that state
/** @param {Api.StatementView} statement @param {string} state */
export const jointsThat = (statement, state) => Object.entries(statement.axes).filter(([, axis]) => axis.state === state).map(([joint]) => joint);

// joints that the headline names: those that move, or have energy
/** @param {Api.StatementView} statement */
export const named = (statement) => (["moves", "energised"].includes(statement.state) ? jointsThat(statement, statement.state) : []);

// the steps from the one that the headline names: what the campaign tells is some ms younger or older, and names no other
/** @param {Api.StepView[]} steps @param {Api.StatementView} statement */
export function stepsFrom(steps, statement) {
  const joints = named(statement);
  if (!joints.length) return steps;
  const now = steps.findIndex(({ axes }) => axes.some((axis) => joints.includes(axis)));
  return now < 0 ? [] : steps.slice(now);
}

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
