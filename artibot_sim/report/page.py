"""A self-contained page: charts that can be zoomed, tables, no network."""

from __future__ import annotations

import base64
import html
import json
import re
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from artibot_sim.report import style
from artibot_sim.report.panels import Figure
from artibot_sim.report.web import MOST_POINTS, chart, is_thinned

# ----------------------------------------------------------------------
# The frame of every page: one file with its charts, its style and plotly in it, which asks the network for
# nothing. Its parts are folded under an outline that stays in sight; it is dark where the browser asks for that.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """A part of a page, folded under its heading.

    Attributes
    ----------
    title : str
        Its heading, plain text; a part without one is never folded.
    body : str
        HTML. A part without anything in it is left out.
    opened : bool
        Whether it is open at first.
    word : str
        What the outline calls it; its title where empty.
    anchor : str
        Where links within the page lead; by default its number.
    """

    title: str
    body: str
    opened: bool = True
    word: str = ""
    anchor: str = ""


def render_frame(
    title: str, head: str, parts: Sequence[Part], foot: str, data: Any, *, css: str = "", script: str,
    name: str = "charts",
) -> bytes:  # fmt: skip
    """Return a page (UTF-8).

    Parameters
    ----------
    title : str
        Plain text, for the browser's window.
    head : str
        HTML of what is seen first.
    parts : sequence of Part
    foot : str
        HTML of the page's end.
    data : object
        What the script draws from, JSON-ready: plotly figures, say.
    css : str
        Style beside that of all pages.
    script : str
        Draws the charts, by ``drawParts`` or by ``show``, and says so: ``document.documentElement.dataset.drawn`` is
        how many.
    name : str
        What the script calls `data`.
    """
    shown = [
        replace(part, anchor=part.anchor or f"part{number}") for number, part in enumerate(parts) if part.body.strip()
    ]
    colours = {light.lower(): dark for light, dark in style.DARK.items()}
    fields = {
        "TITLE": html.escape(title),
        "STYLE": page_style() + css,
        "HEAD": head,
        "OUTLINE": _outline(shown),
        "MAIN": "".join(map(_folded, shown)),
        "FOOT": foot,
        "NAME": name,
        "DATA": packed(json.dumps(compact(data), separators=(",", ":"), allow_nan=False, ensure_ascii=False)),
        "COMMON": filled(_COMMON, {"DARK": script_json(colours)}),
        "SCRIPT": script,
        "PLOTLY": _packed_plotly(),
    }
    return filled(_PAGE, fields).encode()


def _outline(parts: Sequence[Part]) -> str:
    """Links to all parts that have a heading, if there are several."""
    links = [
        f'<a href="#{part.anchor}">{html.escape(part.word or part.title)}</a>' for part in parts if part.title
    ]  # fmt: skip
    if len(links) < 2:
        return ""
    every = '<button type="button" data-fold>open all</button>'
    return f'<nav class="outline" aria-label="Outline">{"".join(links)}{every}</nav>'


def _folded(part: Part) -> str:
    """A part under its heading."""
    if not part.title:
        return f'<section class="part" id="{part.anchor}">{part.body}</section>'
    head = f"<summary><h2>{html.escape(part.title)}</h2></summary>"
    return f'<details class="part" id="{part.anchor}"{" open" if part.opened else ""}>{head}{part.body}</details>'


@cache
def _packed_plotly() -> str:
    """Plotly's script: a page is 2 MB so, and 5 MB without."""
    from plotly.offline import get_plotlyjs

    return packed(get_plotlyjs())


def packed(text: str) -> str:
    """A text deflated and in base 85, with a comma for <, which might end the element that it stands in."""
    return base64.b85encode(zlib.compress(text.encode(), 9)).decode().replace("<", ",")


_LONG = 24
"""Numbers from which a list is written as differences."""
_DECIMALS = 9
"""Most decimals of such numbers."""
_WHOLE = 2.0**50
"""Integers below it are exact, here and in a browser."""


def compact(data: Any) -> Any:
    """JSON-ready data in which long lists of numbers are differences of integers: a quarter as long when deflated.

    ``{"~": [decimals, first, next − first, …]}``, null for a gap; what cannot be written so without a loss stays.
    """
    if isinstance(data, Mapping):
        return {key: compact(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return _differences(data) or [compact(value) for value in data]
    return data


def _differences(values: Sequence[Any]) -> dict[str, list[int | None]] | None:
    """A list of numbers as differences; None where it is not one, or too short."""
    if len(values) < _LONG or not all(value is None or type(value) in (int, float) for value in values):
        return None
    known = np.array([value for value in values if value is not None], float)
    for decimals in range(_DECIMALS + 1):
        whole = np.rint(known * 10.0**decimals)
        if np.abs(whole).max(initial=0.0) > _WHOLE:
            return None
        if np.array_equal(whole / 10.0**decimals, known):
            steps = iter(np.diff(whole, prepend=0.0).astype(int).tolist())
            return {"~": [decimals, *(None if value is None else next(steps) for value in values)]}
    return None


def filled(text: str, parts: Mapping[str, str]) -> str:
    """Return a text with @NAME@ replaced; what is put in is not looked at again."""
    return re.sub("@([A-Z]+)@", lambda match: parts[match[1]], text)


def script_json(content: Any) -> str:
    """Return JSON that cannot end the script element it stands in."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=False).replace("</", "<\\/")


_VARIABLES = {
    "ink": style.INK, "muted": style.MUTED, "grid": style.GRID, "paper": style.PAPER, "good": style.TRUE,
    "bad": style.ODOMETRIC, "tie": style.LEFT,
}  # fmt: skip
"""What style sheets call the colours."""


def page_style() -> str:
    """Return the style sheet of all pages, in the colours of `style`, for bright and for dark screens."""
    light = " ".join(f"--{name}: {colour};" for name, colour in _VARIABLES.items())
    dark = " ".join(f"--{name}: {style.DARK[colour]};" for name, colour in _VARIABLES.items())
    return filled(_CSS, {"LIGHT": light, "DARK": dark, "FONTS": style.WEB_FONTS})


_CSS = """
:root { color-scheme: light dark; @LIGHT@ }
@media screen and (prefers-color-scheme: dark) { :root { @DARK@ } }
* { box-sizing: border-box; }
html { scroll-padding-top: 52px; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 15px/1.45 @FONTS@;
  -webkit-text-size-adjust: 100%; }
main, header, footer { max-width: 1240px; margin: 0 auto; padding: 0 16px; }
header { padding-top: 20px; }
a { color: var(--good); }
h1 { font-size: 1.5rem; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 1rem; margin: 18px 0 2px; }
header p, footer { color: var(--muted); font-size: .93rem; }
header p { margin: 2px 0; }
header p.said { color: var(--ink); font-size: 1.05rem; margin-top: 6px; }
footer { padding-bottom: 24px; padding-top: 12px; }
ul.findings, ul.warnings { padding-left: 1.2em; margin: 6px 0; max-width: 84ch; }
ul.findings { margin-bottom: 14px; } ul.findings:has(+ details) { margin-bottom: 4px; }
ul.findings li, ul.warnings li { list-style: none; border-left: 4px solid var(--tie); padding-left: 10px;
  margin: 4px 0 4px -1.2em; overflow-wrap: anywhere; }
details.findings { margin-bottom: 14px; } details.findings summary { cursor: pointer; color: var(--good); }
nav.outline { position: sticky; top: 0; z-index: 5; display: flex; gap: 2px 4px; overflow-x: auto; white-space: nowrap;
  background: var(--paper); border-bottom: 1px solid var(--grid); padding: 6px 12px; margin-top: 10px; }
nav.outline a, nav.outline button { font: inherit; font-size: .9rem; color: var(--muted); text-decoration: none;
  background: none; border: 0; padding: 3px 8px; border-radius: 6px; cursor: pointer; text-align: left; }
nav.outline a[aria-current], nav.outline a:hover, nav.outline button:hover { color: var(--ink);
  background: var(--grid); }
.part > summary { cursor: pointer; border-top: 2px solid var(--grid); padding: 8px 0; margin-top: 14px; }
.part > summary h2 { display: inline; font-size: 1.2rem; margin: 0; }
.part > summary::marker { color: var(--muted); }
.key { display: flex; flex-wrap: wrap; gap: 4px 18px; }
.key button { font: inherit; font-size: 1.15rem; color: inherit; background: none; border: 0; padding: 2px 0;
  cursor: pointer; }
.key button::before { content: ""; display: inline-block; width: 1.3em; height: .28em; margin-right: .5em;
  vertical-align: .25em; background: var(--hue); }
.key button[aria-pressed=false] { color: var(--muted); text-decoration: line-through; }
.key button[aria-pressed=false]::before { background: var(--grid); }
.grid { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 24px; }
.grid h3 { font-size: 1rem; margin: 12px 0 2px; }
.grid.alike { grid-template-columns: repeat(auto-fit, minmax(min(100%, 300px), 1fr)); }
.plot { width: 100%; height: 270px; }
.plot.square { height: min(100vw, 560px); }
.scroll { overflow-x: auto; margin-top: 20px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 14px 3px 0; text-align: right; white-space: nowrap; }
th:first-child, td:nth-child(2) { text-align: left; font-weight: normal; }
td:nth-child(2) { color: var(--muted); }
thead th { font-weight: 600; border-bottom: 1px solid var(--grid); }
tr.name th { font-weight: 600; padding-top: 10px; }
@media (max-width: 600px) {  /* names stay in sight while numbers scroll */
  th, td { padding-right: 9px; }
  thead th { white-space: normal; }
  .scroll .name span { display: inline-block; position: sticky; left: 0; max-width: 90vw; white-space: normal; }
  .scroll tr:not(.name) > :first-child { position: sticky; left: 0; background: var(--paper);
    min-width: min(9em, var(--longest, 9em)); max-width: 46vw; white-space: normal; overflow-wrap: anywhere; }
}
@media (min-width: 860px) {
  .grid:not(.alike) { grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); }
  .wide { grid-row: span 2; }
  .both { grid-column: span 2; }
  .wide .plot.square { height: 592px; }
  .alike .plot.square { height: 360px; }
}
@media screen and (min-width: 1180px) {
  html { scroll-padding-top: 8px; }
  body:has(nav.outline) { display: grid; grid-template-columns: 200px minmax(0, 1240px); justify-content: center; }
  body:has(nav.outline) :is(header, main, footer) { grid-column: 2; width: 100%; }
  nav.outline { grid-column: 1; grid-row: 1 / span 4; align-self: start; flex-direction: column; white-space: normal;
    max-height: 100vh; overflow: hidden auto; border: 0; margin: 0; padding: 26px 4px 12px 12px; }
}
@media print { nav.outline { display: none; } }
"""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:">
<title>@TITLE@</title>
<style>@STYLE@</style>
</head>
<body>
<header>@HEAD@</header>
@OUTLINE@
<main>@MAIN@</main>
<footer>@FOOT@</footer>
<script type="text/plain" id="data">@DATA@</script>
<script type="text/plain" id="plotly">@PLOTLY@</script>
<script>@COMMON@
let @NAME@;
start(unpackedData => { @NAME@ = unpackedData; @SCRIPT@});</script>
</body>
</html>
"""

_COMMON = """
"use strict";
const coarse = window.matchMedia("(pointer: coarse)").matches;  // a finger on a chart scrolls the page
const settings = {responsive: true, displayModeBar: false};
const night = window.matchMedia("(prefers-color-scheme: dark)"), dark = @DARK@;
const shown = new Map();  // place of a chart -> [data, layout] as on paper
let printing = false;

async function unpacked(id) {  // a text that was deflated and written in base 85
  const digits = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`{|}~";
  const value = new Uint8Array(128), text = document.getElementById(id).textContent;
  for (let i = 0; i < 85; i++) value[digits.charCodeAt(i)] = i;
  const bytes = new Uint8Array(Math.ceil(text.length / 5) * 4);
  for (let i = 0, at = 0; i < text.length; i += 5) {
    let word = 0;
    for (let k = i; k < i + 5; k++) word = word * 85 + (k < text.length ? value[text.charCodeAt(k)] : 84);
    for (let shift = 3; shift >= 0; shift--) { bytes[at + shift] = word % 256; word = Math.floor(word / 256); }
    at += 4;
  }
  const size = Math.floor(text.length * 4 / 5);
  const stream = new Blob([bytes.subarray(0, size)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).text();
}

async function start(then) {  // unpacks plotly and runs it, then the page's own script on what it draws from
  const script = document.createElement("script");
  script.textContent = await unpacked("plotly");
  document.head.append(script);
  then(JSON.parse(await unpacked("data"), expanded));
}

function expanded(key, value) {  // long lists of numbers are written as differences
  if (value === null || typeof value !== "object" || !("~" in value)) return value;
  const [decimals, ...steps] = value["~"];
  let at = 0;
  return steps.map(step => step === null ? null : (at += step) / 10 ** decimals);
}

function inScheme(content) {  // with the colours of a dark screen, where the browser asks for one
  if (!night.matches || printing) return content;
  const found = /#[0-9a-f]{6}(?![0-9a-f])|rgba[(]255,255,255,0[.]75[)]/gi;
  return JSON.parse(JSON.stringify(content).replace(found, colour => dark[colour.toLowerCase()] || colour));
}
function show(place, data, layout) {  // draws a chart, or draws it anew
  const target = typeof place === "string" ? document.getElementById(place) : place;
  shown.set(target, [data, layout]);
  return Plotly.react(target, inScheme(data), inScheme(layout), settings).then(() => target);
}
function recolour() {
  for (const [target, [data, layout]] of shown) Plotly.react(target, inScheme(data), inScheme(layout), settings);
}
night.addEventListener("change", recolour);
window.addEventListener("beforeprint", () => { printing = true; if (night.matches) recolour(); });
window.addEventListener("afterprint", () => { printing = false; if (night.matches) recolour(); });

function drawParts(each) {  // draws charts[i] at #plot<i> as soon as its part is open; each(plot, i) follows
  const done = new Set();
  const draw = place => {
    const i = Number(place.id.slice(4));
    if (done.has(i)) return null;
    done.add(i);
    charts[i].layout.dragmode = coarse ? false : "zoom";
    return show(place, charts[i].data, charts[i].layout).then(plot => { if (each) each(plot, i); });
  };
  const drawOpen = () => {  // a place in a closed part has no size
    const places = [...document.querySelectorAll(".plot")].filter(place => !place.closest("details:not([open])"));
    return Promise.all(places.map(draw)).then(() => { document.documentElement.dataset.drawn = String(done.size); });
  };
  for (const part of document.querySelectorAll("details")) part.addEventListener("toggle", drawOpen);
  drawOpen();
}

const parts = [...document.querySelectorAll(".part")], links = [...document.querySelectorAll("nav.outline a")];
const openAt = hash => {
  const part = hash.length > 1 && document.getElementById(decodeURIComponent(hash.slice(1)));
  if (part && part.tagName === "DETAILS") part.open = true;
  return part;
};
for (const link of links) link.addEventListener("click", () => openAt(link.hash));
const fold = document.querySelector("nav.outline [data-fold]");
if (fold) fold.addEventListener("click", () => {
  const open = fold.textContent === "open all";
  for (const part of document.querySelectorAll("details")) part.open = open;
  fold.textContent = open ? "fold all" : "open all";
});
if (location.hash === "#all") for (const part of document.querySelectorAll("details")) part.open = true;
else openAt(location.hash);
const sighted = new Set();
const observer = new IntersectionObserver(entries => {
  for (const entry of entries) sighted[entry.isIntersecting ? "add" : "delete"](entry.target);
  const first = parts.find(part => sighted.has(part));
  for (const link of links) {
    if (first && link.hash === "#" + first.id) link.setAttribute("aria-current", "true");
    else link.removeAttribute("aria-current");
  }
}, {rootMargin: "-60px 0px -50% 0px"});
for (const part of parts) observer.observe(part);
"""


# ----------------------------------------------------------------------
# A self-contained page: charts that can be zoomed, a table, no network.
# ----------------------------------------------------------------------


HINT = (
    "Drag over a chart to zoom in (all time axes follow), drag with shift to move, double-click for all; "
    "click on a legend to hide a line."
)
THINNED = (
    f"Lines of more than {MOST_POINTS:,} samples are drawn with about that many, peaks included (on a map evenly); "
    "artibot plot with --start and --end draws a part with every sample."
).replace(",", " ", 1)
Section = tuple[str, Sequence[tuple[str, str, Sequence[str]]]]
"""Heading and lines (quantity, unit, texts) of a part of a table."""


def render_page(
    figure: Figure,
    table: Sequence[Section] = (),
    columns: Sequence[str] = (),
    notes: Sequence[str] = (),
    *,
    said: Sequence[str] = (),
    findings: Sequence[str] = (),
    answer: Sequence[str] = (),
    first: int = 0,
    closed: Collection[str] = (),
) -> bytes:
    """Return a page (UTF-8) with all panels of a figure.

    Parameters
    ----------
    figure : Figure
        Its panels stand in the parts that they name, in the order in which parts are named first.
    table : sequence of (heading, lines)
        Figures of merit below the charts.
    columns : sequence of str
        Headings of the texts in the table's lines; the table has no head where all are empty.
    notes : sequence of str
        Sentences at the end.
    said : sequence of str
        Sentences below the title, on the first screen.
    findings : sequence of str
        Sentences at the beginning, before the answer's tables.
    answer : sequence of str
        Sentences below these.
    first : int
        So many sections of the table stand with the answer.
    closed : collection of str
        Parts that are folded at first; ``table`` is the one of the table.
    """
    hints = (THINNED, HINT) if any(map(is_thinned, figure.panels)) else (HINT,)
    charts = [chart(panel, figure.time_span) | {"time": panel.timed} for panel in figure.panels]
    below = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in answer)
    parts = [Part("Answer", findings_list(findings) + _table(table[:first], columns) + below)]
    for name in dict.fromkeys(panel.part for panel in figure.panels):
        parts.append(Part(name or "Charts", _panels(figure, name), name not in closed))
    parts.append(Part("Figures of merit", _table(table[first:], columns), "table" not in closed))
    return render_frame(
        figure.title,
        _head(figure, said),
        parts,
        "".join(f"<p>{html.escape(note)}</p>" for note in (*notes, *hints)),
        charts,
        script=_SCRIPT,
    )


def listed(lines: Sequence[str], name: str = "") -> str:
    """A list of plain texts."""
    inside = "".join(f"<li>{html.escape(line)}</li>" for line in lines)
    return f'<ul class="{name}">{inside}</ul>' if inside else ""


def findings_list(lines: Sequence[str]) -> str:
    """What is wrong with recordings: the first open, the rest folded; a phone's first screen has the verdict, too."""
    if len(lines) <= 2:
        return listed(lines, "findings")
    rest = f"<summary>{len(lines) - 1} more about the recordings</summary>{listed(lines[1:], 'findings')}"
    return f'{listed(lines[:1], "findings")}<details class="findings">{rest}</details>'


def _head(figure: Figure, said: Sequence[str]) -> str:
    """Return title, subtitle and what is said first; the names of several recordings are switches in their hues."""
    switches = "".join(
        f'<button type="button" aria-pressed="true" data-bag="{html.escape(label)}" style="--hue:{colour}">'
        f"{html.escape(label)}</button>"
        for label, colour in figure.key
    )
    title = f'<h1 class="key">{switches}</h1>' if switches else f"<h1>{html.escape(figure.title)}</h1>"
    lines = [figure.subtitle]
    if figure.missing:
        lines.append(f"Not drawn, for lack of data: {', '.join(figure.missing)}.")
    first = "".join(f'<p class="said">{html.escape(sentence)}</p>' for sentence in said)
    return title + "".join(f"<p>{html.escape(line)}</p>" for line in lines) + first


def _panels(figure: Figure, part: str) -> str:
    """Return the places of a part's charts: two columns on a wide screen.

    A path takes two rows, a last one alone both columns; paths among themselves stand side by side.
    """
    mine = [(i, panel) for i, panel in enumerate(figure.panels) if panel.part == part]
    alike = all(panel.equal for _, panel in mine) and len(mine) > 1
    cells = sum(2 if panel.equal and not alike else 1 for _, panel in mine)
    out = []
    for i, panel in mine:
        last = cells % 2 == 1 and panel is mine[-1][1] and not alike
        place = "one" if alike else "wide" if panel.equal else "both" if last else "one"
        kind = "plot square" if panel.equal else "plot"
        title = f"<h3>{html.escape(panel.title)}</h3>"
        out.append(f'<section class="{place}">{title}<div id="plot{i}" class="{kind}"></div></section>')
    return f'<div class="grid{" alike" if alike else ""}">\n{chr(10).join(out)}\n</div>'


def _table(table: Sequence[Section], columns: Sequence[str]) -> str:
    if not any(lines for _, lines in table):
        return ""
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    rows = []
    for heading, lines in table:
        if lines:
            name = f"<span>{html.escape(heading)}</span>"  # stays in sight while numbers scroll
            rows.append(f'<tr class="name"><th colspan="{len(columns) + 2}">{name}</th></tr>')
        for what, unit, texts in lines:
            cells = "".join(f"<td>{html.escape(text)}</td>" for text in texts)
            rows.append(f"<tr><th>{breakable(what)}</th><td>{html.escape(unit)}</td>{cells}</tr>")
    head = f"<thead><tr><th></th><th></th>{head}</tr></thead>" if any(columns) else ""
    longest = max(len(what) for _, lines in table for what, _, _ in lines)  # a phone has no place for more
    body = f"{head}<tbody>{''.join(rows)}</tbody>"
    return f'<div class="scroll"><table style="--longest: {longest + 3}ch">{body}</table></div>'


_LONG = 12
"""Letters of a name that a phone has place for, beside numbers."""


def breakable(name: str) -> str:
    """A name as HTML, which may be broken after dots and underscores where it is too long for a phone."""
    said = html.escape(name)
    return re.sub(r"(?<=\w)([._])(?=[^\W\d])", r"\1<wbr>", said) if len(name) > _LONG else said


_SCRIPT = """
const timed = [], all = [];
let following = false;
drawParts((plot, i) => {
  all.push(plot);
  if (!charts[i].time) return;
  timed.push(plot);
  plot.on("plotly_relayout", change => {  // all time axes show the same span
    const keys = ["xaxis.range[0]", "xaxis.range[1]", "xaxis.range", "xaxis.autorange"].filter(key => key in change);
    if (following || !keys.length) return;
    following = true;
    const range = plot.layout.xaxis.range.slice();
    const others = timed.filter(other => other !== plot);
    Promise.all(others.map(other => Plotly.relayout(other, {"xaxis.range": range.slice()})))
      .finally(() => { following = false; });
  });
});
for (const button of document.querySelectorAll("[data-bag]")) {
  button.addEventListener("click", () => {
    const pressed = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(pressed));
    for (const plot of all) {
      const mine = [];
      plot.data.forEach((trace, i) => { if (trace.meta && trace.meta.bag === button.dataset.bag) mine.push(i); });
      if (mine.length) Plotly.restyle(plot, {visible: pressed}, mine);
    }
  });
}
"""
