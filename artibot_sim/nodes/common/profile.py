"""A planner's velocity profile: checked, sampled, read in a thread beside the loop."""

from __future__ import annotations

import hashlib
import math
import struct
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace as Record
from typing import Any

from artibot_sim.model import MOTORS

# ----------------------------------------------------------------------
# A front motor velocity profile: what `/planned/front_velocity` says, checked once and sampled every step.
# ----------------------------------------------------------------------


FRONT = MOTORS[:2]
"""The front motors, right first: the order of every pair of commands."""

Pair = tuple[float, float]


class Refused(ValueError):
    """A command that is not obeyed; the message is a reason a person can act on."""


@dataclass(frozen=True)
class Profile:
    """Positions and velocities of the two front motors over time, motor-side, right before left.

    Attributes
    ----------
    start_ns : int
        Absolute time of ``times_ns = 0``, in nanoseconds.
    times_ns : tuple of int
        Strictly increasing offsets from the start, the first one not negative.
    velocity, position : tuple of (float, float)
        rad/s and rad at these offsets. Between them the position is the cubic Hermite of both.
    key : bytes
        Digest of start and content: the same profile sent twice has the same key.
    """

    start_ns: int
    times_ns: tuple[int, ...]
    velocity: tuple[Pair, ...]
    position: tuple[Pair, ...]
    key: bytes

    @property
    def begin_ns(self) -> int:
        """Absolute time of the first point."""
        return self.start_ns + self.times_ns[0]

    @property
    def end_ns(self) -> int:
        """Absolute time of the last point."""
        return self.start_ns + self.times_ns[-1]

    def sample(self, t_ns: int) -> tuple[Pair, Pair]:
        """Velocity (rad/s) and position (rad) at absolute time `t_ns`, held before the first and after the last point.

        At a point the point's own numbers come back, to the bit.
        """
        offset = t_ns - self.start_ns
        i = bisect_right(self.times_ns, offset) - 1
        if i < 0:
            return self.velocity[0], self.position[0]
        if i == len(self.times_ns) - 1 or offset == self.times_ns[i]:
            return self.velocity[i], self.position[i]
        h = (self.times_ns[i + 1] - self.times_ns[i]) * 1e-9
        s = (offset - self.times_ns[i]) * 1e-9 / h
        points = tuple(
            _hermite(s, h, self.position[i][k], self.position[i + 1][k], self.velocity[i][k], self.velocity[i + 1][k])
            for k in (0, 1)
        )
        return (points[0][0], points[1][0]), (points[0][1], points[1][1])


def _hermite(s: float, h: float, p0: float, p1: float, v0: float, v1: float) -> Pair:
    """Derivative and value of the cubic Hermite over an interval of `h` seconds at its fraction `s`.

    For one instant SciPy's spline takes 12 µs where this takes 0.4, in a loop that has to be punctual.
    """
    rise = (p1 - p0) / h
    velocity = v0 + s * (2.0 * (3.0 * rise - 2.0 * v0 - v1) + s * 3.0 * (v0 + v1 - 2.0 * rise))
    position = p0 + h * s * (v0 + s * ((3.0 * rise - 2.0 * v0 - v1) + s * (v0 + v1 - 2.0 * rise)))
    return velocity, position


def parse_profile(message: Any) -> Profile:
    """Check a trajectory_msgs/JointTrajectory and take it as a profile.

    Parameters
    ----------
    message : JointTrajectory or alike
        `joint_names` are both front motors in any order; every point has a `time_from_start` that increases, two
        finite velocities, and two positions or none; positions missing everywhere are integrated from the velocities.

    Raises
    ------
    Refused
        With what was found and what is expected.
    """
    order = _order(list(message.joint_names))
    if not message.points:
        raise Refused("it has no points; expected the whole velocity profile")
    times = tuple(_nanoseconds(point.time_from_start) for point in message.points)
    if times[0] < 0 or any(b <= a for a, b in pairwise(times)):
        raise Refused("time_from_start must begin at zero or later and increase from point to point")
    velocity = tuple(_pair(point.velocities, order, i, "velocities") for i, point in enumerate(message.points))
    given = [len(point.positions) > 0 for point in message.points]
    if any(given):
        if not all(given):
            raise Refused("positions stand in some points and not in others; expected all or none")
        position = tuple(_pair(point.positions, order, i, "positions") for i, point in enumerate(message.points))
        _check_agreement(times, velocity, position)
    else:
        position = _integrated(times, velocity)
    start = _nanoseconds(message.header.stamp)
    return Profile(start, times, velocity, position, _digest(start, times, velocity, position))


def _digest(start: int, times: tuple[int, ...], velocity: tuple[Pair, ...], position: tuple[Pair, ...]) -> bytes:
    digest = hashlib.blake2b(array("q", (start, *times)).tobytes(), digest_size=16)
    for pairs in (velocity, position):
        digest.update(array("d", (number for pair in pairs for number in pair)).tobytes())
    return digest.digest()


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _order(names: list[str]) -> tuple[int, int]:
    if sorted(names) != sorted(FRONT):
        raise Refused(f"joint names are {names}; expected {list(FRONT)}")
    return names.index(FRONT[0]), names.index(FRONT[1])


def _pair(values: Sequence[float], order: tuple[int, int], index: int, what: str) -> Pair:
    if len(values) != 2:
        raise Refused(f"point {index} has {len(values)} {what}; expected 2, one for each joint name")
    pair = (float(values[order[0]]), float(values[order[1]]))
    if not (math.isfinite(pair[0]) and math.isfinite(pair[1])):
        raise Refused(f"point {index} has {what} {pair}; expected finite numbers")
    return pair


def _check_agreement(times: tuple[int, ...], velocity: tuple[Pair, ...], position: tuple[Pair, ...]) -> None:
    """Refuse positions that are not the velocities' integral: an array left at zero would stop the rover dead."""
    margin = 1e-3 + 0.25 * max(abs(v) for pair in velocity for v in pair)
    for i in range(1, len(times)):
        h = (times[i] - times[i - 1]) * 1e-9
        for k in (0, 1):
            mean = (position[i][k] - position[i - 1][k]) / h
            low, high = sorted((velocity[i - 1][k], velocity[i][k]))
            if not low - margin <= mean <= high + margin:
                raise Refused(
                    f"from point {i - 1} to {i} the position of {FRONT[k]} changes by {mean:g} rad/s while its "
                    f"velocity goes from {velocity[i - 1][k]:g} to {velocity[i][k]:g}; "
                    "leave positions empty to have them integrated"
                )


def _integrated(times: tuple[int, ...], velocity: tuple[Pair, ...]) -> tuple[Pair, ...]:
    """Positions by the trapezoidal rule, exact for velocities that are linear between the points."""
    positions = [(0.0, 0.0)]
    for i in range(1, len(times)):
        half = 0.5e-9 * (times[i] - times[i - 1])
        last = positions[-1]
        positions.append(
            (
                last[0] + half * (velocity[i - 1][0] + velocity[i][0]),
                last[1] + half * (velocity[i - 1][1] + velocity[i][1]),
            )
        )
    return tuple(positions)


# ----------------------------------------------------------------------
# Reading a profile of thousands of points without holding up a loop that has to be punctual.
#
# rclpy turns 3000 points into Python objects in one go of 0.14 s, in which no other thread runs. Here the
# serialised message is read point by point, if wanted in a thread beside the loop.
# ----------------------------------------------------------------------


class _Cdr:
    """Reads CDR from front to back; what is aligned is so relative to the first byte after the header of four."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 4
        order = "<" if data[1] & 1 else ">"
        self._word, self._time, self._order = struct.Struct(order + "I"), struct.Struct(order + "iI"), order

    def _align(self, size: int) -> int:
        return self._at + (4 - self._at) % size

    def count(self) -> int:
        """An unsigned 32-bit integer."""
        at = self._align(4)
        self._at = at + 4
        return int(self._word.unpack_from(self._data, at)[0])

    def time(self) -> Record:
        """Seconds and nanoseconds."""
        at = self._align(4)
        self._at = at + 8
        sec, nanosec = self._time.unpack_from(self._data, at)
        return Record(sec=sec, nanosec=nanosec)

    def text(self) -> str:
        """A string, sent with its length and a zero at its end."""
        length = self.count()
        at, self._at = self._at, self._at + length
        if self._at > len(self._data):
            raise IndexError("a string longer than the message")
        return self._data[at : at + length - 1].decode()

    def numbers(self) -> tuple[float, ...]:
        """A sequence of doubles."""
        length = self.count()
        if not length:
            return ()
        at = self._align(8)
        self._at = at + 8 * length
        if self._at > len(self._data):
            raise IndexError("a sequence longer than the message")
        return struct.unpack_from(f"{self._order}{length}d", self._data, at)


def read_trajectory(data: bytes) -> Record:
    """A serialised trajectory_msgs/JointTrajectory as :func:`parse_profile` takes it.

    Raises
    ------
    Refused
        When it is none.
    """
    try:
        cdr = _Cdr(data)
        stamp, _frame = cdr.time(), cdr.text()
        names = [cdr.text() for _ in range(cdr.count())]
        points = []
        for _ in range(cdr.count()):
            positions, velocities = cdr.numbers(), cdr.numbers()
            cdr.numbers(), cdr.numbers()  # accelerations, efforts
            points.append(Record(positions=positions, velocities=velocities, time_from_start=cdr.time()))
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise Refused(f"it cannot be decoded: {error}") from error
    return Record(header=Record(stamp=stamp), joint_names=names, points=points)


Read = tuple[Profile | Refused, float]
"""A profile, or why it is none, and when its message came (steady s)."""


class ProfileReader:
    """Reads profiles, in the order in which they came.

    Parameters
    ----------
    beside : bool
        In a thread of its own; otherwise at once.
    """

    def __init__(self, beside: bool) -> None:
        self._pool = ThreadPoolExecutor(1, "profile") if beside else None
        self._under_way: list[Future[Read]] = []
        self._read: list[Read] = []

    def submit(self, data: bytes, received: float) -> None:
        """Read a serialised message, received at `received` (steady s)."""
        if self._pool is None:
            self._read.append(_read(data, received))
        else:
            self._under_way.append(self._pool.submit(_read, data, received))

    def drop(self) -> None:
        """Forget what came so far."""
        self._under_way, self._read = [], []

    def results(self) -> Iterator[Read]:
        """What has been read since the last call."""
        while self._under_way and self._under_way[0].done():
            self._read.append(self._under_way.pop(0).result())
        while self._read:
            yield self._read.pop(0)


def _read(data: bytes, received: float) -> Read:
    try:
        return parse_profile(read_trajectory(data)), received
    except Refused as reason:
        return reason, received
