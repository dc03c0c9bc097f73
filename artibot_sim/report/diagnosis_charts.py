"""A diagnosis' charts that are no curves, as the mappings that plotly.js takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from artibot_sim.diagnose.diagnosis import Diagnosis
from artibot_sim.diagnose.samples import Samples, gather
from artibot_sim.diagnose.words import channel_words, effect_words
from artibot_sim.identify.printing import number, spaced
from artibot_sim.report import style
from artibot_sim.report.diagnosis_panels import NAMES
from artibot_sim.report.web import numbers

_ROWS = 12
"""Effects that the chart of evidence shows."""
LOG10 = float(np.log(10.0))
"""nats of one decade."""
_MOST = 1500
"""Points on a map at most."""
_AXIS: dict[str, Any] = {
    "gridcolor": style.GRID, "zeroline": False, "linecolor": "#9aa5b1", "automargin": True,
    "tickfont": {"color": style.MUTED},
}  # fmt: skip


def _layout(x: dict[str, Any], y: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {
        "font": {"family": style.WEB_FONTS, "size": 13, "color": style.INK}, "paper_bgcolor": style.PAPER,
        "plot_bgcolor": style.PAPER, "margin": {"l": 8, "r": 12, "t": 8, "b": 44}, "autosize": True,
        "xaxis": _AXIS | {"showline": True, "ticks": "outside"} | x, "yaxis": _AXIS | y, "hovermode": "closest",
        "legend": {"orientation": "h", "x": 0, "xanchor": "left", "y": 1.01, "yanchor": "bottom"}, **more,
    }  # fmt: skip


def before_and_after(found: Diagnosis) -> dict[str, Any]:
    """Errors of all channels in units of their noise, before and after, joined; on held-out data where there are."""
    rows = [name for name, base in found.baseline.items() if base.noise > 0]
    names = [channel_words(name) for name in rows]
    before, after = [], []
    for name in rows:
        base, gain = found.baseline[name], found.gain.get(name)
        before.append((gain.before if gain else base.rmse) / base.noise)
        after.append(gain.after / base.noise if gain else float("nan"))
    values = np.array([*before, *after, 1.0])
    values = values[np.isfinite(values) & (values > 0)]
    span = [float(np.log10(values.min())) - 0.1, float(np.log10(values.max())) + 0.15]
    joins = [
        {"type": "line", "x0": a, "x1": b, "y0": name, "y1": name, "line": {"color": "#c3ccd5", "width": 4},
         "layer": "below"}
        for name, a, b in zip(names, before, after, strict=True) if np.isfinite(b)
    ]  # fmt: skip
    noise = {"type": "line", "x0": 1, "x1": 1, "yref": "paper", "y0": 0, "y1": 1, "layer": "below",
             "line": {"color": style.MUTED, "width": 1.5, "dash": "dot"}}  # fmt: skip
    data = [_dots(NAMES[1], before, names, style.ODOMETRIC, "circle-open")]
    if joins:
        data.append(_dots(NAMES[2], after, names, style.TRUE))
    x = {"type": "log", "title": {"text": "error ÷ noise", "font": {"size": 13}},
         "range": span, "dtick": 1 if span[1] - span[0] > 1.2 else "D2"}  # fmt: skip
    y = {"autorange": "reversed", "type": "category", "categoryarray": names, "gridcolor": style.PAPER}
    return {"data": data, "layout": _layout(x, y, shapes=[*joins, noise])}


def _dots(name: str, values: list[float], rows: list[str], colour: str, symbol: str = "circle") -> dict[str, Any]:
    marker = {"color": colour, "size": 11, "symbol": symbol, "line": {"color": colour, "width": 2.5}}
    return {"type": "scatter", "mode": "markers", "name": name, "x": numbers(np.array(values, float), 4), "y": rows,
            "marker": marker, "hovertemplate": "%{y}: %{x:.3g} × noise"}  # fmt: skip


def evidence(found: Diagnosis) -> dict[str, Any]:
    """Evidence of the best effects, as bars: those found, those that tie, the others."""
    named = {cause.effect for cause in found.causes}
    tied = {name for cause in found.causes for name in cause.ties}
    ranking = sorted(found.ranking, key=lambda c: (c.effect not in named, -c.log10_bayes_factor))[:_ROWS]
    ranking = [c for c in ranking if np.isfinite(c.log10_bayes_factor)]
    threshold = found.threshold / LOG10
    least = min([0.0, *(c.log10_bayes_factor for c in ranking)])
    most = max([1.15 * threshold, 1.0, *(c.log10_bayes_factor for c in ranking)])
    data = []
    for role, colour in (("found", style.TRUE), ("ties", style.LEFT), ("not found", "#b9c3cd")):
        mine = [c for c in ranking if _role(c.effect, named, tied) == role]
        if mine:
            data.append({
                "type": "bar", "orientation": "h", "name": role, "y": [effect_words(c.effect) for c in mine],
                "x": numbers(np.array([c.log10_bayes_factor for c in mine]), 5), "marker": {"color": colour},
                "text": [f"{c.log10_bayes_factor:.1f}".replace("-", "−") for c in mine], "textposition": "auto",
                "cliponaxis": False, "hovertemplate": "%{y}: log10 Bayes factor %{x:.1f}<extra></extra>",
            })  # fmt: skip
    shapes, notes = [], []
    if threshold > 0:
        shapes.append({"type": "line", "x0": threshold, "x1": threshold, "yref": "paper", "y0": 0, "y1": 1,
                       "line": {"color": style.INK, "width": 1.5, "dash": "dot"}})  # fmt: skip
        notes.append({"x": threshold, "y": 0, "yref": "paper", "yanchor": "bottom", "text": "needed to be named",
                      "showarrow": False, "xanchor": "left", "font": {"size": 12, "color": style.MUTED}})  # fmt: skip
    x = {"title": {"text": "log₁₀ of the Bayes factor", "font": {"size": 13}},
         "range": [float(least - 0.12 * (most - least) if least < 0 else 0.0), float(1.05 * most)]}  # fmt: skip
    order = [effect_words(c.effect) for c in ranking]
    y = {"autorange": "reversed", "type": "category", "categoryorder": "array", "categoryarray": order,
         "gridcolor": style.PAPER}  # fmt: skip
    return {"data": data, "layout": _layout(x, y, shapes=shapes, annotations=notes, barmode="overlay", bargap=0.25)}


def _role(effect: str, named: set[str], tied: set[str]) -> str:
    return "found" if effect in named else "ties" if effect in tied else "not found"


def error_map(found: Diagnosis, channel: str) -> dict[str, Any] | None:
    """Where on the map a channel's error of the paper's model sits; None where places are not known."""
    samples: Samples | None = gather(found.looks, channel)
    if samples is None or not np.isfinite(samples.at["x"]).any():
        return None
    x, y, size = _thinned(samples)
    unit = spaced(found.baseline[channel].unit) if channel in found.baseline else ""
    top = float(np.nanquantile(size, 0.98)) or 1.0
    order = np.argsort(size)  # the worst on top
    marker = {
        "color": numbers(size[order], 4), "cmin": 0, "cmax": top, "size": 6, "opacity": 0.85,
        "colorscale": [[0, "#dfe5ea"], [0.25, "#f3c9a6"], [1, style.ODOMETRIC]],
        "colorbar": {"thickness": 10, "title": {"text": unit, "side": "right"}, "len": 0.9},
    }  # fmt: skip
    dots = {"type": "scatter", "mode": "markers", "x": numbers(x[order], 5), "y": numbers(y[order], 5),
            "marker": marker, "showlegend": False, "name": "error",
            "hovertemplate": f"(%{{x:.2f}}, %{{y:.2f}}) m: %{{marker.color:.3g}} {unit}<extra></extra>"}  # fmt: skip
    axes = {"title": {"text": "x (m)"}}, {"title": {"text": "y (m)"}, "scaleanchor": "x", "scaleratio": 1}
    return {"data": [dots], "layout": _layout(*axes, margin={"l": 56, "r": 8, "t": 8, "b": 44})}


def _thinned(samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places and sizes (m,), averaged over neighbours in time so that there are not too many."""
    known = np.flatnonzero(np.isfinite(samples.at["x"]) & np.isfinite(samples.at["y"]))
    group = max(1, -(-len(known) // _MOST))
    order = known[np.lexsort((samples.t[known], samples.look[known]))]
    starts = np.arange(0, len(order), group)
    count = np.diff(np.append(starts, len(order)))
    columns = samples.at["x"], samples.at["y"], samples.size**2
    x, y, square = (np.add.reduceat(column[order], starts) / count for column in columns)
    return x, y, np.sqrt(square)


def interval(value: float, ci95: tuple[float, float] | None, neutral: float) -> str:
    """An SVG of a parameter on its way from neutral: interval, value, and where neutral is."""
    if ci95 is None or not np.isfinite([value, neutral, *ci95]).all():
        return ""
    low, high = min(ci95[0], neutral, value), max(ci95[1], neutral, value)
    if high <= low:
        return ""
    a, b, v, n = (6 + 148 * (x - low) / (high - low) for x in (*ci95, value, neutral))
    title = f"{number(value)}, 95 % from {number(ci95[0])} to {number(ci95[1])}; neutral is {number(neutral)}"
    return (
        f'<svg class="ci" viewBox="0 0 160 16" width="160" height="16" role="img"><title>{title}</title>'
        f'<line x1="0" x2="160" y1="8" y2="8" stroke="{style.GRID}"/>'
        f'<line x1="{n:.1f}" x2="{n:.1f}" y1="2" y2="14" stroke="{style.MUTED}" stroke-dasharray="2 2"/>'
        f'<line x1="{a:.1f}" x2="{b:.1f}" y1="8" y2="8" stroke="{style.TRUE}" stroke-width="4"/>'
        f'<circle cx="{v:.1f}" cy="8" r="4.5" fill="{style.TRUE}"/></svg>'
    )
