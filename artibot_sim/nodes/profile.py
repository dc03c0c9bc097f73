"""A front motor velocity profile: what `/planned/front_velocity` says, checked once and sampled every step."""

from __future__ import annotations

import hashlib
import math
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from artibot_sim.model import MOTORS

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
    """Derivative and value of the cubic Hermite over an interval of `h` seconds at its fraction `s`."""
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
