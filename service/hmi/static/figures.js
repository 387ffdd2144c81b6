// The report's figures in the colours of the page.

import { element } from "./elements.js";

const TITLES = {
  map: "Where the gap is",
  gap_by_pose: "Gap before and after, on held-out sweeps",
  example: "The held-out sweep with the largest gap",
  evidence: "How far behind every other candidate is",
  parameters: "Parameters with two standard deviations",
};
const CAPTIONS = {
  evidence: "Every other candidate in its place, and how far behind it is. Amber ones are not ruled out. Grey ones are: " +
    "far behind (beyond the dashed line), or richer without explaining more, or against physics.",
};
const GRID = "rgba(128,128,128,.25)";

export function drawFigures(place, figures, axis) {
  for (const old of place.querySelectorAll(".figure")) Plotly.purge(old);
  place.replaceChildren();
  for (const [name, figure] of Object.entries(figures)) {
    place.append(element("h2", TITLES[name] ?? name));
    if (name === "map") place.append(...sentencesOf(axis).map((sentence) => element("p", sentence)));
    if (CAPTIONS[name]) place.append(element("p", CAPTIONS[name]));
    const plot = element("div", undefined, "figure");
    plot.id = `figure-${name}`;
    plot.style.height = `${figure.layout.height}px`;
    const scroll = element("div", undefined, "scroll");
    scroll.append(plot);
    place.append(scroll);
    Plotly.newPlot(plot, figure.data, inColours(figure.layout), { displayModeBar: false, responsive: true });
  }
}

// what the check of the data found stands above
function sentencesOf(axis) {
  const told = new Set((axis.data ?? []).map((finding) => finding.sentence));
  return axis.sentences.filter((sentence) => !told.has(sentence));
}

function inColours(layout) {
  const ink = getComputedStyle(document.body).color;
  const axes = Object.entries(layout).filter(([key]) => /^[xy]axis\d*$/.test(key));
  return {
    ...layout,
    ...Object.fromEntries(axes.map(([key, axis]) => [key, { ...axis, gridcolor: GRID }])),
    font: { ...layout.font, color: ink },
    paper_bgcolor: "transparent",
    plot_bgcolor: "transparent",
  };
}
