"""Where a rover was to be, believed to be and was: the channels of a recording that say so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.columns import SEGMENT_GAP

Floats = NDArray[np.float64]
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
