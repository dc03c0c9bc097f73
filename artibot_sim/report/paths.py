"""The path from above: where a rover was to be, believed to be and was, with its outline to scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.columns import SEGMENT_GAP
from artibot_sim.report.panels import Outline

if TYPE_CHECKING:
    from artibot_sim.model import Robot
    from artibot_sim.model.robot.robot import Module

# ----------------------------------------------------------------------
# A rover seen from above, to scale, from its robot file and pose.
# ----------------------------------------------------------------------


Floats = NDArray[np.float64]
WHEEL_WIDTH = 0.45
"""Width of a drawn wheel over its radius: robot files have none."""
_DRAWBAR = 0.06
"""Width of the drawn bar between module and joint over the track."""


def outline(
    robot: Robot, x: float, y: float, yaw: float, articulation_yaw: float | Sequence[float] | None, t: float = 0.0
) -> Outline:
    """Return the polygons of a rover.

    Parameters
    ----------
    robot : Robot
        Its `front`, `back` and `wheel` give the sizes; bodies reach from wheel to wheel.
    x, y : float
        Origin of the front module in `map`, m.
    yaw : float
        Of the front module, rad.
    articulation_yaw : float, sequence of float or None
        gamma_b − gamma_f, rad, and of the joints behind. From where it is unknown (None, NaN) modules are left out.
    t : float
        When, s.

    Returns
    -------
    Outline
        In `map`, m. The joint is at (−l_f, 0) in the front module and at (+l_b, 0) in the back one.
    """
    bodies, wheels = _module(robot.front, robot.wheel.r_w)
    bodies.append(_nose(robot.front, robot.wheel.r_w))
    parts = [_place(bodies, x, y, yaw), _place(wheels, x, y, yaw)]
    bends = () if articulation_yaw is None else np.atleast_1d(articulation_yaw).tolist()
    for hitch, module, bend in zip(robot.hitches, robot.modules[1:], bends, strict=False):
        if np.isnan(bend):
            break
        joint = np.array([x, y]) - hitch.l * _direction(yaw)
        yaw += bend
        x, y = joint - module.l * _direction(yaw)
        bodies, wheels = _module(module, robot.wheel.r_w)
        bar = _DRAWBAR * module.i_y
        bodies.insert(0, _rectangle(0.0, module.l, -bar / 2, bar / 2))
        parts[0] = _place(bodies, x, y, yaw) + parts[0]
        parts[1] += _place(wheels, x, y, yaw)
    return Outline(t, tuple(parts[0]), tuple(parts[1]))


def size(robot: Robot) -> float:
    """Return the length of a straight rover over its wheels, m."""
    between = sum(hitch.l + module.l for hitch, module in zip(robot.hitches, robot.modules[1:], strict=True))
    return robot.front.i_x / 2 + between + robot.modules[-1].i_x / 2 + 2 * robot.wheel.r_w


def _module(module: Module, r_w: float) -> tuple[list[Floats], list[Floats]]:
    """Return body and wheels of a module in its own frame."""
    half = WHEEL_WIDTH * r_w / 2
    body = _rectangle(-module.i_x / 2, module.i_x / 2, -module.i_y / 2 + half, module.i_y / 2 - half)
    wheels = [
        _rectangle(end * module.i_x / 2 - r_w, end * module.i_x / 2 + r_w,
                   side * module.i_y / 2 - half, side * module.i_y / 2 + half)
        for side in (-1, 1) for end in (1, -1)
    ]  # fmt: skip
    return [body], wheels


def _nose(module: Module, r_w: float) -> Floats:
    """Return the wedge that shows which end is the front."""
    base, width = module.i_x / 2, 0.28 * module.i_y
    return np.array([[base, -width], [base + 0.8 * r_w, 0.0], [base, width], [base, -width]])


def _rectangle(x_low: float, x_high: float, y_low: float, y_high: float) -> Floats:
    return np.array([[x_low, y_low], [x_high, y_low], [x_high, y_high], [x_low, y_high], [x_low, y_low]])


def _direction(yaw: float) -> Floats:
    return np.array([np.cos(yaw), np.sin(yaw)])


def _place(polygons: list[Floats], x: float, y: float, yaw: float) -> list[Floats]:
    cos, sin = _direction(yaw)
    return [polygon @ np.array([[cos, sin], [-sin, cos]]) + (x, y) for polygon in polygons]


# ----------------------------------------------------------------------
# Where a rover was to be, believed to be and was: the channels of a recording that say so.
# ----------------------------------------------------------------------


KINDS = ("planned", "odometric", "true", "total station")
"""In drawing order."""
SOURCES = {
    "planned": ("planned_odom", "planned_path"),
    "odometric": ("odom",),
    "true": ("ground_truth_odom",),
    "total station": ("total_station",),
}
"""Kind of track → the channels it may come from, the first present one rules."""
TOPICS = {
    "planned": "/planned/odom or /planned/path",
    "odometric": "/odom",
    "true": "/ground_truth/odom",
    "total station": "/total_station/point",
}
_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Track:
    """A path over time.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    channel : Channel
        Whose rows these are.
    t : (n,) array
        s since the recording's start; increasing, except for a path without times.
    x, y : (n,) arrays
        m, finite.
    yaw : (n,) array or None
        rad, continuous within a segment; None where it is not known everywhere.
    piece : (n,) int array
        Rows of equal number belong together; nothing joins the others.
    """

    kind: str
    channel: Channel
    t: Floats
    x: Floats
    y: Floats
    yaw: Floats | None
    piece: NDArray[np.int64]

    @property
    def timed(self) -> bool:
        """Whether the rows say when."""
        return len(self.t) > 1 and bool((np.diff(self.t) > 0).all())


def find_track(experiment: Experiment, kind: str, *, drawn: bool = False) -> Track | None:
    """Return a track of a recording, None where it has none.

    Parameters
    ----------
    experiment : Experiment
    kind : str
        One of `KINDS`.
    drawn : bool
        For a drawing a planned path says more than the planned pose over time, which may be cut; for times it is
        the other way round, unless the pose has gaps that the path with its stamps has not.
    """
    keys = SOURCES[kind][::-1] if drawn else SOURCES[kind]
    found = [track for key in keys if (track := _track(experiment, kind, key)) is not None]
    if len(found) > 1 and not drawn and found[1].timed and _gaps(found[0], experiment) > _gaps(found[1], experiment):
        return found[1]
    return found[0] if found else None


def _track(experiment: Experiment, kind: str, key: str) -> Track | None:
    """Return a channel as a track, None where it is not there or empty."""
    channel = experiment.channels.get(key)
    if channel is None or "x" not in channel or "y" not in channel:
        return None
    x, y = channel["x"], channel["y"]
    rows = np.isfinite(x) & np.isfinite(y)
    if not rows.any():
        return None
    yaw = channel["yaw"][rows] if "yaw" in channel else np.array([np.nan])
    piece = channel["message"][rows].astype(np.int64) if "message" in channel else None
    t = channel.t[rows]
    return Track(
        kind, channel, t, x[rows], y[rows], yaw if np.isfinite(yaw).all() else None,
        pieces(t, experiment.segments) if piece is None else piece,
    )  # fmt: skip


def _gaps(track: Track, experiment: Experiment) -> int:
    """Return in how many places a track has no rows for a while, but the recording has others."""
    return len(np.unique(pieces(track.t, experiment.segments))) - len(np.unique(_segment(track.t, experiment.segments)))


def find_truth(experiment: Experiment) -> Track | None:
    """Return where the rover really was: a reference pose where there is one, else the total station's points."""
    return find_track(experiment, "true") or find_track(experiment, "total station")


def pieces(t: Floats, segments: Sequence[tuple[float, float]]) -> NDArray[np.int64]:
    """Number the stretches of samples at times t (n,) that belong together.

    A new one begins with each segment of the recording, and after a gap in the samples themselves: longer than
    that which separates segments and than five of their usual intervals.
    """
    if not len(t):
        return np.empty(0, np.int64)
    step = np.diff(t)
    longest = max(SEGMENT_GAP, 5.0 * float(np.median(step))) if len(step) else SEGMENT_GAP
    part = _segment(t, segments)
    return np.concatenate([[0], np.cumsum((step > longest) | (np.diff(part) != 0))]).astype(np.int64)


def _segment(t: Floats, segments: Sequence[tuple[float, float]]) -> NDArray[np.int64]:
    """Return the number of the segment of times t (n,)."""
    return np.searchsorted([first for first, _ in segments], t, side="right")


def broken(piece: NDArray[np.int64], *columns: Floats) -> list[Floats]:
    """Return columns (n,) with a row of NaN between pieces, which plotting libraries take as "do not join"."""
    breaks = np.flatnonzero(np.diff(piece)) + 1
    return [np.insert(column, breaks, np.nan) for column in columns]


def motion_window(track: Track) -> tuple[float, float] | None:
    """Return when a planned track first and last moves, s; None if it never does or has no times."""
    if not track.timed:
        return None
    still = np.hypot(np.diff(track.x), np.diff(track.y)) < 1e-9
    if track.yaw is not None:
        still &= np.abs(np.diff(track.yaw)) < 1e-9
    moving = np.flatnonzero(~still)
    return (float(track.t[moving[0]]), float(track.t[moving[-1] + 1])) if len(moving) else None


def whole_turns(t: Floats, yaw: Floats, planned: Track | None) -> float:
    """Return the multiple of 2 pi (rad) that brings a yaw over t (n,) next to the planned one at its beginning.

    Each topic is unwrapped by itself, so two of them may differ by whole turns.
    """
    if planned is None or planned.yaw is None or not planned.timed or not len(yaw):
        return 0.0
    first = float(np.interp(t[0], planned.t, planned.yaw))
    return _TURN * float(np.round((first - yaw[0]) / _TURN))
