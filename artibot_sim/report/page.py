"""A self-contained page: charts that can be zoomed, a table, no network."""

from __future__ import annotations

import html
from collections.abc import Sequence

from artibot_sim.report.frame import render_frame
from artibot_sim.report.panels import Figure
from artibot_sim.report.web import MOST_POINTS, chart, is_thinned

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
