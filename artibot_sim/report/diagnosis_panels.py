"""What a diagnosis draws: paths, errors over time and over what the rover did, as panels free of any library."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from artibot_sim.diagnose.diagnosis import Diagnosis, Look
from artibot_sim.diagnose.samples import Samples, gather, sizes
from artibot_sim.diagnose.words import channel_words, excess, is_wrong
from artibot_sim.experiment.columns import SEGMENT_GAP
from artibot_sim.identify.printing import spaced
from artibot_sim.report import style
from artibot_sim.report.panels import Floats, Level, Line, Panel
from artibot_sim.report.style import Stroke

MEASURED = Stroke("#aab6c2", 5.0)
BEFORE = Stroke(style.ODOMETRIC, 1.6, "dash")
AFTER = Stroke(style.TRUE, 1.6)
NOISE = Stroke(style.MUTED, 1.2, "dot")
NAMES = ("measured", "paper's model", "extended model")
_BREAK = np.full((1, 3), np.nan)
_BIN = 0.2
"""s over which errors are averaged in pictures over time."""
_BINS = 9
_FEW = 8
"""Samples that a bin must have to be drawn."""
_TURN = 2.0 * np.pi

COVARIATES = {
    "speed": ("speed", "m/s"),
    "yaw_rate": ("yaw rate", "rad/s"),
    "heading": ("heading in map", "rad"),
    "articulation_yaw": ("articulation angle", "rad"),
    "t": ("time", "s"),
    "load": ("motor torques in all", "N·m"),
}
"""What errors are drawn over: column → (quantity, unit)."""


def path(look: Look, title: str, free: bool = False) -> Panel:
    """The measured path, and what both models predict of it: window by window, or in one run.

    Parameters
    ----------
    look : Look
    title : str
    free : bool
        The runs from the start instead of the windows.
    """
    before, after = (look.free_before, look.free_after) if free else (look.before, look.after)
    lines = [_track(NAMES[0], _unbroken(look.path), MEASURED)]
    lines += [_track(name, parts, stroke) for name, parts, stroke in _models(before, after) if parts]
    start = look.path[:1, 1:] if len(look.path) else np.empty((0, 2))
    key = f"{look.name}_{'free' if free else 'path'}"
    return Panel(key, title, ("x", "m"), ("y", "m"), tuple(lines), starts=start, equal=True)


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


def over_time(found: Diagnosis, look: Look, channel: str) -> Panel | None:
    """Sizes of a channel's errors in one recording over time, against the noise; None where it was not measured."""
    return over_time_of(look, channel, found.baseline[channel].unit if channel in found.baseline else "")


def over_time_of(look: Look, channel: str, unit: str) -> Panel | None:
    """The same, of a recording alone."""
    samples = gather([look], channel)
    if samples is None:
        return None
    lines = []
    for name, errors, stroke in ((NAMES[1], samples.before, BEFORE), (NAMES[2], samples.after, AFTER)):
        t, size = _averaged(samples.t, sizes(errors))
        if np.isfinite(size).any():
            lines.append(Line(name, name, None, t, size, stroke))
    title = f"{look.name}: error of the {channel_words(channel)}"
    levels = (Level("noise", samples.level, NOISE),)
    return Panel(f"{look.name}_{channel}", title, ("time", "s"), ("error", spaced(unit)), tuple(lines), levels)


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
    samples = gather(found.looks, channel)
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
    return sorted(names, key=lambda name: -excess(found, name))


def telling_look(found: Diagnosis, channel: str) -> Look | None:
    """The recording that shows most: of the held-out ones, else of all, the one with the largest error."""
    held = [look for look in found.looks if look.held_out]
    looks = held or list(found.looks)
    return max(looks, key=lambda look: _error(look, channel), default=None)


def _error(look: Look, channel: str) -> float:
    samples: Samples | None = gather([look], channel)
    return float(np.sqrt(np.mean(samples.size**2))) if samples is not None and len(samples) else 0.0
