// The arm in its cell, from the side and from above, and the grid of poses of the plan.

import { clear } from "./drawing.js";
import { byId, element } from "./elements.js";
import { plot } from "./plots.js";
import { text } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
const VIEWS = { side: "plan.side", above: "plan.above" };
const STATES = { collides: ["#b90e2a", "x"], no_room: ["#8f5200", "triangle-up"], free: ["#7a8696", "circle-open"], chosen: ["#2f7ef0", "square"] };

/** @param {Api.Picture} picture */
export function showPicture(picture) {
  byId("views").replaceChildren(...Object.entries(VIEWS).map(([view, key]) => {
    const figure = element("figure");
    figure.append(drawn(picture, /** @type {View} */ (view), text(key)), element("figcaption", text(key)));
    return figure;
  }));
}

/** @param {Api.Picture} picture @param {View} view @param {string} name */
function drawn({ robot, cell, floor }, view, name) {
  const base = robot.filter((one) => one.name === robot[0].name); // may have a plate as large as the hall
  const links = robot.filter((one) => one.name !== robot[0].name);
  const points = [...links, ...cell, ...(cell.length ? [] : base)].flatMap((one) => one[view]);
  const [left, right] = range(points.map(([x]) => x));
  const [low, high] = range([...points.map(([, y]) => y), ...(view === "side" && floor !== null ? [floor] : [])]);
  const [width, height] = [right - left + 0.2, high - low + 0.2]; // m
  const svg = made("svg", { viewBox: `${left - 0.1} ${-high - 0.1} ${width} ${height}`, class: "arm", role: "img", "aria-label": name });
  svg.style.aspectRatio = String(width / height);
  svg.style.maxWidth = `${(28 * width) / height}rem`;
  if (view === "side" && floor !== null) svg.append(made("line", { x1: left, x2: right, y1: -floor, y2: -floor, class: "floor" }));
  svg.append(...base.map((one) => shape(one, view, "base")), ...cell.map((one) => shape(one, view, "cell")), ...links.map((one) => shape(one, view, "link")));
  return svg;
}

/** @param {Api.OutlineView} one @param {View} view @param {string} kind */
function shape(one, view, kind) {
  const polygon = made("polygon", { points: one[view].map(([x, y]) => `${x},${-y}`).join(" "), class: kind });
  const title = made("title", {});
  title.textContent = one.name;
  polygon.append(title);
  return polygon;
}

/** @param {string} tag @param {object} attributes */
function made(tag, attributes) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

/** @param {number[]} values */
const range = (values) => [Math.min(...values), Math.max(...values)];

// for one or two varied joints; with more joints there is no picture
/** @param {Api.PoseGrid | null} grid @param {Units} units */
export function showGrid(grid, units) {
  byId("grid").hidden = grid === null || grid.varied.length > 2;
  if (byId("grid").hidden) return clear("grid");
  const scales = grid.varied.map((joint) => units.scale(joint));
  /** @param {Api.GridPose} pose @param {number} k */
  const along = (pose, k) => (k < scales.length ? pose.at[k] * scales[k][0] : 0);
  plot("grid", Object.entries(STATES).map(([state, [color, symbol]]) => {
    const poses = grid.poses.filter((one) => one.state === state);
    return {
      type: "scatter", mode: "markers", name: text(`pose-state.${state}`, { count: poses.length }), marker: { color, symbol, size: state === "chosen" ? 11 : 6 },
      x: poses.map((one) => along(one, 0)), y: poses.map((one) => along(one, 1)),
    };
  }), Object.fromEntries(["xaxis", "yaxis"].map((name, k) => [name, { title: { text: grid.varied[k] ? `${grid.varied[k]}, ${scales[k][1].trim()}` : "" } }])));
}
