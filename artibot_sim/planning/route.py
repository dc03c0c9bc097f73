"""A manoeuvre as a motion of the front module in the plane: legs, their paces, pose and twist at any time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.planning import manoeuvre as m
from artibot_sim.planning.manoeuvre import Manoeuvre
from artibot_sim.planning.paths import Array, Clothoid, PathShape, Shape, Sine, SpeedWave, SpotTurn, Wave, YawWave

# ----------------------------------------------------------------------
# Progress as a function of time: constant rates and the paper's cubic ramps.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Pace:
    """A rate of progress that changes from `start` to `end` over `duration` (s) by ``3 u² - 2 u³``.

    Its largest acceleration, 1.5 |end - start| / duration, is reached half way; with equal ends it is a constant.
    Rates are in the progress's unit per second and never negative: progress does not go back.
    """

    start: float
    end: float
    duration: float

    @property
    def length(self) -> float:
        """Progress over the whole duration."""
        return 0.5 * (self.start + self.end) * self.duration


def ramp(start: float, end: float, a_max: float) -> Pace:
    """The cubic ramp from rate `start` to `end` whose largest acceleration is `a_max`."""
    return Pace(start, end, 1.5 * abs(end - start) / a_max)


def rest_to_rest(length: float, peak: float, a_max: float) -> list[Pace]:
    """Paces from rest to rest over `length`, with `peak` the largest rate where there is room for it."""
    peak = min(peak, math.sqrt(length * a_max / 1.5))
    up, down = ramp(0.0, peak, a_max), ramp(peak, 0.0, a_max)
    cruise = (length - up.length - down.length) / peak
    return [up, Pace(peak, peak, cruise), down] if cruise > 1e-9 else [up, down]


def sample(paces: Sequence[Pace], index: NDArray[np.intp], local: Array) -> tuple[Array, Array]:
    """Progress since its start and rate of ``paces[index]`` at the times `local` after its start, all (n,)."""
    start, end, duration = np.array([(pace.start, pace.end, pace.duration) for pace in paces])[index].T
    u = local / duration
    progress = start * local + (end - start) * duration * (1.0 - 0.5 * u) * u**3
    return progress, start + (end - start) * (3.0 - 2.0 * u) * u * u


# ----------------------------------------------------------------------
# From a manoeuvre's segments to legs: shapes of paths and the paces at which they are driven.
# ----------------------------------------------------------------------


J0_ZERO = 2.404825557695773
"""First zero of the Bessel function J_0: the amplitude of heading that closes a sine-generated eight."""

MAX_LEGS = 20_000
"""Most legs of a manoeuvre, repetitions included."""


@dataclass(frozen=True)
class Leg:
    """A stretch of the manoeuvre: shapes one after the other and, over the same progress, paces.

    Attributes
    ----------
    label : str
        Where in the manoeuvre it stands, ``segments[2].arc``.
    entry_speed : float
        Signed speed with which it begins, m/s.
    """

    label: str
    shapes: tuple[Shape, ...]
    paces: tuple[Pace, ...]
    entry_speed: float


def legs(manoeuvre: m.Manoeuvre) -> list[Leg]:
    """The legs of `manoeuvre` from rest; ArtibotError names a segment that cannot be driven after those before."""
    builder = _Builder(manoeuvre.a_max)
    builder.add_all(manoeuvre.segments, "segments")
    return builder.legs


class _Builder:
    """Walks along the segments, knowing the speed that has been reached."""

    def __init__(self, a_max: float | None) -> None:
        self.a_max = a_max
        self.speed = 0.0
        self.legs: list[Leg] = []
        self.label = ""

    def add_all(self, segments: Sequence[m.Segment], path: str) -> None:
        for i, segment in enumerate(segments):
            label = f"{path}[{i}].{segment.kind}"
            if isinstance(segment, m.Repeat):
                for _ in range(segment.times):
                    self.add_all(segment.segments, f"{label}.segments")
                continue
            self.label = label
            self.add(segment)

    def add(self, segment: m.Segment) -> None:
        match segment:
            case m.Ramp():
                self.ramp(segment.speed, segment.curvature, segment.a_max)
            case m.Stop():
                self.ramp(0.0, segment.curvature, segment.a_max)
            case m.Dwell():
                self.standing("to stand still")
                still = Clothoid(0.0, 1.0, 0.0)
                self.append((still,), [Pace(0.0, 0.0, segment.duration)], 0.0)
            case m.PathSegment():
                self.path(segment)
            case m.TurnInPlace():
                self.standing("to turn in place")
                spot = SpotTurn(abs(segment.angle), math.copysign(1.0, segment.angle))
                self.append((spot,), rest_to_rest(spot.length, segment.yaw_rate, segment.yaw_a_max), 0.0)
            case m.Chirp():
                self.chirp(segment)
            case _:
                raise ArtibotError(f"{self.label}: not a segment that can be planned: {segment!r}")

    def append(self, shapes: Sequence[Shape], paces: Sequence[Pace], exit_speed: float) -> None:
        if len(self.legs) >= MAX_LEGS:
            raise ArtibotError(f"{self.label}: more than {MAX_LEGS} segments to drive; repeat fewer times")
        kept = tuple(pace for pace in paces if pace.duration > 0)
        if kept:
            self.legs.append(Leg(self.label, tuple(shapes), kept, self.speed))
        self.speed = exit_speed

    def standing(self, why: str) -> None:
        if self.speed != 0:
            raise ArtibotError(
                f"{self.label}: the rover runs at {self.speed:g} m/s, expected standstill {why}; put a stop before"
            )

    def change(self, start: float, end: float, a_max: float | None) -> Pace:
        """A ramp from `start` to `end` (m/s, same direction)."""
        if start * end < 0:
            raise ArtibotError(
                f"{self.label}: the speed changes from {start:g} to {end:g} m/s, expected the same direction; "
                "put a stop between"
            )
        if start == end:
            return Pace(abs(start), abs(end), 0.0)
        limit = self.a_max if a_max is None else a_max
        if limit is None:
            raise ArtibotError(
                f"{self.label}: the speed changes but no a_max is given; add it here or to the manoeuvre"
            )
        return ramp(abs(start), abs(end), limit)

    def ramp(self, speed: float, curvature: float, a_max: float | None) -> None:
        pace = self.change(self.speed, speed, a_max)
        direction = math.copysign(1.0, speed or self.speed)
        self.append((Clothoid(pace.length, direction, curvature),), [pace], speed)

    def path(self, segment: m.PathSegment) -> None:
        cruise = self.speed if segment.speed is None else segment.speed
        end = cruise if segment.end_speed is None else segment.end_speed
        if cruise == 0:
            raise ArtibotError(f"{self.label}: the rover stands; give this segment a speed, or put a ramp before it")
        shapes = _path_shapes(segment, math.copysign(1.0, cruise))
        length = sum(shape.length for shape in shapes)
        first, last = self.change(self.speed, cruise, segment.a_max), self.change(cruise, end, segment.a_max)
        left = length - first.length - last.length
        if left < -1e-9 * length:
            raise ArtibotError(
                f"{self.label}: its changes of speed take {first.length + last.length:g} m, the path has {length:g} m; "
                "make it longer, the speeds closer or a_max larger"
            )
        self.append(shapes, [first, Pace(abs(cruise), abs(cruise), max(left, 0.0) / abs(cruise)), last], end)

    def chirp(self, segment: m.Chirp) -> None:
        parts = (segment.start_frequency, segment.end_frequency, segment.duration, segment.fade)
        pace = Pace(1.0, 1.0, segment.duration)
        if isinstance(segment, m.YawRateChirp):
            wave = Wave(segment.amplitude, *parts)
            self.append((YawWave(segment.duration, self.speed, wave),), [pace], self.speed)
        elif isinstance(segment, m.SpeedChirp):
            wave = Wave(segment.amplitude, *parts)
            self.check_speed_chirp(segment, wave)
            self.append((SpeedWave(segment.duration, self.speed, segment.curvature, wave),), [pace], self.speed)

    def check_speed_chirp(self, segment: m.SpeedChirp, wave: Wave) -> None:
        if abs(segment.amplitude) > abs(self.speed):
            raise ArtibotError(
                f"{self.label}: amplitude {abs(segment.amplitude):g} m/s about a speed of {self.speed:g} m/s would "
                "reverse the rover; give a smaller amplitude or a faster ramp before"
            )
        limit = self.a_max if segment.a_max is None else segment.a_max
        peak = wave.peak_slope()
        if limit is not None and peak > limit:
            raise ArtibotError(
                f"{self.label}: it accelerates at up to {peak:.4g} m/s^2, a_max is {limit:g}; give a smaller "
                "amplitude, lower frequencies or a larger a_max"
            )


def _path_shapes(segment: m.PathSegment, direction: float) -> tuple[Shape, ...]:
    match segment:
        case m.Straight():
            return (Clothoid(segment.length, direction, 0.0),)
        case m.Arc():
            curvature = math.copysign(1.0 / segment.radius, segment.angle)
            return (Clothoid(segment.radius * abs(segment.angle), direction, curvature),)
        case m.Spiral():
            slope = (segment.end_curvature - segment.start_curvature) / segment.length
            return (Clothoid(segment.length, direction, segment.start_curvature, slope),)
        case m.Slalom():
            length, wavenumber = segment.periods * segment.wavelength, 2 * math.pi / segment.wavelength
            return (Sine(length, direction, segment.curvature, wavenumber, segment.phase),)
        case m.Eight():
            return _eight(segment, direction)
    raise ArtibotError(f"{segment.kind}: not a path that can be planned: {segment!r}")


def _eight(segment: m.Eight, direction: float) -> tuple[Shape, ...]:
    curvature = (1.0 if segment.left_first else -1.0) / segment.radius
    if segment.smooth:
        length = 2 * math.pi * J0_ZERO * segment.radius
        return (Sine(length, direction, curvature, 2 * math.pi / length),)
    circle = 2 * math.pi * segment.radius
    return Clothoid(circle, direction, curvature), Clothoid(circle, direction, -curvature)


# ----------------------------------------------------------------------
# A manoeuvre as a motion of the front module in the plane: pose and twist at any time.
#
# Legs (shapes and paces) are put one after the other; consecutive paths that are driven without a halt form a
# block, within which a pace may run over several shapes. At an instant where the curvature jumps the motion has the
# value after it.
# ----------------------------------------------------------------------


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
class PlannedMotion:
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

    def at(self, t: Array) -> PlannedMotion:
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
        return PlannedMotion(t, rows[:, :3], rows[:, 5:], rows[:, 3], rows[:, 4])

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
