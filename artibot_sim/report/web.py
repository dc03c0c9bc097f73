"""Figure data for plotly, as the plain mappings that plotly.js takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from artibot_sim.report import style
from artibot_sim.report.panels import Arrows, Floats, LegendEntry, Line, Outline, Panel, constant_range, extent

MOST_POINTS = 3_000
"""Longer lines are thinned: a browser would crawl, and no screen shows more."""
_FINE = 1e-5
"""Share of a line's span that its numbers are rounded to: zoomed in a hundred times that is a pixel."""
_PX = 1.25
"""Pixels on a page for a point in a picture."""


def chart(panel: Panel, time_span: tuple[float, float]) -> dict[str, Any]:
    """Return a panel as a plotly figure: ``{"data": …, "layout": …}``, JSON-ready (NaN is None).

    Parameters
    ----------
    panel : Panel
    time_span : (first, last)
        Of a time axis, s.
    """
    data = [_polygons(panel.outlines, *colours) for colours in _ROVER] if panel.outlines else []
    data += [_line(panel, line) for line in panel.lines]
    data += [_arrows(arrows) for arrows in panel.arrows]
    if len(panel.starts):
        data.append(_starts(panel.starts))
    data += [_entry(entry) for entry in panel.legend]
    data += [_level_entry(level.name, level.stroke) for level in panel.levels if level.name]
    return {"data": data, "layout": _layout(panel, time_span)}


def numbers(values: Floats, digits: int = 7) -> list[float | None]:
    """Return values with as many digits as a screen needs, None for NaN."""
    return [None if math.isnan(value) else float(f"{value:.{digits}g}") for value in values.tolist()]


def _rounded(values: Floats) -> list[float | None]:
    """Return values with as many decimals as their span asks for, None for NaN."""
    first, last = extent([values])
    if not last > first:
        return numbers(values)
    decimals = math.ceil(-math.log10(_FINE * (last - first)))
    return [None if math.isnan(value) else round(value, decimals) for value in values.tolist()]


def is_thinned(panel: Panel) -> bool:
    """Whether a page draws some line of a panel with fewer points than it has."""
    return any(len(line.x) > MOST_POINTS for line in panel.lines)


def thinned(x: Floats, y: Floats, most: int = MOST_POINTS) -> tuple[Floats, Floats]:
    """Return a curve (n,) with at most about `most` points that looks the same.

    Of each stretch of samples the least and the greatest y are kept, in their order, and every gap (NaN).
    """
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)[:-1]
    low = np.minimum.reduceat(np.where(np.isnan(y), np.inf, y), edges)
    high = np.maximum.reduceat(np.where(np.isnan(y), -np.inf, y), edges)
    stretch = np.searchsorted(edges, np.arange(len(x)), side="right") - 1
    keep = np.isnan(y)
    for extreme in (low, high):
        hits = np.flatnonzero(y == extreme[stretch])
        _, first = np.unique(stretch[hits], return_index=True)
        keep[hits[first]] = True
    keep[[0, -1]] = True
    return x[keep], y[keep]


def _spaced(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return every few points of a curve on a map (n,), its gaps (NaN) and its end, `MOST_POINTS` or so."""
    if len(x) <= MOST_POINTS:
        return x, y
    keep = np.isnan(x)
    keep[:: -(-len(x) // MOST_POINTS)] = keep[-1] = True
    return x[keep], y[keep]


def _line(panel: Panel, line: Line) -> dict[str, Any]:
    stroke = _stroke(line.stroke)
    if "line" in stroke:
        stroke["line"]["simplify"] = False  # plotly's simplification bends lines visibly
    x, y = (_spaced if panel.equal else thinned)(line.x, line.y)
    return {
        "type": "scatter", "name": line.name, "x": _rounded(x), "y": _rounded(y), "connectgaps": False,
        **stroke, "opacity": line.stroke.opacity, "legendgroup": _group(line.kind, line.side),
        "showlegend": False, "meta": {"bag": line.bag, "kind": line.kind},
        "hovertemplate": f"(%{{x:.3f}}, %{{y:.3f}}) {panel.y[1]}" if panel.equal else f"%{{y:.4g}} {panel.y[1]}",
    }  # fmt: skip


def _stroke(stroke: style.Stroke) -> dict[str, Any]:
    if stroke.dash == "points":
        return {"mode": "markers", "marker": {"color": stroke.colour, "size": stroke.width * 1.3}}
    line = {"color": stroke.colour, "width": stroke.width * _PX, "dash": style.WEB_DASHES[stroke.dash]}
    return {"mode": "lines", "line": line}


def _group(kind: str, side: str) -> str:
    return f"{kind} {side}".strip() if kind == "measured" else kind


def _entry(entry: LegendEntry) -> dict[str, Any]:
    """Return an empty trace that stands in the legend for all lines of its group."""
    group = _group(entry.kind, entry.side)
    return {"type": "scatter", "x": [None], "y": [None], "name": entry.name, "legendgroup": group,
            "showlegend": True, "hoverinfo": "skip", **_stroke(entry.stroke)}  # fmt: skip


def _level_entry(name: str, stroke: style.Stroke) -> dict[str, Any]:
    return {"type": "scatter", "x": [None], "y": [None], "name": name, "showlegend": True, "hoverinfo": "skip",
            **_stroke(stroke)}  # fmt: skip


_ROVER = (("bodies", style.BODY, "#8d99a6"), ("wheels", style.WHEEL, style.WHEEL))
"""Part of an outline, its fill and its edge, in drawing order."""


def _polygons(outlines: Sequence[Outline], part: str, fill: str, edge: str) -> dict[str, Any]:
    """Return one trace of all bodies or all wheels; NaN separates the polygons."""
    gap = np.full((1, 2), np.nan)
    corners = np.concatenate(
        [piece for rover in outlines for polygon in getattr(rover, part) for piece in (polygon, gap)]
    )
    return {"type": "scatter", "mode": "lines", "name": f"rover, {part}", "x": numbers(corners[:-1, 0]),
            "y": numbers(corners[:-1, 1]), "fill": "toself", "fillcolor": fill, "line": {"color": edge, "width": 0.8},
            "hoverinfo": "skip", "showlegend": False}  # fmt: skip


def _arrows(arrows: Arrows) -> dict[str, Any]:
    marker = {"symbol": "triangle-up", "size": 11, "angle": numbers(90.0 - np.degrees(arrows.heading)),
              "color": arrows.stroke.colour, "line": {"color": style.PAPER, "width": 1}}  # fmt: skip
    return {"type": "scatter", "mode": "markers", "name": "direction", "x": numbers(arrows.x), "y": numbers(arrows.y),
            "marker": marker, "hoverinfo": "skip", "showlegend": False}  # fmt: skip


def _starts(points: Floats) -> dict[str, Any]:
    marker = {"symbol": "circle", "size": 10, "color": style.PAPER, "line": {"color": style.INK, "width": 2}}
    return {"type": "scatter", "mode": "markers", "name": "start", "x": numbers(points[:, 0]),
            "y": numbers(points[:, 1]), "marker": marker, "showlegend": True, "legendrank": 2000,
            "hovertemplate": "start (%{x:.2f}, %{y:.2f}) m<extra></extra>"}  # fmt: skip


def _layout(panel: Panel, time_span: tuple[float, float]) -> dict[str, Any]:
    axis = {"gridcolor": style.GRID, "zeroline": False, "linecolor": "#9aa5b1", "automargin": True,
            "tickfont": {"color": style.MUTED}}  # fmt: skip
    x = axis | {
        "title": {"text": panel.x_label, "standoff": 8, "font": {"size": 13}},
        "showline": True,
        "ticks": "outside",
        "tickcolor": "#9aa5b1",
    }
    y = axis | {"title": {"text": panel.y_label, "standoff": 6, "font": {"size": 13}}}
    if panel.equal:
        shown = [np.column_stack([line.x, line.y]) for line in panel.lines]
        shown += [polygon for rover in panel.outlines for polygon in (*rover.bodies, *rover.wheels)]
        corners = np.concatenate(shown)
        x |= {"range": _span([corners[:, 0]], 0.05)}
        y |= {"range": _span([corners[:, 1]], 0.05), "scaleanchor": "x", "scaleratio": 1, "showline": True}
    else:
        x |= {"range": _span([np.array(time_span)] if panel.timed else [line.x for line in panel.lines])}
        if (constant := constant_range(*extent([line.y for line in panel.lines]))) is not None:
            y |= {"range": list(constant)}
    if panel.names:
        places = list(range(1, len(panel.names) + 1))
        y |= {"range": [places[-1] + 0.5, 0.5], "tickvals": places, "ticktext": list(panel.names)}
    return {
        "font": {"family": style.WEB_FONTS, "size": 13, "color": style.INK}, "paper_bgcolor": style.PAPER,
        "plot_bgcolor": style.PAPER, "margin": {"l": 56, "r": 12, "t": 8, "b": 44}, "autosize": True,
        "hovermode": "closest" if panel.equal or panel.names else "x unified", "xaxis": x, "yaxis": y,
        "legend": {"orientation": "h", "x": 0, "xanchor": "left", "y": 1.01, "yanchor": "bottom",
                   "groupclick": "togglegroup", "tracegroupgap": 0},
        "shapes": [
            {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": level.value, "y1": level.value, "layer": "below",
             "line": {"color": level.stroke.colour, "width": level.stroke.width, "dash": "dot"}}
            for level in panel.levels
        ],
    }  # fmt: skip


def _span(columns: Sequence[Floats], margin: float = 0.0) -> list[float]:
    """Return the range of an axis, with a margin as a fraction of what is shown."""
    first, last = extent(columns)
    if (constant := constant_range(first, last)) is not None:
        return list(constant)
    room = margin * (last - first) if last > first else 0.5
    return [first - room, last + room]
