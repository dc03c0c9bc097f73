"""A sheet as PNG: rows of charts, drawn by matplotlib in the style of all pictures."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.report import style
from artibot_sim.report.panels import Panel, extent
from artibot_sim.report.png import draw_panel, legend, new_canvas, to_png
from artibot_sim.reproduce.result import HeatMap, Sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

WIDTH = 15.0
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
        canvas = new_canvas(WIDTH, height, layout="constrained")
        engine: Any = canvas.get_layout_engine()
        engine.set(rect=(0.005, 0, 0.99, 1 - head / height), h_pad=0.1, w_pad=0.12)
        columns = max(len(row) for row in sheet.rows)
        grid = canvas.add_gridspec(len(sheet.rows), columns, height_ratios=heights)
        for i, row in enumerate(sheet.rows):
            places = [canvas.add_subplot(grid[i, j]) for j in range(len(row))]
            _draw_row(canvas, places, row, (WIDTH / columns - 0.9) * 72)
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
