"""Manoeuvres as data: a frozen sequence of segments, all numbers in SI units.

Conventions (REP-103): x forward, y left. Curvatures, angles and yaw rates are positive to the left
(counterclockwise); a path's curvature is that of the rover's own x axis, so an arc with a positive angle has its
centre on the rover's left whether it is driven forward or in reverse. Speeds are negative in reverse, lengths and
radii never. Every manoeuvre begins at rest.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

from artibot_sim.errors import ArtibotError
from artibot_sim.model.robot.quantity import Quantity, positive, quantity

MAX_SPEED = 20.0
"""Largest speed that a manoeuvre may ask for, m/s: beyond it a unit was mistaken."""


def _optional(unit: str, low: float, high: float, doc: str, *, low_open: bool = False) -> Any:
    """A keyword that may be left out."""
    metadata = {"quantity": Quantity(unit, low, high, doc, low_open)}
    return field(default=None, kw_only=True, metadata=metadata)


def _odd(unit: str, bound: float, doc: str, default: float | None = None) -> Any:
    """A quantity that changes its sign in the mirrored manoeuvre."""
    metadata = {"quantity": Quantity(unit, -bound, bound, doc), "odd": True}
    return field(metadata=metadata) if default is None else field(default=default, metadata=metadata)


def _speed(doc: str) -> Any:
    return _optional("m/s", -MAX_SPEED, MAX_SPEED, doc)


def _a_max() -> Any:
    return _optional("m/s^2", 0.0, 100.0, "largest acceleration of the cubic ramps", low_open=True)


@dataclass(frozen=True)
class Segment:
    """A part of a manoeuvre; building one checks every number against its bounds (ArtibotError names it)."""

    kind: ClassVar[str]

    def __post_init__(self) -> None:
        for entry in dataclasses.fields(self):
            value = getattr(self, entry.name)
            if "quantity" in entry.metadata and value is not None:
                entry.metadata["quantity"].check(entry.name, value)
        self._check()

    def _check(self) -> None:
        """Relations between the fields; none here."""

    def mirrored(self) -> Segment:
        """This segment with left and right exchanged."""
        odd = [entry.name for entry in dataclasses.fields(self) if entry.metadata.get("odd")]
        return dataclasses.replace(self, **{name: -getattr(self, name) for name in odd})


@dataclass(frozen=True)
class PathSegment(Segment):
    """A path of given shape, driven at the speed reached before it unless it says otherwise.

    Attributes
    ----------
    speed, end_speed : float, optional
        Speed in m/s to change to with a cubic ramp that begins where the path begins, or ends where it ends.
    a_max : float, optional
        Largest acceleration of these ramps, m/s²; without it the manoeuvre's.
    """

    speed: float | None = _speed("speed to change to where the path begins")
    end_speed: float | None = _speed("speed to change to where the path ends")
    a_max: float | None = _a_max()

    def _check(self) -> None:
        if self.speed == 0:
            raise ArtibotError(
                "speed: found 0, expected a speed to drive the path with; to halt at its end give end_speed 0"
            )


@dataclass(frozen=True)
class Ramp(Segment):
    """Change to `speed` by a cubic velocity profile whose largest acceleration is `a_max` (sections 6 and 7)."""

    kind: ClassVar[str] = "ramp"
    speed: float = quantity("m/s", -MAX_SPEED, MAX_SPEED, "speed at the ramp's end")
    curvature: float = _odd("1/m", 100.0, "curvature of the path meanwhile", 0.0)
    a_max: float | None = _a_max()


@dataclass(frozen=True)
class Stop(Segment):
    """A ramp to standstill."""

    kind: ClassVar[str] = "stop"
    curvature: float = _odd("1/m", 100.0, "curvature of the path meanwhile", 0.0)
    a_max: float | None = _a_max()


@dataclass(frozen=True)
class Dwell(Segment):
    """Stand still."""

    kind: ClassVar[str] = "dwell"
    duration: float = positive("s", "time to stand still")


@dataclass(frozen=True)
class Straight(PathSegment):
    """A straight of given length."""

    kind: ClassVar[str] = "straight"
    length: float = positive("m", "length")


@dataclass(frozen=True)
class Arc(PathSegment):
    """A circular arc of length ``radius * |angle|``."""

    kind: ClassVar[str] = "arc"
    radius: float = positive("m", "radius of the front module's path")
    angle: float = _odd("rad", 200 * math.pi, "angle about the centre, positive with the centre on the left")

    def _check(self) -> None:
        super()._check()
        if self.angle == 0:
            raise ArtibotError("angle: found 0, expected an angle to drive; use a straight where there is none")


@dataclass(frozen=True)
class Spiral(PathSegment):
    """A clothoid: curvature changes linearly with arc length."""

    kind: ClassVar[str] = "spiral"
    length: float = positive("m", "length")
    start_curvature: float = _odd("1/m", 100.0, "curvature where it begins")
    end_curvature: float = _odd("1/m", 100.0, "curvature where it ends")


@dataclass(frozen=True)
class Slalom(PathSegment):
    """Sinusoidal curvature, ``curvature * sin(2 pi s / wavelength + phase)``."""

    kind: ClassVar[str] = "slalom"
    curvature: float = _odd("1/m", 100.0, "largest curvature; first to the left if positive")
    wavelength: float = positive("m", "length of a period along the path")
    periods: float = positive("", "number of periods, 0.5 for a half-wave", 1.0)
    phase: float = quantity("rad", -4 * math.pi, 4 * math.pi, "phase of the sine where it begins", 0.0)


@dataclass(frozen=True)
class Eight(PathSegment):
    """A closed figure of eight that ends where and as it began.

    With `smooth` the curvature is one period of a sine, ``sin(2 pi s / L) / radius`` with ``L = 2 pi a radius``,
    where ``a`` is the first zero of the Bessel function J_0: this closes the figure. Otherwise it is two circles
    that touch, with the curvature's jumps where they do.
    """

    kind: ClassVar[str] = "eight"
    radius: float = positive("m", "smallest radius")
    left_first: bool = field(default=True, metadata={"flag": "whether the first lobe is the left one"})
    smooth: bool = field(default=False, metadata={"flag": "whether the curvature is continuous"})

    def mirrored(self) -> Eight:
        """The eight that begins with the other lobe."""
        return dataclasses.replace(self, left_first=not self.left_first)


@dataclass(frozen=True)
class TurnInPlace(Segment):
    """Turn about the front module's origin, from rest to rest, with cubic ramps of the yaw rate."""

    kind: ClassVar[str] = "turn_in_place"
    angle: float = _odd("rad", 200 * math.pi, "angle to turn, positive to the left")
    yaw_rate: float = positive("rad/s", "largest yaw rate")
    yaw_a_max: float = positive("rad/s^2", "largest yaw acceleration")

    def _check(self) -> None:
        if self.angle == 0:
            raise ArtibotError("angle: found 0, expected an angle to turn")


@dataclass(frozen=True)
class Chirp(Segment):
    """A sine whose frequency changes linearly in time, faded in and out so that nothing jumps."""

    start_frequency: float = positive("Hz", "frequency at the beginning")
    end_frequency: float = positive("Hz", "frequency at the end")
    duration: float = positive("s", "how long it lasts")
    fade: float = positive("s", "time over which the amplitude grows and fades", 1.0)

    def _check(self) -> None:
        if 2 * self.fade > self.duration:
            raise ArtibotError(
                f"fade: found {self.fade:g} s, expected at most half the duration, {self.duration / 2:g} s"
            )


@dataclass(frozen=True)
class YawRateChirp(Chirp):
    """A chirp of the yaw rate at the speed reached before it (or standing)."""

    kind: ClassVar[str] = "yaw_rate_chirp"
    amplitude: float = field(
        kw_only=True,
        metadata={
            "quantity": Quantity("rad/s", -20.0, 20.0, "largest yaw rate; first to the left if positive"),
            "odd": True,
        },
    )


@dataclass(frozen=True)
class SpeedChirp(Chirp):
    """A chirp of the speed about the one reached before it, which it does not reverse."""

    kind: ClassVar[str] = "speed_chirp"
    amplitude: float = field(
        kw_only=True,
        metadata={
            "quantity": Quantity("m/s", -MAX_SPEED, MAX_SPEED, "largest change of speed; first faster if positive")
        },
    )
    curvature: float = _odd("1/m", 100.0, "curvature of the path meanwhile", 0.0)
    a_max: float | None = _a_max()


@dataclass(frozen=True)
class Repeat(Segment):
    """A sequence of segments, several times over."""

    kind: ClassVar[str] = "repeat"
    times: int
    segments: tuple[Segment, ...]

    def _check(self) -> None:
        if not 1 <= self.times <= 10_000:
            raise ArtibotError(f"times: found {self.times}, expected a whole number from 1 to 10000")
        if not self.segments:
            raise ArtibotError("segments: found none, expected at least one segment to repeat")

    def mirrored(self) -> Repeat:
        """The repetition of the mirrored segments."""
        return Repeat(self.times, tuple(segment.mirrored() for segment in self.segments))


SEGMENTS: dict[str, type[Segment]] = {
    cls.kind: cls
    for cls in (Ramp, Stop, Dwell, Straight, Arc, Spiral, Slalom, Eight, TurnInPlace, YawRateChirp, SpeedChirp, Repeat)
}
"""Every kind of segment by the name it has in a file."""


@dataclass(frozen=True)
class Manoeuvre:
    """A named sequence of segments, from rest.

    Attributes
    ----------
    a_max : float, optional
        Largest acceleration of all ramps that do not state their own, m/s².
    blend : float
        Length in m over which each jump of the curvature that is driven at speed is blended linearly (a clothoid
        centred on the jump, which keeps the length, and between arcs and straights the heading as well). With 0, as
        in the paper, the curvature jumps.
    """

    name: str
    segments: tuple[Segment, ...]
    a_max: float | None = _optional("m/s^2", 0.0, 100.0, "largest acceleration of the cubic ramps", low_open=True)
    blend: float = field(default=0.0, kw_only=True, metadata={"quantity": Quantity("m", 0.0, 1e3, "curvature blend")})
    description: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "segments", tuple(self.segments))
        if not self.segments:
            raise ArtibotError("segments: found none, expected at least one segment")
        for entry in dataclasses.fields(self):
            value = getattr(self, entry.name)
            if "quantity" in entry.metadata and value is not None:
                entry.metadata["quantity"].check(entry.name, value)

    def mirrored(self) -> Manoeuvre:
        """This manoeuvre with left and right exchanged."""
        return dataclasses.replace(
            self, name=f"{self.name}_mirrored", segments=tuple(segment.mirrored() for segment in self.segments)
        )
