// Loads Plotly, which is large, only when a page works (STOP first) and only for pages with charts.

import { complain } from "./elements.js";
import { Told } from "./words.js";

const QUIET = { displayModeBar: false, responsive: true };

const wanted = new Map(); // content by element: while Plotly is loading, only the last content is kept
/** @type {Promise<typeof Plotly> | null} */
let coming = null;

function plotly() {
  coming ??= new Promise((done, failed) => {
    const script = document.createElement("script");
    script.src = "plotly.min.js";
    script.onload = () => done(globalThis.Plotly);
    script.onerror = () => {
      coming = null; // the next chart tries again
      script.remove();
      failed(new Told("error.charts"));
    };
    document.head.append(script);
  });
  return coming;
}

// place: an element or its id
/** @param {string | HTMLElement} place @param {object[]} traces @param {object} layout */
export function draw(place, traces, layout) {
  const mine = [traces, layout];
  wanted.set(place, mine);
  plotly().then((drawn) => {
    if (wanted.get(place) === mine) drawn.react(place, traces, layout, QUIET);
  }).catch(complain);
}

/** @param {string | Element} place */
export function clear(place) {
  wanted.delete(place);
  const there = typeof place === "string" ? document.getElementById(place) : place;
  if (there.classList.contains("js-plotly-plot")) globalThis.Plotly.purge(there);
}
