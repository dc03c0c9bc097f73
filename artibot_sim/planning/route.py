"""A manoeuvre as a motion of the front module in the plane: pose and twist at any time.

Legs (shapes and paces) are put one after the other; consecutive paths that are driven without a halt form a block,
within which a pace may run over several shapes. At an instant where the curvature jumps the motion has the value
after it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.planning.legs import Leg, legs
from artibot_sim.planning.manoeuvre import Manoeuvre
from artibot_sim.planning.pace import Pace, sample
from artibot_sim.planning.quadrature import Array
from artibot_sim.planning.shapes import Clothoid, PathShape, Shape

SNAP = 1e-9
"""Within this time (s) and distance (m) before a boundary the motion is that after it, so that rounding of the
time grid does not decide on which side of a jump a sample falls. ROS stamps have the same resolution."""


@dataclass(frozen=True)
class Mark:
    """When a segment is driven: its place in the manoeuvre (``segments[2].arc``), its start and end in s."""

    label: str
    start: float
    end: float


@dataclass(frozen=True)
class Motion:
    """The front module's motion at times `t`.

    Attributes
    ----------
    t : (n,) array, s
    pose : (n, 3) array
        x and y in m, yaw in rad (continuous, not wrapped), of {f} in the frame of the start pose (`map`).
    twist : (n, 2) array
        Forward speed in m/s and yaw rate in rad/s.
    arc : (n,) array, m
        Signed distance driven since the start, the integral of the speed.
    travelled : (n,) array, m
        Length of the path since the start.
    """

    t: Array
    pose: Array
    twist: Array
    arc: Array
    travelled: Array


class Route:
    """The motion that a manoeuvre plans, from rest at `start`.

    Parameters
    ----------
    manoeuvre : Manoeuvre
    start : (x, y, yaw) in m, m, rad

    Raises
    ------
    ArtibotError
        Naming the segment that cannot be driven, and why.
    """

    def __init__(self, manoeuvre: Manoeuvre, start: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        stretch = legs(manoeuvre)
        if not stretch:
            raise ArtibotError("segments: nothing moves; expected at least one segment that takes time")
        self._shapes: list[Shape] = []
        self._paces: list[Pace] = []
        rows: list[tuple[int, int, float]] = []  # per pace: first and last shape of its block, progress at its start
        for block in _blocks(stretch):
            first, base = len(self._shapes), sum(shape.length for shape in self._shapes)
            self._shapes += _blended(block, manoeuvre.blend)
            for leg in block:
                done = base
                for pace in leg.paces:
                    rows.append((first, len(self._shapes) - 1, done))
                    self._paces.append(pace)
                    done += pace.length
                base += sum(shape.length for shape in leg.shapes)
        self._first, self._last = np.array([row[:2] for row in rows]).T
        self._sigma = np.array([row[2] for row in rows])
        self._times = np.concatenate([[0.0], np.cumsum([pace.duration for pace in self._paces])])
        self._edges = np.concatenate([[0.0], np.cumsum([shape.length for shape in self._shapes])])
        self._starts = np.array(list(_starts(self._shapes, start)))
        self.start_yaw = float(start[2])
        self.duration = float(self._times[-1])
        self.path_length = float(self._starts[-1, 4])
        self.marks = _marks(stretch)

    def at(self, t: Array) -> Motion:
        """The motion at times `t` (n,); before 0 it rests at the start, after the end its last twist goes on."""
        inside = np.clip(t, 0.0, self.duration)
        i = np.clip(np.searchsorted(self._times, inside + SNAP, side="right") - 1, 0, len(self._paces) - 1)
        progress, rate = sample(self._paces, i, np.maximum(inside - self._times[i], 0.0))
        sigma = self._sigma[i] + progress
        j = np.searchsorted(self._edges, sigma + SNAP, side="right") - 1
        j = np.clip(j, self._first[i], self._last[i])
        rows = np.empty((len(t), 7))
        for shape in np.unique(j):
            rows[j == shape] = self._within(int(shape), sigma[j == shape], rate[j == shape])
        _coast(rows, t - inside)
        return Motion(t, rows[:, :3], rows[:, 5:], rows[:, 3], rows[:, 4])

    def _within(self, j: int, sigma: Array, rate: Array) -> Array:
        """x, y, yaw, arc, travelled, speed, yaw rate on shape `j`."""
        shape, (x0, y0, yaw0, arc0, travelled0) = self._shapes[j], self._starts[j]
        s = np.clip(sigma - self._edges[j], 0.0, shape.length)
        x, y = shape.position(s)
        c, d, arc = math.cos(yaw0), math.sin(yaw0), shape.arc(s)
        pose = x0 + c * x - d * y, y0 + d * x + c * y, yaw0 + shape.yaw(s)
        return np.stack(
            [*pose, arc0 + arc, travelled0 + np.abs(arc), shape.advance(s) * rate, shape.turn(s) * rate], axis=-1
        )


def _coast(rows: Array, after: Array) -> None:
    """Move `rows` on at their twist for the times beyond the end."""
    late = after > 0
    x, y, yaw, arc, travelled, v, w = rows[late].T
    dt = after[late]
    half = 0.5 * w * dt
    length = v * dt * np.sinc(half / math.pi)
    moved = [x + length * np.cos(yaw + half), y + length * np.sin(yaw + half), yaw + w * dt]
    rows[late, :5] = np.stack([*moved, arc + v * dt, travelled + np.abs(v) * dt], axis=-1)
    rows[after < 0, 5:] = 0.0


def _starts(shapes: Sequence[Shape], start: Sequence[float]) -> Iterator[tuple[float, ...]]:
    """x, y, yaw, arc, travelled where each shape begins, and where the last one ends."""
    x, y, yaw = (float(value) for value in start)
    arc = travelled = 0.0
    yield x, y, yaw, arc, travelled
    for shape in shapes:
        end = np.array([shape.length])
        dx, dy = (float(value[0]) for value in shape.position(end))
        x, y = x + math.cos(yaw) * dx - math.sin(yaw) * dy, y + math.sin(yaw) * dx + math.cos(yaw) * dy
        yaw += float(shape.yaw(end)[0])
        arc += float(shape.arc(end)[0])
        travelled += abs(float(shape.arc(end)[0]))
        yield x, y, yaw, arc, travelled


def _blocks(stretch: Sequence[Leg]) -> list[list[Leg]]:
    """Legs grouped: paths that follow each other without a halt stay together."""

    def is_path(leg: Leg) -> bool:
        return all(isinstance(shape, PathShape) for shape in leg.shapes)

    blocks = [[stretch[0]]]
    for before, leg in pairwise(stretch):
        if is_path(before) and is_path(leg) and leg.entry_speed != 0:
            blocks[-1].append(leg)
        else:
            blocks.append([leg])
    return blocks


def _blended(block: Sequence[Leg], blend: float) -> list[Shape]:
    """The shapes of a block, each jump of curvature replaced by a clothoid of length `blend` centred on it."""
    shapes: list[Shape] = [shape for leg in block for shape in leg.shapes]
    labels = [leg.label for leg in block for _ in leg.shapes]
    paths = [shape for shape in shapes if isinstance(shape, PathShape)]
    if blend == 0 or len(paths) != len(shapes):
        return shapes
    trim = np.zeros((len(paths), 2))
    for k, (a, b) in enumerate(pairwise(paths)):
        if abs(a.curvature(np.array([a.length]))[0] - b.curvature(np.array([0.0]))[0]) > 1e-9:
            trim[k, 1] = trim[k + 1, 0] = 0.5 * blend
    out: list[Shape] = []
    for path, label, (head, tail) in zip(paths, labels, trim, strict=True):
        if head + tail > path.length * (1 + 1e-9):
            raise ArtibotError(
                f"{label}: it is {path.length:g} m long, blending the curvature takes {head + tail:g} m of it; "
                "shorten the blend or lengthen the segment"
            )
        part = path.part(head, max(path.length - tail, head))
        if head > 0:
            before = out[-1]
            assert isinstance(before, PathShape)
            low = float(before.curvature(np.array([before.length]))[0])
            high = float(part.curvature(np.array([0.0]))[0])
            out.append(Clothoid(blend, path.direction, low, (high - low) / blend))
        out.append(part)
    return out


def _marks(stretch: Sequence[Leg]) -> tuple[Mark, ...]:
    marks, t = [], 0.0
    for leg in stretch:
        end = t + sum(pace.duration for pace in leg.paces)
        marks.append(Mark(leg.label, t, end))
        t = end
    return tuple(marks)
