"""Style and script of a diagnosis' page."""

from __future__ import annotations

CSS = """
h1 { font-size: 1.55rem; line-height: 1.25; max-width: 62ch; }
h2 { font-size: 1.2rem; margin: 34px 0 4px; border-top: 2px solid @GRID@; padding-top: 14px; }
h3 { font-size: .98rem; margin: 12px 0 0; }
main p, main li { max-width: 84ch; }
main p { color: @MUTED@; margin: 4px 0; }
header p.sure { color: inherit; max-width: 84ch; font-size: 1rem; }
header p.verdict { display: inline-block; margin: 0 0 6px; padding: 1px 10px; border-radius: 10px; color: #fff;
  font-weight: 600; background: @MUTED@; }
header p.verdict.named { background: @GOOD@; } header p.verdict.ambiguous { background: @TIE@; }
header p.verdict.unexplained { background: @BAD@; }
p.next { color: inherit; font-weight: 600; }
ul { padding-left: 1.2em; margin: 6px 0; } li { margin: 4px 0; overflow-wrap: anywhere; }
ul.said li::first-letter { text-transform: uppercase; }
ul.warnings li { list-style: none; border-left: 4px solid @TIE@; padding-left: 10px; margin-left: -1.2em; }
details { margin: 8px 0; } summary { cursor: pointer; padding: 4px 0; color: @GOOD@; }
.first, .row, .grid3 { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 24px; }
.plot.square { height: min(92vw, 460px); }
.plot.low { height: 230px; } .plot.bars { height: 380px; }
table td:nth-child(2) { color: inherit; }
.wrap { display: inline-block; white-space: normal; min-width: 14em; max-width: min(56em, 78vw); text-align: left; }
td.text { text-align: left; } th.text { text-align: left; }
tr.found td, tr.found th { font-weight: 600; } tr.ties th { color: @TIE@; }
svg.ci { display: block; }
@media (max-width: 600px) { h1 { font-size: 1.25rem; } }
@media (min-width: 860px) {
  .first { grid-template-columns: minmax(0, 11fr) minmax(0, 9fr); }
  .first .plot.square { height: 500px; }
  .row { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .grid3 { grid-template-columns: repeat(3, minmax(0, 1fr)); }
  .grid3 .plot.square { height: 330px; } .grid3 .plot { height: 240px; }
  .row .plot.bars { height: 420px; }
}
@media print {
  body { font-size: 11pt; } main, header, footer { max-width: none; padding: 0; }
  .cell, table, li { break-inside: avoid; } h2, h3 { break-after: avoid; }
  details:not([open]) { display: none; } summary { list-style: none; color: inherit; font-weight: 600; }
  .scroll { overflow: visible; } th, td { padding-right: 8px; font-size: 9.5pt; }
  .first, .row, .grid3 { grid-template-columns: repeat(2, minmax(0, 1fr)); }
}
"""

SCRIPT = """
"use strict";
const coarse = window.matchMedia("(pointer: coarse)").matches;  // a finger on a chart scrolls the page
const settings = {responsive: true, displayModeBar: false};
const done = new Set();
function draw(place) {  // a place in a closed part has no size, so it waits until it is opened
  const i = Number(place.id.slice(4));
  if (done.has(i)) return null;
  done.add(i);
  charts[i].layout.dragmode = coarse ? false : "zoom";
  return Plotly.newPlot(place, charts[i].data, charts[i].layout, settings);
}
function drawAll(places) {
  return Promise.all(places.map(draw)).then(() => { document.documentElement.dataset.drawn = String(done.size); });
}
const all = location.hash === "#all";
for (const part of document.querySelectorAll("details")) {
  if (all) part.open = true;
  part.addEventListener("toggle", () => { if (part.open) drawAll([...part.querySelectorAll(".plot")]); });
}
drawAll([...document.querySelectorAll(".plot")].filter(place => !place.closest("details:not([open])")));
function fit(width) {  // a sheet of paper has room for two columns of this, px; null is as wide as the screen has room
  for (const i of done) Plotly.relayout("plot" + i, {width: width, autosize: width === null});
}
window.addEventListener("beforeprint", () => fit(340));
window.addEventListener("afterprint", () => fit(null));
"""
