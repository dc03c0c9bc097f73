"""Windows of a recording side by side: a typical, a bad and the worst prediction, each from its own start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from artibot_sim.report.panels import Floats, Line, Panel
from artibot_sim.report.style import Stroke

RANKS = (("typical", 0.5), ("bad", 0.9), ("worst", 1.0))
"""What a window is called, and the share of windows that err by no more than it, of those in which the rover moves."""
_STANDS = 0.1
"""Way in a window, of the longest one's, below which the rover hardly moves and a picture shows the sensor's noise."""


@dataclass(frozen=True, eq=False)
class Path:
    """The path in one window by one source.

    Attributes
    ----------
    name : str
        ``measured``, or which model predicts it.
    points : (n, 2) array
        x, y in m.
    stroke : Stroke
    """

    name: str
    points: Floats
    stroke: Stroke


@dataclass(frozen=True, eq=False)
class WindowErrors:
    """One window.

    Attributes
    ----------
    t : float
        When it begins, s since the recording's start.
    error : float
        Of the position at its end, m.
    paths : sequence of Path
        The measured one first.
    """

    t: float
    error: float
    paths: Sequence[Path]


def side_by_side(key: str, drives: Sequence[WindowErrors]) -> list[Panel]:
    """One panel each of a typical, a bad and the worst window; no window twice.

    Every window is drawn from where it begins, its first direction along x, so that windows without a map in common
    can be compared. Those in which the rover hardly moves are left out.

    Parameters
    ----------
    key : str
        Begins the panels' keys.
    drives : sequence of WindowErrors
    """
    ways = {id(drive): _reach(drive.paths[0].points) for drive in drives if np.isfinite(drive.error)}
    least = _STANDS * max(ways.values(), default=0.0)
    known = sorted((drive for drive in drives if ways.get(id(drive), -1.0) >= least), key=lambda drive: drive.error)
    last = len(known) - 1
    found = [
        (min(round(share * last), last - below), name) for (name, share), below in zip(RANKS, (2, 1, 0), strict=True)
    ]
    return [_panel(f"{key}_{name}", share_of(name), known[i]) for i, name in found if i >= 0]


def _reach(points: Floats) -> float:
    """m from where a path (n, 2) begins to its farthest point."""
    known = points[np.isfinite(points).all(axis=1)]
    return float(np.hypot(*(known - known[0]).T).max()) if len(known) else 0.0


def share_of(name: str) -> str:
    """Which window a rank is, in words."""
    share = dict(RANKS)[name]
    return "the worst" if share == 1.0 else f"{name} (where it moves {100 * share:.0f} % err by no more)"


def _panel(key: str, said: str, drive: WindowErrors) -> Panel:
    start, turn = _frame(drive.paths[0].points)
    lines = []
    for path in drive.paths:
        x, y = ((path.points - start) @ turn).T
        lines.append(Line(path.name, path.name, None, x, y, path.stroke))
    size = f"{100 * drive.error:.1f} cm" if drive.error < 1.0 else f"{drive.error:.2f} m"
    title = f"{said[:1].upper()}{said[1:]}: from {drive.t:.1f} s on, {size} off at the end"
    return Panel(key, title, ("ahead", "m"), ("to the left", "m"), tuple(lines), starts=np.zeros((1, 2)), equal=True)


def _frame(points: Floats) -> tuple[Floats, Floats]:
    """Where a path (n, 2) begins, and the matrix (2, 2) that turns its first tenth along x."""
    known = points[np.isfinite(points).all(axis=1)]
    if len(known) < 2:
        return np.zeros(2), np.eye(2)
    way = np.hypot(*(known - known[0]).T)
    far = np.flatnonzero(way >= max(0.1 * float(way.max()), 1e-6))
    if not len(far):
        return known[0], np.eye(2)
    ahead = (known[far[0]] - known[0]) / way[far[0]]
    return known[0], np.array([[ahead[0], -ahead[1]], [ahead[1], ahead[0]]])
