"""Panels of the sections' figures: curves with a legend entry each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from artibot_sim.report import style
from artibot_sim.report.panels import Level, Line, Panel

Array = NDArray[np.float64]

PLANNED = style.Stroke(style.MUTED, 1.5, "dash")
ODOMETRIC = style.Stroke(style.ODOMETRIC, 1.5, "dot")
SIMULATED = style.Stroke(style.TRUE, 1.9)
MEASURED = style.Stroke(style.INK, 1.3, "dot")
DRIVEN = style.Stroke(style.POINTS, 1.7)
TIME = ("time", "s")
BY_KAPPA = dict(zip((0.6, 0.8, 1.0), ("#0072b2", "#d55e00", "#44aa99"), strict=True))
"""One hue a kappa."""


def curve(name: str, x: Array, y: Array, stroke: style.Stroke) -> Line:
    """A curve with its own entry in the legend."""
    return Line(name, name, None, np.asarray(x, float), np.asarray(y, float), stroke)


def over_kappa(kappa: float, x: Array, y: Array) -> Line:
    """A curve of one kappa, in its hue."""
    near = min(BY_KAPPA, key=lambda known: abs(known - kappa))
    return curve(f"κ = {kappa:g}", x, y, style.Stroke(BY_KAPPA[near], 1.5))


def level(name: str, value: float, colour: str = style.INK) -> Level:
    """A horizontal line: what the paper prints."""
    return Level(name, value, style.Stroke(colour, 1.2, "dot"))


def panel(
    key: str, title: str, x: tuple[str, str], y: tuple[str, str], lines: Sequence[Line], levels: Sequence[Level] = ()
) -> Panel:  # fmt: skip
    """A chart; positions (x and y in m) have equal axes."""
    return Panel(key, title, x, y, tuple(lines), tuple(levels), equal=x == ("x", "m"))


def without_peaks(lines: Sequence[Line], room: float = 1.6) -> tuple[list[Line], float]:
    """Curves without their short peaks, which would flatten all else, and the largest value that was there.

    What exceeds `room` times the 98 % quantile of the magnitudes is left out.
    """
    sizes = np.concatenate([np.abs(line.y[np.isfinite(line.y)]) for line in lines])
    most = room * float(np.quantile(sizes, 0.98))
    cut = [
        Line(line.name, line.kind, line.bag, line.x, np.where(np.abs(line.y) > most, np.nan, line.y), line.stroke)
        for line in lines
    ]
    return cut, float(sizes.max())
