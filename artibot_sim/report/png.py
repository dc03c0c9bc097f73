"""Figure data as a PNG, drawn by matplotlib."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.report import style
from artibot_sim.report.panels import Arrows, Figure, Outline, Panel, constant_range

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

WIDTH = 12.0
"""Inches; at 100 to the inch (1200 px on a screen) the type has its natural size."""
DPI = 150
_ROW = 2.75
_HEAD = 0.62
_TITLE = 58
"""Characters of a title that fit over a panel of one column."""


def render_png(figure: Figure) -> bytes:
    """Return a picture of all panels, 1800 px wide: the path at the upper left, the others beside and below it.

    Neither matplotlib's settings nor its current figures are touched.
    """
    import matplotlib

    with matplotlib.rc_context(style.matplotlib_style()):
        canvas, places = _layout(figure)
        for panel, axes in zip(figure.panels, places, strict=True):
            draw_panel(axes, panel)
            if panel.timed and figure.time_span[0] < figure.time_span[1]:
                axes.set_xlim(*figure.time_span)
        _legends(canvas, figure, places)
        _heading(canvas, figure)
        return to_png(canvas, DPI)


def to_png(canvas: Canvas, dpi: int) -> bytes:
    """Return a matplotlib figure as PNG, the same bytes for the same figure."""
    stream = io.BytesIO()
    canvas.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return stream.getvalue()


def new_canvas(width: float, height: float, **options: Any) -> Canvas:
    """Return an empty figure (inches) that draws by Agg, unknown to pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(width, height), **options)
    FigureCanvasAgg(canvas)
    return canvas


def _layout(figure: Figure) -> tuple[Canvas, list[Axes]]:
    """Return axes for all panels."""
    cells = place(figure.panels)
    rows = max(cell[0].stop for cell in cells)
    head = _HEAD + 0.18 * len(_said(figure))
    height = head + _ROW * rows
    canvas = new_canvas(WIDTH, height, layout="constrained")
    engine: Any = canvas.get_layout_engine()
    engine.set(rect=(0, 0, 1, 1 - head / height), h_pad=0.1, w_pad=0.14)
    grid = canvas.add_gridspec(rows, 2)
    return canvas, [canvas.add_subplot(grid[cell]) for cell in cells]


def place(panels: Sequence[Panel]) -> list[tuple[slice, slice]]:
    """Return rows and columns of panels in two columns: a path takes two rows, the last one what would stay empty."""
    cells: list[tuple[slice, slice]] = []
    free = [(row, column) for row in range(2 * len(panels)) for column in (0, 1)]
    for panel in panels:
        row, column = free.pop(0)
        if panel.equal:
            free.remove((row + 1, column))
        cells.append((slice(row, row + 1 + panel.equal), slice(column, column + 1)))
    rows = max(cell[0].stop for cell in cells)
    if free[0][0] < rows:
        last_rows, last_columns = cells[-1]
        below = last_columns.start == free[0][1]
        cells[-1] = (slice(last_rows.start, rows), last_columns) if below else (last_rows, slice(0, 2))
    return cells


def _heading(canvas: Canvas, figure: Figure) -> None:
    """Write title, subtitle and the recordings' hues above the panels."""
    height = canvas.get_figheight()
    lines = _said(figure)
    left, top = 0.15 / WIDTH, 0.16
    if figure.key:
        _key(canvas, figure, left, 1 - top / height)
    else:
        canvas.text(left, 1 - top / height, figure.title, fontsize=14, fontweight="bold", va="top")
    canvas.text(
        left, 1 - (top + 0.3) / height, "\n".join(lines), fontsize=9.5, color=style.MUTED, va="top", linespacing=1.35
    )


def _said(figure: Figure) -> list[str]:
    lines = [figure.subtitle]
    if figure.missing:
        lines.append(f"not drawn, for lack of data: {', '.join(figure.missing)}")
    return [part for line in lines for part in textwrap.wrap(line, 150)]


def _key(canvas: Canvas, figure: Figure, left: float, top: float) -> None:
    """Write the recordings' names as the title, each behind a swatch of its hue."""
    from matplotlib.lines import Line2D

    canvas.legend(
        handles=[Line2D([], [], color=colour, lw=4, solid_capstyle="butt") for _, colour in figure.key],
        labels=[label for label, _ in figure.key], loc="upper left", bbox_to_anchor=(left, top), ncols=len(figure.key),
        prop={"size": 13 if len(figure.key) < 4 else 10, "weight": "bold"}, handlelength=1.3, columnspacing=2.0,
        borderpad=0.0,
    )  # fmt: skip


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw a panel's contents and labels, without its legend."""
    for rover in panel.outlines:
        draw_outline(axes, rover)
    for line in panel.lines:
        axes.plot(line.x, line.y, **line_style(line.stroke), label=f"_{line.name}")
    for level in panel.levels:
        axes.axhline(level.value, **line_style(level.stroke), label=level.name or "_level", zorder=1.5)
    for arrows in panel.arrows:
        draw_arrows(axes, arrows)
    if len(panel.starts):
        axes.plot(*panel.starts.T, "o", ms=6, mfc=style.PAPER, mec=style.INK, mew=1.4, label="start", zorder=5)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    columns = len(spec.colspan) if (spec := axes.get_subplotspec()) is not None else 2
    axes.set_title(textwrap.fill(panel.title, _TITLE * columns))
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.05)
        if (constant := constant_range(*axes.dataLim.intervalx)) is not None:
            axes.set_xlim(*constant)
    if (constant := constant_range(*axes.dataLim.intervaly)) is not None:
        axes.set_ylim(*constant)
    if panel.names:
        axes.set_yticks(range(1, len(panel.names) + 1), panel.names)
        axes.set_ylim(len(panel.names) + 0.5, 0.5)


def line_style(stroke: style.Stroke) -> dict[str, Any]:
    """Return a stroke in matplotlib's words."""
    if stroke.dash == "points":
        return {
            "ls": "none",
            "marker": "o",
            "ms": stroke.width,
            "mew": 0,
            "color": stroke.colour,
            "alpha": stroke.opacity,
        }
    options: dict[str, Any] = {"color": stroke.colour, "lw": stroke.width, "ls": style.DASHES[stroke.dash]}
    return options | {"alpha": stroke.opacity}


def draw_outline(axes: Axes, rover: Outline) -> None:
    """Draw a rover: bodies, then wheels."""
    for polygons, colour, edge in ((rover.bodies, style.BODY, "#8d99a6"), (rover.wheels, style.WHEEL, style.WHEEL)):
        for polygon in polygons:
            axes.fill(*polygon.T, fc=colour, ec=edge, lw=0.6, zorder=1.2)


def draw_arrows(axes: Axes, arrows: Arrows) -> None:
    """Draw heads of arrows; with equal axes an angle in the data is one in the picture."""
    for x, y, heading in zip(arrows.x, arrows.y, arrows.heading, strict=True):
        head = (3, 0, float(np.degrees(heading)) - 90.0)
        axes.plot(
            [x], [y], ls="none", marker=head, ms=8.0, mfc=arrows.stroke.colour, mec=style.PAPER, mew=0.7, zorder=4
        )


def _legends(canvas: Canvas, figure: Figure, places: Sequence[Axes]) -> None:
    """Put each legend between title and axes, in as few rows as fit; titles side by side stay level."""
    rows = [legend(canvas, axes, panel, _room(axes)) for axes, panel in zip(places, figure.panels, strict=True)]
    tops = [_cell(axes).rowspan.start for axes in places]
    for axes, top in zip(places, tops, strict=True):
        level = max(n for n, other in zip(rows, tops, strict=True) if other == top)
        axes.set_title(axes.get_title(loc="left"), pad=7.0 + 14.0 * level)


def _cell(axes: Axes) -> Any:
    return axes.get_subplotspec()


def _room(axes: Axes) -> float:
    """Width that a legend may have, in points."""
    return (WIDTH / 2 * len(_cell(axes).colspan) - 0.8) * 72.0


def legend(canvas: Canvas, axes: Axes, panel: Panel, width: float) -> int:
    """Draw a panel's legend above its axes, at most `width` points wide, and return its number of rows."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], **line_style(entry.stroke), label=entry.name) for entry in panel.legend]
    handles += [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    for columns in range(len(handles), 0, -1):
        drawn = axes.legend(
            handles=handles, ncols=columns, loc="lower left", bbox_to_anchor=(0.0, 1.0),
            columnspacing=1.4, handletextpad=0.6, labelspacing=0.25,
        )  # fmt: skip
        if drawn.get_window_extent().width * 72.0 / canvas.dpi <= width:
            return -(-len(handles) // columns)
    return len(handles)
