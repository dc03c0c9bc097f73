"""From a manoeuvre's segments to legs: shapes of paths and the paces at which they are driven."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from artibot_sim.errors import ArtibotError
from artibot_sim.planning import manoeuvre as m
from artibot_sim.planning.pace import Pace, ramp, rest_to_rest
from artibot_sim.planning.shapes import Clothoid, Shape, Sine, SpeedWave, Spot, Wave, YawWave

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
                spot = Spot(abs(segment.angle), math.copysign(1.0, segment.angle))
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
