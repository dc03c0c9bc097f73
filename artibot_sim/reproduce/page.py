"""All sections as one page and as pictures: charts, tables, statements."""

from __future__ import annotations

import html
import re
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.report import style
from artibot_sim.report.page import Part, render_frame
from artibot_sim.report.panels import Panel, extent
from artibot_sim.report.png import draw_panel, legend, new_canvas, to_png
from artibot_sim.report.web import chart, numbers
from artibot_sim.reproduce.result import HeatMap, Section, Sheet, Statement, TextTable, the_paper

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

# ----------------------------------------------------------------------
# A sheet as PNG: rows of charts, drawn by matplotlib in the style of all pictures.
# ----------------------------------------------------------------------


SHEET_WIDTH = 15.0
"""Inches."""
DPI = 110
_ROW = 4.1
_FLAT = 3.4
"""Height of a row without positions or maps, inches."""
NEGATIVE, POSITIVE = style.ODOMETRIC, style.TRUE
"""Ends of the colours of maps; between them is paper, at zero."""


def render_sheet(sheet: Sheet) -> bytes:
    """Return a sheet as a picture, 1650 px wide."""
    import matplotlib

    lines = textwrap.wrap(sheet.caption, 215)
    head = 0.62 + 0.2 * len(lines)
    heights = [_ROW if any(_tall(chart) for chart in row) else _FLAT for row in sheet.rows]
    with matplotlib.rc_context(style.matplotlib_style()):
        height = head + sum(heights)
        canvas = new_canvas(SHEET_WIDTH, height, layout="constrained")
        engine: Any = canvas.get_layout_engine()
        engine.set(rect=(0.005, 0, 0.99, 1 - head / height), h_pad=0.1, w_pad=0.12)
        columns = max(len(row) for row in sheet.rows)
        grid = canvas.add_gridspec(len(sheet.rows), columns, height_ratios=heights)
        for i, row in enumerate(sheet.rows):
            places = [canvas.add_subplot(grid[i, j]) for j in range(len(row))]
            _draw_row(canvas, places, row, (SHEET_WIDTH / columns - 0.9) * 72)
        canvas.text(0.012, 1 - 0.16 / height, sheet.title, fontsize=14, fontweight="bold", va="top")
        canvas.text(
            0.012, 1 - 0.48 / height, "\n".join(lines), fontsize=9.5, color=style.MUTED, va="top", linespacing=1.35
        )
        return to_png(canvas, DPI)


def _tall(chart: Panel | HeatMap) -> bool:
    return isinstance(chart, HeatMap) or chart.equal


def _draw_row(canvas: Canvas, places: Sequence[Axes], row: Sequence[Panel | HeatMap], width: float) -> None:
    """Draw a row; titles stay level above legends of different height."""
    rows = []
    image: Any = None
    for axes, shown in zip(places, row, strict=True):
        if isinstance(shown, HeatMap):
            image = _draw_map(axes, shown)
            rows.append(0)
        else:
            draw_panel(axes, shown)
            if not shown.equal:
                axes.set_xlim(*extent([line.x for line in shown.lines]))
            rows.append(legend(canvas, axes, shown, width))
    for axes in places:
        axes.set_title(axes.get_title(loc="left"), pad=7.0 + 14.0 * max(rows))
    if image is not None:
        canvas.colorbar(image, ax=list(places), label=_unit(row[0]), pad=0.01, aspect=30)


def _unit(chart: Panel | HeatMap) -> str:
    return chart.unit if isinstance(chart, HeatMap) else ""


def _draw_map(axes: Axes, chart: HeatMap) -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("diverging", [NEGATIVE, style.PAPER, POSITIVE])
    image = axes.pcolormesh(
        chart.x, chart.y, chart.z, cmap=colours, vmin=-chart.scale, vmax=chart.scale, shading="gouraud"
    )
    for x, y in chart.zero:
        axes.plot(x, y, color=style.INK, lw=1.8)
    axes.axhline(0.0, color=style.MUTED, lw=0.8, ls=style.DASHES["dash"], zorder=1.5)
    for at, text in chart.marks:
        axes.axvline(at, color=style.MUTED, lw=1.0, ls=style.DASHES["dot"])
        side = "left" if at < 0.9 * chart.x.max() else "right"
        box = {"boxstyle": "round,pad=0.15", "fc": style.PAPER, "ec": "none", "alpha": 0.75}
        where: dict[str, Any] = {
            "xytext": (5 if side == "left" else -5, -5),
            "textcoords": "offset points",
            "ha": side,
            "va": "top",
        }
        axes.annotate(text, (at, chart.y.max()), fontsize=8.5, color=style.INK, bbox=box, **where)
    axes.set_xlabel(chart.x_label)
    axes.set_ylabel(chart.y_label)
    axes.set_title(chart.title)
    axes.set_yticks(np.arange(-60, 61, 20))
    axes.grid(False)
    return image


# ----------------------------------------------------------------------
# A section's verdict, statements and tables as PNG, for where no page can be shown.
# ----------------------------------------------------------------------


SUMMARY_WIDTH = 13.2
"""Inches."""
_LINE = 0.185
_COLUMNS = 172
"""Characters of the fixed-width type that fit side by side."""

Row = tuple[str, str, bool]
"""Text, colour, and whether it is bold."""


def lines(section: Section) -> list[Row]:
    """The section as lines of text."""
    title = f"Section {section.number}: {section.title}"
    out: list[Row] = [(title, style.INK, True), (section.verdict, style.INK, True)]
    for note in (*section.short, *section.notes):
        out += _wrapped(note, style.MUTED)
    for statement in section.statements:
        word, colour = ("holds", style.TRUE) if statement.holds else ("does not hold", style.ODOMETRIC)
        out.append(("", style.INK, False))
        out += _wrapped(f"{word}: {statement.claim}", colour)
        out += _wrapped(statement.evidence, style.MUTED, "    ")
    for table in section.tables:
        out += [("", style.INK, False), (table.title, style.INK, True), *_summary_table(table)]
    return out


def _wrapped(text: str, colour: str, indent: str = "") -> list[Row]:
    wrapped = textwrap.wrap(text, _COLUMNS, initial_indent=indent, subsequent_indent=indent)
    return [(line, colour, False) for line in wrapped]


def _summary_table(table: TextTable) -> list[Row]:
    """The rows with their columns aligned; headings that are wider than their column are wrapped."""
    cells = [max([len(row[i]) for row in table.rows] + [0]) for i in range(len(table.columns))]
    words = [max([len(word) for word in head.split()] + [9]) for head in table.columns]
    widths = [max(pair) for pair in zip(cells, words, strict=True)]
    heads = [textwrap.wrap(head, width) or [""] for head, width in zip(table.columns, widths, strict=True)]
    tall = max(map(len, heads))
    heading = [[""] * (tall - len(head)) + head for head in heads]
    rows = [tuple(column[i] for column in heading) for i in range(tall)]
    out = [(_aligned(row, widths), style.MUTED, False) for row in rows]
    out += [(_aligned(row, widths), style.INK, False) for row in table.rows]
    return out + (_wrapped(table.note, style.MUTED) if table.note else [])


def _aligned(row: tuple[str, ...], widths: list[int]) -> str:
    """The first column to the left, the others to the right."""
    first = row[0].ljust(widths[0])
    return "  ".join([first, *(text.rjust(width) for text, width in zip(row[1:], widths[1:], strict=True))])


def render_summary(section: Section) -> bytes:
    """Return the section's verdict, statements and tables as a picture."""
    import matplotlib

    rows = lines(section)
    height = 0.3 + _LINE * len(rows)
    with matplotlib.rc_context(style.matplotlib_style() | {"font.family": ["DejaVu Sans Mono"]}):
        canvas = new_canvas(SUMMARY_WIDTH, height)
        for i, (text, colour, bold) in enumerate(rows):
            canvas.text(
                0.15 / SUMMARY_WIDTH, 1 - (0.2 + _LINE * i) / height, text, fontsize=9, color=colour, va="top",
                fontweight="bold" if bold else "normal", parse_math=False,
            )  # fmt: skip
        return to_png(canvas, 110)


# ----------------------------------------------------------------------
# All sections as one page: charts that can be zoomed, tables, statements; one file that needs no network.
# ----------------------------------------------------------------------


TITLE = "The paper, reproduced"
INTRO = (
    "Data Driven Analysis of Locomotion for a Class of Articulated Mobile Robots: its figures and tables from "
    "artibot's model, beside the printed numbers. Whether something agrees or holds is computed from the numbers shown."
)


def render(sections: Sequence[Section], version: str) -> bytes:
    """Return the page (UTF-8)."""
    charts = [_chart(item) for section in sections for sheet in section.sheets for row in sheet.rows for item in row]
    counter = iter(range(len(charts)))
    summary = "".join(
        f'<li><a href="#s{section.number}">Section {section.number}, {html.escape(section.title)}</a>: '
        f"{html.escape(section.verdict)}{_short(section)}</li>"
        for section in sections
    )
    head = f"<h1>{html.escape(TITLE)}</h1><p>{html.escape(INTRO)}</p><ul>{summary}</ul>"
    parts = [
        Part(
            f"Section {section.number}: {section.title}", _section(section, counter), len(sections) == 1,
            f"Section {section.number}", f"s{section.number}",
        )
        for section in sections
    ]  # fmt: skip
    parts.append(Part("The paper, figure by figure", _table(the_paper(sections)), False, anchor="paper"))
    foot = f"<p>{_text(f'artibot {version}, `artibot reproduce`')}</p>"
    return render_frame(TITLE, head, parts, foot, charts, css=_CSS, script="drawParts();")


def _text(text: str) -> str:
    """A text as HTML; what stands between backticks is code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(text))


def _short(section: Section) -> str:
    return "".join(f"<p>{html.escape(sentence)}</p>" for sentence in section.short)


def _section(section: Section, counter: Any) -> str:
    parts = [f'<p class="verdict">{html.escape(section.verdict)}</p>']
    parts += [f"<p>{_text(note)}</p>" for note in section.notes]
    first_what_fails = sorted(section.statements, key=lambda statement: statement.holds)
    if section.statements:
        parts.append("<h3>What holds and what does not</h3>")
        parts.append(f'<ul class="claims">{"".join(map(_statement, first_what_fails))}</ul>')
    parts += [_sheet(sheet, counter) for sheet in section.sheets]
    parts += [_table(table) for table in section.tables]
    return "".join(parts)


def _statement(statement: Statement) -> str:
    state, word = ("good", "holds") if statement.holds else ("bad", "does not hold")
    return f'<li class="{state}"><b>{word}</b> {_text(statement.claim)} <small>{_text(statement.evidence)}</small></li>'


def _sheet(sheet: Sheet, counter: Any) -> str:
    rows = []
    for row in sheet.rows:
        cells = []
        for item in row:
            kind = "plot square" if isinstance(item, HeatMap) or item.equal else "plot"
            title = html.escape(item.title)
            cells.append(f'<div class="cell"><h4>{title}</h4><div id="plot{next(counter)}" class="{kind}"></div></div>')
        rows.append(f'<div class="row n{len(row)}">{"".join(cells)}</div>')
    return (
        f"<figure><h3>{html.escape(sheet.title)}</h3><figcaption>{_text(sheet.caption)}</figcaption>"
        f"{''.join(rows)}</figure>"
    )


SENTENCE = 40
"""A column with a text longer than this is broken into lines, characters."""


def _table(table: TextTable) -> str:
    marks = ["text" if max(map(len, column), default=0) > SENTENCE else "" for column in zip(*table.rows, strict=True)]
    marks = marks or [""] * len(table.columns)
    head = "".join(
        f'<th class="{mark}">{html.escape(column)}</th>' for column, mark in zip(table.columns, marks, strict=True)
    )
    body = "".join(
        "<tr>"
        + "".join(
            f'<td class="{_mark(text) or mark}">{html.escape(text)}</td>' for text, mark in zip(row, marks, strict=True)
        )
        + "</tr>"
        for row in table.rows
    )
    note = f"<p>{_text(table.note)}</p>" if table.note else ""
    return (
        f'<h3>{html.escape(table.title)}</h3><div class="scroll"><table class="plain"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>{note}"
    )


def _mark(text: str) -> str:
    return {"yes": "good", "no": "bad"}.get(text, "")


def _chart(item: Panel | HeatMap) -> dict[str, Any]:
    if isinstance(item, HeatMap):
        return _map(item)
    drawn = chart(item, extent([line.x for line in item.lines]))
    drawn["layout"]["hovermode"] = "closest"
    return drawn


def _map(item: HeatMap) -> dict[str, Any]:
    """Return a map as a plotly figure."""
    data: list[dict[str, Any]] = [
        {
            "type": "heatmap", "x": numbers(item.x), "y": numbers(item.y), "z": [numbers(row, 4) for row in item.z],
            "zmin": -item.scale, "zmax": item.scale, "zsmooth": "best",
            "colorscale": [[0, NEGATIVE], [0.5, style.PAPER], [1, POSITIVE]],
            "colorbar": {"thickness": 10, "title": {"text": item.unit, "side": "right"}},
            "hovertemplate": "%{x:.2f}, %{y:.0f}°: %{z:.4f} " + item.unit + "<extra></extra>",
        }
    ]  # fmt: skip
    for x, y in item.zero:
        data.append(
            {"type": "scatter", "mode": "lines", "x": numbers(x), "y": numbers(y), "hoverinfo": "skip",
             "line": {"color": style.INK, "width": 2.5}, "showlegend": False}
        )  # fmt: skip
    shapes = [
        {"type": "line", "x0": x, "x1": x, "yref": "paper", "y0": 0, "y1": 1,
         "line": {"color": style.MUTED, "width": 1.2, "dash": "dot"}}
        for x, _ in item.marks
    ]  # fmt: skip
    notes = [
        {"x": x, "y": 1, "yref": "paper", "text": text, "showarrow": False, "xanchor": "left", "yanchor": "top",
         "bgcolor": style.VEIL, "font": {"size": 12}}
        for x, text in item.marks
    ]  # fmt: skip
    axis = {"zeroline": False, "showgrid": False, "automargin": True, "tickfont": {"color": style.MUTED}}
    layout = {
        "font": {"family": style.WEB_FONTS, "size": 13, "color": style.INK}, "paper_bgcolor": style.PAPER,
        "plot_bgcolor": style.PAPER, "margin": {"l": 56, "r": 8, "t": 8, "b": 44}, "autosize": True,
        "xaxis": axis | {"title": {"text": item.x_label}, "range": [float(np.min(item.x)), float(np.max(item.x))]},
        "yaxis": axis | {"title": {"text": item.y_label}, "range": [float(np.min(item.y)), float(np.max(item.y))]},
        "shapes": shapes, "annotations": notes, "showlegend": False,
    }  # fmt: skip
    return {"data": data, "layout": layout}


_CSS = """
h3 { font-size: 1.05rem; margin: 26px 0 2px; }
h4 { font-size: .95rem; margin: 12px 0 0; }
main p, figcaption { color: var(--muted); margin: 4px 0; max-width: 90ch; }
code { white-space: nowrap; }
p.verdict { color: inherit; font-weight: 600; }
figure { margin: 0; }
.row { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 20px; }
.row .plot { height: 300px; }
.row .plot.square { height: min(92vw, 380px); }
ul.claims { list-style: none; padding: 0; max-width: 110ch; }
ul.claims li { margin: 7px 0; padding-left: 12px; border-left: 4px solid var(--grid); }
ul.claims li.good { border-color: var(--good); } ul.claims li.bad { border-color: var(--bad); }
li.good b, td.good { color: var(--good); } li.bad b, td.bad { color: var(--bad); }
ul.claims small { color: var(--muted); font-size: .9em; }
table.plain th { white-space: normal; vertical-align: bottom; max-width: 12em; }
table.plain td:nth-child(2) { color: inherit; text-align: right; }
table.plain td:first-child { text-align: left; white-space: normal; min-width: 9em; }
table.plain td.text { text-align: left; white-space: normal; min-width: 15em; max-width: 46em; }
table.plain th.text { text-align: left; }
table.plain td { vertical-align: top; }
@media (max-width: 600px) {
  table.plain td.text { min-width: 11em; }
  table.plain td.text:not(:first-child) { overflow-wrap: anywhere; }
  table.plain td:first-child:not(.text) { min-width: 5em; }
}
@media (min-width: 980px) {
  .row.n2 { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .row.n3 { grid-template-columns: repeat(3, minmax(0, 1fr)); }
  .row.n3 .plot, .row.n3 .plot.square { height: 350px; }
}
"""
