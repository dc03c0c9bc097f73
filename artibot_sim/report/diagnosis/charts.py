"""What a diagnosis draws: paths, errors over time and over what the rover did, evidence, maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from artibot_sim.diagnose.records import DECADE, Comparison, Unexplained
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.validation.residuals import ErrorSamples, gather, sizes
from artibot_sim.diagnose.words import channel_words, effect_words, is_wrong
from artibot_sim.experiment.columns import SEGMENT_GAP
from artibot_sim.identify.result import number, spaced
from artibot_sim.model.effects.force_law import PARAMETERS, place_words, shape, unit_of, variable_words
from artibot_sim.model.reference.effects import plain
from artibot_sim.report import style
from artibot_sim.report.panels import Floats, Level, Line, Panel
from artibot_sim.report.style import Stroke
from artibot_sim.report.web import numbers
from artibot_sim.report.windows import Path, WindowErrors, side_by_side

# ----------------------------------------------------------------------
# What a diagnosis draws: paths, errors over time and over what the rover did, as panels free of any library.
# ----------------------------------------------------------------------


MEASURED = Stroke("#aab6c2", 5.0)
BEFORE = Stroke(style.ODOMETRIC, 1.6, "dash")
AFTER = Stroke(style.TRUE, 1.6)
NOISE = Stroke(style.MUTED, 1.2, "dot")
ASKED = Stroke(style.MUTED, 5.0, "points")
"""Points that recordings ask for where a law acts."""
ASKED_BAR = Stroke(style.MUTED, 1.0)
"""Interval of such a point."""
_SURE = 1.96
NAMES = ("measured", "paper's model", "extended model")
_BREAK = np.full((1, 3), np.nan)
_IN_MM = 0.01
"""m below which errors over time are drawn in millimetres."""
_BIN = 0.2
"""s over which errors are averaged in pictures over time."""
_BINS = 9
_FEW = 8
"""Samples that a bin must have to be drawn."""
_POINTS = 201
"""Of a law's curve."""

COVARIATES = {
    "speed": ("speed", "m/s"),
    "yaw_rate": ("yaw rate", "rad/s"),
    "heading": ("heading in map", "rad"),
    "articulation_yaw": ("articulation angle", "rad"),
    "t": ("time", "s"),
    "load": ("motor torques in all", "N·m"),
}
"""What errors are drawn over: column → (quantity, unit)."""


def path(run: Comparison, title: str, free: bool = False) -> Panel:
    """The measured path, and what both models predict of it: window by window, or in one run.

    Parameters
    ----------
    run : Comparison
    title : str
    free : bool
        The runs from the start instead of the windows.
    """
    before, after = (run.free_before, run.free_after) if free else (run.before, run.after)
    lines = [_track(NAMES[0], _unbroken(run.path), MEASURED)]
    lines += [_track(name, parts, stroke) for name, parts, stroke in _models(before, after) if parts]
    start = run.path[:1, 1:] if len(run.path) else np.empty((0, 2))
    key = f"{run.name}_{'free' if free else 'path'}"
    return Panel(key, title, ("x", "m"), ("y", "m"), tuple(lines), starts=start, equal=True)


def in_map(run: Comparison) -> bool:
    """Whether the recording's places mean something together: its segments share one map."""
    return bool(np.isfinite(run.covariates["x"]).any()) if "x" in run.covariates else True


def windows(run: Comparison) -> list[Panel]:
    """A typical, a bad and the worst window with what both models predict, for a recording without one map."""
    drives = []
    for row, before in enumerate(run.before):
        if not len(before):
            continue
        rows = (run.path[:, 0] >= before[0, 0] - 1e-6) & (run.path[:, 0] <= before[-1, 0] + 1e-6)
        measured = run.path[rows, 1:]
        if len(measured) < 2:
            continue
        end = float(np.hypot(*(before[-1, 1:] - measured[-1])))
        paths = [Path(NAMES[0], measured, MEASURED), Path(NAMES[1], before[:, 1:], BEFORE)]
        paths += [Path(NAMES[2], run.after[row][:, 1:], AFTER)] if row < len(run.after) else []
        drives.append(WindowErrors(float(before[0, 0]), end, paths))
    return side_by_side(f"{run.name}_window", drives)


def _unbroken(path_: Floats) -> tuple[Floats, ...]:
    """A measured path (n, 3) cut where its source was silent, or a new segment begins."""
    step = np.diff(path_[:, 0])
    gap = max(SEGMENT_GAP, 5.0 * float(np.median(step))) if len(step) else SEGMENT_GAP
    return tuple(np.split(path_, np.flatnonzero(step > gap) + 1))


def _models(
    before: Sequence[Floats], after: Sequence[Floats]
) -> tuple[tuple[str, Sequence[Floats], Stroke], tuple[str, Sequence[Floats], Stroke]]:
    return (NAMES[1], before, BEFORE), (NAMES[2], after, AFTER)


def _track(name: str, parts: Sequence[Floats], stroke: Stroke) -> Line:
    """Pieces (m, 3) of t, x, y as one line that does not join them."""
    joined = np.concatenate([row for part in parts for row in (part, _BREAK)]) if parts else _BREAK
    return Line(name, name, None, joined[:, 1], joined[:, 2], stroke)


def over_time(found: Diagnosis, run: Comparison, channel: str) -> Panel | None:
    """Sizes of a channel's errors in one recording over time, against the noise; None where it was not measured."""
    return over_time_of(run, channel, found.baseline[channel].unit if channel in found.baseline else "")


def over_time_of(run: Comparison, channel: str, unit: str) -> Panel | None:
    """Errors of a channel over time in one recording; None where it has no such channel."""
    samples = gather([run], channel)
    if samples is None:
        return None
    drawn = []
    for name, errors, stroke in ((NAMES[1], samples.before, BEFORE), (NAMES[2], samples.after, AFTER)):
        t, size = _averaged(samples.t, sizes(errors))
        if np.isfinite(size).any():
            drawn.append((name, t, size, stroke))
    greatest = max([samples.level, *(float(np.nanmax(size)) for _, _, size, _ in drawn)])
    small = unit == "m" and greatest < _IN_MM
    factor, unit = (1e3, "mm") if small else (1.0, unit)
    lines = [Line(name, name, None, t, factor * size, stroke) for name, t, size, stroke in drawn]
    title = f"{run.name}: error of the {channel_words(channel)}"
    levels = (Level("noise", factor * samples.level, NOISE),)
    return Panel(f"{run.name}_{channel}", title, ("time", "s"), ("error", spaced(unit)), tuple(lines), levels)


def _averaged(t: Floats, size: Floats) -> tuple[Floats, Floats]:
    """Root mean squares of sizes (n,) over bins of time; empty bins between others break the line."""
    known = np.isfinite(size)
    if not known.any():
        return np.empty(0), np.empty(0)
    step = max(_BIN, float(np.median(np.diff(np.unique(t)))) * 1.01) if len(np.unique(t)) > 1 else _BIN
    bins = np.floor((t[known] - t.min()) / step).astype(int)
    count = np.bincount(bins)
    mean = np.full(len(count), np.nan)
    filled = count > 0
    mean[filled] = np.sqrt(np.bincount(bins, size[known] ** 2)[filled] / count[filled])
    return t.min() + step * (np.arange(len(count)) + 0.5), mean


def over_covariates(found: Diagnosis, channel: str) -> Iterator[Panel]:
    """Sizes of a channel's errors in all recordings over speed, yaw rate, heading, joint, time and load."""
    samples = gather(found.comparisons, channel)
    if samples is None:
        return
    unit = spaced(found.baseline[channel].unit) if channel in found.baseline else ""
    for name, quantity in COVARIATES.items():
        x = samples.t if name == "t" else samples.at[name]
        edges = _edges(x, name == "heading")
        if edges is None:
            continue
        lines = []
        for label, errors, stroke in ((NAMES[1], samples.before, BEFORE), (NAMES[2], samples.after, AFTER)):
            middle, size = _binned(x, sizes(errors), edges)
            if np.isfinite(size).any():
                lines.append(Line(label, label, None, middle, size, stroke._replace(width=1.9)))
        levels = (Level("noise", samples.level, NOISE),)
        yield Panel(f"{channel}_over_{name}", f"over {quantity[0]}", quantity, ("RMSE", unit), tuple(lines), levels)


def _edges(x: Floats, whole_turn: bool) -> Floats | None:
    """Edges of bins with about equally many samples (even ones of a turn); None where x does not vary."""
    known = x[np.isfinite(x)]
    if len(known) < 2 * _FEW or np.ptp(known) < 1e-6:
        return None
    if whole_turn:
        return np.linspace(-np.pi, np.pi, _BINS)
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, _BINS + 1)))
    return edges if len(edges) > 2 else None


def _binned(x: Floats, size: Floats, edges: Floats) -> tuple[Floats, Floats]:
    """Means of x and root mean squares of sizes in bins; NaN where there are too few."""
    known = np.isfinite(x) & np.isfinite(size)
    x, size = x[known], size[known]
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bins, minlength=len(edges) - 1)
    some = np.maximum(count, 1)
    middle = np.bincount(bins, x, minlength=len(count)) / some
    mean = np.sqrt(np.bincount(bins, size**2, minlength=len(count)) / some)
    few = count < _FEW
    middle[few] = 0.5 * (edges[:-1] + edges[1:])[few]
    mean[few] = np.nan
    return middle, mean


def wrong_channels(found: Diagnosis) -> list[str]:
    """Channels that are wrong by much more than their noise, the worst first."""
    names = [name for name, base in found.baseline.items() if is_wrong(name, base)]
    return sorted(names, key=lambda name: -found.baseline[name].over_noise)


def clearest(found: Diagnosis, channel: str) -> Comparison | None:
    """The recording that shows most: of the held-out ones, else of all, the one with the largest error."""
    held = [run for run in found.comparisons if run.held_out]
    comparisons = held or list(found.comparisons)
    return max(comparisons, key=lambda run: _error(run, channel), default=None)


def _error(run: Comparison, channel: str) -> float:
    samples: ErrorSamples | None = gather([run], channel)
    return float(np.sqrt(np.mean(samples.size**2))) if samples is not None and len(samples) else 0.0


# ----------------------------------------------------------------------
# A diagnosis' charts that are no curves, as the mappings that plotly.js takes.
# ----------------------------------------------------------------------


_ROWS = 12
"""Effects that the chart of evidence shows."""
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
        before.append(gain.before / base.noise if gain else base.over_noise)
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
    threshold = found.threshold / DECADE
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
    shapes = []
    if threshold > 0:
        shapes.append({"type": "line", "x0": threshold, "x1": threshold, "yref": "paper", "y0": 0, "y1": 1,
                       "line": {"color": style.INK, "width": 1.5, "dash": "dot"}})  # fmt: skip
        data.append({"type": "scatter", "mode": "lines", "x": [None], "y": [None], "name": "needed to be named",
                     "line": {"color": style.INK, "width": 1.5, "dash": "dot"}})  # fmt: skip
    x = {"title": {"text": "log₁₀ of the Bayes factor", "font": {"size": 13}},
         "range": [float(least - 0.22 * (most - least) if least < 0 else 0.0), float(1.05 * most)]}  # fmt: skip
    order = [effect_words(c.effect) for c in ranking]
    y = {"autorange": "reversed", "type": "category", "categoryorder": "array", "categoryarray": order,
         "gridcolor": style.PAPER}  # fmt: skip
    return {"data": data, "layout": _layout(x, y, shapes=shapes, barmode="overlay", bargap=0.25)}


def law_curve(what: Unexplained, name: str) -> Panel | None:
    """A law over its variable, as far as recordings reached; None for a constant force."""
    values = {key: found.value for key, found in what.laws[name].items()}
    variable, where = str(values["variable"]), str(values["where"])
    if variable == "nothing" or name not in what.spans:
        return None
    number = {key: PARAMETERS[key].number(value) for key, value in values.items()}
    law = plain(shape)

    def force(over: Floats) -> Floats:
        each = [law(number["form"], u / number["scale"], number["exponent"], number["phase"]) for u in over]
        return number["size"] * np.array(each)

    over = np.linspace(*what.spans[name], _POINTS)
    words, unit = variable_words(variable)
    lines = [Line("the law", "true", None, over, force(over), AFTER)]
    rows = np.array(what.residuals.get(name, ())).reshape(-1, 3)
    if len(rows):
        asked, sd = force(rows[:, 0]) + rows[:, 1], _SURE * rows[:, 2]
        bars = np.column_stack([asked - sd, asked + sd, np.full(len(rows), np.nan)]).ravel()
        lines = [
            Line("95 % of what recordings ask for", "measured", None, np.repeat(rows[:, 0], 3), bars, ASKED_BAR),
            Line("the law and the residual forces", "measured", None, rows[:, 0], asked, ASKED), *lines,
        ]  # fmt: skip
    return Panel(
        f"law_{name}", place_words(where), (words, spaced(unit)), ("force", spaced(unit_of(where))), tuple(lines)
    )


def _role(effect: str, named: set[str], tied: set[str]) -> str:
    return "found" if effect in named else "ties" if effect in tied else "not found"


def error_map(found: Diagnosis, channel: str) -> dict[str, Any] | None:
    """Where on the map a channel's error of the paper's model sits; None where places are not known."""
    samples: ErrorSamples | None = gather(found.comparisons, channel)
    if samples is None or not np.isfinite(samples.at["x"]).any():
        return None
    x, y, size = _thinned(samples)
    unit = spaced(found.baseline[channel].unit) if channel in found.baseline else ""
    top = float(np.nanquantile(size, 0.98)) or 1.0
    order = np.argsort(size)  # the worst on top
    marker = {
        "color": numbers(size[order], 4), "cmin": 0, "cmax": top, "size": 6, "opacity": 0.85,
        "colorscale": [[0, style.FAINT], [0.25, "#f3c9a6"], [1, style.ODOMETRIC]],
        "colorbar": {"thickness": 10, "title": {"text": unit, "side": "right"}, "len": 0.9},
    }  # fmt: skip
    dots = {"type": "scatter", "mode": "markers", "x": numbers(x[order], 5), "y": numbers(y[order], 5),
            "marker": marker, "showlegend": False, "name": "error",
            "hovertemplate": f"(%{{x:.2f}}, %{{y:.2f}}) m: %{{marker.color:.3g}} {unit}<extra></extra>"}  # fmt: skip
    axes = {"title": {"text": "x (m)"}}, {"title": {"text": "y (m)"}, "scaleanchor": "x", "scaleratio": 1}
    return {"data": [dots], "layout": _layout(*axes, margin={"l": 56, "r": 8, "t": 8, "b": 44})}


def _thinned(samples: ErrorSamples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places and sizes (m,), averaged over neighbours in time so that there are not too many."""
    known = np.flatnonzero(np.isfinite(samples.at["x"]) & np.isfinite(samples.at["y"]))
    group = max(1, -(-len(known) // _MOST))
    order = known[np.lexsort((samples.t[known], samples.comparison[known]))]
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
        f'<line x1="0" x2="160" y1="8" y2="8" style="stroke: var(--grid)"/>'
        f'<line x1="{n:.1f}" x2="{n:.1f}" y1="2" y2="14" style="stroke: var(--muted)" stroke-dasharray="2 2"/>'
        f'<line x1="{a:.1f}" x2="{b:.1f}" y1="8" y2="8" style="stroke: var(--good)" stroke-width="4"/>'
        f'<circle cx="{v:.1f}" cy="8" r="4.5" style="fill: var(--good)"/></svg>'
    )
