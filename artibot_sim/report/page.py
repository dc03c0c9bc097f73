"""A self-contained page: charts that can be zoomed, tables, no network."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from artibot_sim.report import style
from artibot_sim.report.panels import Figure
from artibot_sim.report.web import MOST_POINTS, chart, is_thinned

# ----------------------------------------------------------------------
# The frame of every page: one file with its charts, its style and plotly in it, which asks the network for
# nothing.
# ----------------------------------------------------------------------


def render_frame(
    title: str, head: str, main: str, foot: str, data: Any, *, css: str = "", script: str, name: str = "charts"
) -> bytes:
    """Return a page (UTF-8).

    Parameters
    ----------
    title : str
        Plain text, for the browser's window.
    head, main, foot : str
        HTML of the page's parts.
    data : object
        What the script draws from, JSON-ready: plotly figures, say.
    css : str
        Style beside that of all pages.
    script : str
        Draws the charts, and says so: ``document.documentElement.dataset.drawn`` is how many.
    name : str
        What the script calls `data`.
    """
    from plotly.offline import get_plotlyjs

    parts = {
        "TITLE": html.escape(title),
        "STYLE": page_style() + css,
        "HEAD": head,
        "MAIN": main,
        "FOOT": foot,
        "NAME": name,
        "DATA": script_json(data),
        "SCRIPT": script,
        "PLOTLY": get_plotlyjs(),
    }
    return filled(_PAGE, parts).encode()


def filled(text: str, parts: Mapping[str, str]) -> str:
    """Return a text with @NAME@ replaced; what is put in is not looked at again."""
    return re.sub("@([A-Z]+)@", lambda match: parts[match[1]], text)


def script_json(content: Any) -> str:
    """Return JSON that cannot end the script element it stands in."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=False).replace("</", "<\\/")


def page_style() -> str:
    """Return the style sheet of all pages, in the colours of `style`."""
    colours = {name: getattr(style, name) for name in ("INK", "MUTED", "GRID", "PAPER")}
    return filled(_CSS, colours | {"FONTS": style.WEB_FONTS})


_CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: @PAPER@; color: @INK@; font: 15px/1.45 @FONTS@; -webkit-text-size-adjust: 100%; }
main, header, footer { max-width: 1240px; margin: 0 auto; padding: 0 16px; }
header { padding-top: 20px; }
h1 { font-size: 1.5rem; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 1rem; margin: 18px 0 2px; }
header p, footer { color: @MUTED@; font-size: .93rem; }
header p { margin: 2px 0; }
footer { padding-bottom: 24px; padding-top: 12px; }
.key { display: flex; flex-wrap: wrap; gap: 4px 18px; }
.key button { font: inherit; font-size: 1.15rem; color: inherit; background: none; border: 0; padding: 2px 0;
  cursor: pointer; }
.key button::before { content: ""; display: inline-block; width: 1.3em; height: .28em; margin-right: .5em;
  vertical-align: .25em; background: var(--hue); }
.key button[aria-pressed=false] { color: @MUTED@; text-decoration: line-through; }
.key button[aria-pressed=false]::before { background: @GRID@; }
.grid { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 24px; }
.plot { width: 100%; height: 270px; }
.plot.square { height: min(100vw, 560px); }
.scroll { overflow-x: auto; margin-top: 20px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 14px 3px 0; text-align: right; white-space: nowrap; }
th:first-child, td:nth-child(2) { text-align: left; font-weight: normal; }
td:nth-child(2) { color: @MUTED@; }
thead th { font-weight: 600; border-bottom: 1px solid @GRID@; }
tr.name th { font-weight: 600; padding-top: 10px; }
@media (min-width: 860px) {
  .grid { grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); }
  .wide { grid-row: span 2; }
  .both { grid-column: span 2; }
  .wide .plot.square { height: 592px; }
}
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
<main>@MAIN@</main>
<footer>@FOOT@</footer>
<script>const @NAME@ = @DATA@;</script>
<script>@PLOTLY@</script>
<script>@SCRIPT@</script>
</body>
</html>
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
    figure: Figure, table: Sequence[Section] = (), columns: Sequence[str] = (), notes: Sequence[str] = ()
) -> bytes:
    """Return a page (UTF-8) with all panels of a figure.

    Parameters
    ----------
    figure : Figure
    table : sequence of (heading, lines)
        Figures of merit below the charts.
    columns : sequence of str
        Headings of the texts in the table's lines.
    notes : sequence of str
        Sentences at the end.
    """
    hints = (THINNED, HINT) if any(map(is_thinned, figure.panels)) else (HINT,)
    charts = [chart(panel, figure.time_span) | {"time": panel.timed} for panel in figure.panels]
    return render_frame(
        figure.title,
        _head(figure),
        f'\n<div class="grid">\n{_panels(figure)}\n</div>\n{_table(table, columns)}\n',
        "".join(f"<p>{html.escape(note)}</p>" for note in (*notes, *hints)),
        charts,
        script=_SCRIPT,
    )


def _head(figure: Figure) -> str:
    """Return title and subtitle; the names of several recordings are switches in their hues."""
    switches = "".join(
        f'<button type="button" aria-pressed="true" data-bag="{html.escape(label)}" style="--hue:{colour}">'
        f"{html.escape(label)}</button>"
        for label, colour in figure.key
    )
    title = f'<h1 class="key">{switches}</h1>' if switches else f"<h1>{html.escape(figure.title)}</h1>"
    lines = [figure.subtitle]
    if figure.missing:
        lines.append(f"Not drawn, for lack of data: {', '.join(figure.missing)}.")
    return title + "".join(f"<p>{html.escape(line)}</p>" for line in lines)


def _panels(figure: Figure) -> str:
    """Return the charts' places: two columns on a wide screen; a path takes two rows, a last one alone both columns."""
    cells = sum(2 if panel.equal else 1 for panel in figure.panels)
    out = []
    for i, panel in enumerate(figure.panels):
        place = "wide" if panel.equal else "both" if cells % 2 and panel is figure.panels[-1] else "one"
        kind = "plot square" if panel.equal else "plot"
        title = f"<h2>{html.escape(panel.title)}</h2>"
        out.append(f'<section class="{place}">{title}<div id="plot{i}" class="{kind}"></div></section>')
    return "\n".join(out)


def _table(table: Sequence[Section], columns: Sequence[str]) -> str:
    if not any(lines for _, lines in table):
        return ""
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    rows = []
    for heading, lines in table:
        if lines:
            rows.append(f'<tr class="name"><th colspan="{len(columns) + 2}">{html.escape(heading)}</th></tr>')
        for what, unit, texts in lines:
            cells = "".join(f"<td>{html.escape(text)}</td>" for text in texts)
            rows.append(f"<tr><th>{html.escape(what)}</th><td>{html.escape(unit)}</td>{cells}</tr>")
    head = f"<thead><tr><th></th><th></th>{head}</tr></thead>"
    return f'<div class="scroll"><table>{head}<tbody>{"".join(rows)}</tbody></table></div>'


_SCRIPT = """
"use strict";
const coarse = window.matchMedia("(pointer: coarse)").matches;  // a finger on a chart scrolls the page
const settings = {responsive: true, displayModeBar: false};
const plots = charts.map((chart, i) => {
  const plot = document.getElementById("plot" + i);
  chart.layout.dragmode = coarse ? false : "zoom";
  return Plotly.newPlot(plot, chart.data, chart.layout, settings).then(() => plot);
});
Promise.all(plots).then(all => {
  const timed = all.filter((plot, i) => charts[i].time);
  let following = false;
  for (const plot of timed) {
    plot.on("plotly_relayout", change => {  // all time axes show the same span
      const keys = ["xaxis.range[0]", "xaxis.range[1]", "xaxis.range", "xaxis.autorange"].filter(key => key in change);
      if (following || !keys.length) return;
      following = true;
      const range = plot.layout.xaxis.range.slice();
      const others = timed.filter(other => other !== plot);
      Promise.all(others.map(other => Plotly.relayout(other, {"xaxis.range": range.slice()})))
        .finally(() => { following = false; });
    });
  }
  for (const button of document.querySelectorAll("[data-bag]")) {
    button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(shown));
      for (const plot of all) {
        const mine = [];
        plot.data.forEach((trace, i) => { if (trace.meta && trace.meta.bag === button.dataset.bag) mine.push(i); });
        if (mine.length) Plotly.restyle(plot, {visible: shown}, mine);
      }
    });
  }
  document.documentElement.dataset.drawn = String(all.length);
});
"""
