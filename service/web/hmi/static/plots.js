// Plots in the colours and with the decimal sign of the page.

import { draw } from "./drawing.js";
import { separators } from "./words.js";

const GRID = "rgba(128,128,128,.25)";

// axes: of the layout, by name
export function plot(id, traces, axes) {
  const ink = getComputedStyle(document.body).color;
  const named = Object.fromEntries(Object.entries(axes).map(([name, axis]) => [name, { gridcolor: GRID, zeroline: false, automargin: true, ...axis }]));
  draw(id, traces, {
    separators: separators(), margin: { l: 60, r: 10, t: 10, b: 45 }, paper_bgcolor: "transparent", plot_bgcolor: "transparent",
    font: { color: ink }, legend: { orientation: "h", y: 1.15 }, ...named,
  });
}
