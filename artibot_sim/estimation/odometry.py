"""Odometry: where a rover believes it is, from the rotations of its front wheels, and how sure that is.

The belief is a pose without slip. Real wheels slip, and in the same sense on the same ground, so the error grows with
the way. Three relative errors are taken for unknown: of the distance (slip along the wheels, wheel radius), of the
turned angle (wheels scrub in a turn: the largest of them), and a drift to the side. Each has a part that is the same
all along and one that changes from metre to metre; the covariance is the sum of what both do to the pose. A wrong turn
bends the path, and by tenths of a radian the error of the place is no longer proportional to it: what is stated is the
mean of the squared error over all turns that the deviation allows, about the pose that is published. Where radius,
track or soil were identified, their intervals add to the three.
``python -m artibot_sim.estimation.odometry`` prints the size of the three in simulations of the shipped robots, and how
the errors on other soils compare with what is stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.turning import placeless, steady_turn, wheel_speeds
from artibot_sim.model import Robot, Rollout, load_robot, rollout
from artibot_sim.planning import load_manoeuvre, manoeuvre_names, plan
from artibot_sim.resources import config_names

Array = NDArray[np.float64]

OTHER_SOILS = (0.8, 1.0, 1.25)
"""Friction relative to the robot file's, on which stated covariances are held against errors."""

UNKNOWN = 1e6
"""Variance of what is not measured at all: height, roll, pitch."""

FLOOR = (1e-3, 1e-3, 1e-3)
"""Standard deviations (m, m, rad; a second for velocities) that are stated at least: filters invert covariances."""


def _quadrature(order: int) -> list[tuple[float, float]]:
    """Gauss–Hermite nodes, in standard deviations, and the roots of their weights, which sum up to 1."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(order)
    return list(zip(nodes.tolist(), np.sqrt(weights / weights.sum()).tolist(), strict=True))


_NODES = _quadrature(7)
"""For the error of the turned angle."""

_ROOTS = tuple(root for _, root in _NODES)


def metres_per_radian(robot: Robot) -> float:
    """``r_w tau``: ground covered per radian of a front motor."""
    return robot.wheel.r_w * robot.drive.front.tau


@dataclass(frozen=True)
class Slip:
    """Relative standard deviations.

    Attributes
    ----------
    travel : of the distance, 1.
    turn : of the turned angle, 1.
    side : of a drift to the side per distance, 1.
    """

    travel: float = 0.0
    turn: float = 0.0
    side: float = 0.0

    def times(self, factor: float) -> Slip:
        """Return all three times a factor."""
        return Slip(factor * self.travel, factor * self.turn, factor * self.side)

    @classmethod
    def of(cls, settings: Mapping[str, Any], robot: Robot) -> Slip:
        """From a node's parameters, with what the robot file says of how sure radius and track are.

        A parameter that is negative stands for what the robot file says.
        """
        radius, track = uncertainty(robot, "wheel.r_w"), uncertainty(robot, "front.i_y")
        soil, own = soil_slip(robot), robot.odometry
        given = {name: float(settings[f"odometry.{name}"]) for name in ("travel_slip", "turn_slip", "side_slip")}
        travel, turn, side = (value if value >= 0.0 else getattr(own, name) for name, value in given.items())
        return cls(
            math.hypot(travel, radius, soil.travel),
            math.hypot(turn, radius, track, soil.turn),
            math.hypot(side, soil.side),
        )


def soil_slip(robot: Robot) -> Slip:
    """What the intervals of identified soil leave open: how much a steady turn changes by one deviation of each.

    Parameters whose turn cannot be simulated that far out count as if they changed nothing, and so do those of trains
    of more than two modules, whose turns `exchange.turning` does not know.
    """
    if len(robot.modules) > 2:
        return Slip()
    keys = [key for key in robot.intervals if key.startswith("contact.") and uncertainty(robot, key) > 0]
    if not keys:
        return Slip()
    wheels = wheel_speeds(robot)[_TURN]
    base, errors = steady_turn(placeless(robot), wheels), []
    for key in keys:
        with suppress(ArtibotError):
            turn = steady_turn(placeless(_moved(robot, key)), wheels)
            errors.append(
                (
                    turn.speed / base.speed - 1.0,
                    turn.yaw_rate / base.yaw_rate - 1.0,
                    (turn.drift - base.drift) / base.speed,
                )
            )
    return Slip(*np.sqrt(np.sum(np.square(errors), axis=0)).tolist()) if errors else Slip()


_TURN = 3
"""Of `wheel_speeds`: that of medium radius, to the left."""


def _moved(robot: Robot, key: str) -> Robot:
    """Return the robot with one parameter a standard deviation away, downwards: friction stays friction."""
    value = attrgetter(key)(robot)
    moved = value * max(1.0 - uncertainty(robot, key), 0.05)
    if key == "contact.mu_s":
        moved = max(moved, robot.contact.mu_d)
    return robot.replace({key: moved})


def uncertainty(robot: Robot, key: str) -> float:
    """Relative standard deviation of an identified parameter, from its 95 % interval; 0 where it has none."""
    if key not in robot.intervals:
        return 0.0
    low, high = robot.intervals[key]
    return float((high - low) / (2.0 * 1.96) / abs(attrgetter(key)(robot)))


class PoseError:
    """What relative errors of the motion have done to a pose so far.

    Parameters
    ----------
    slip : Slip
    track : float
        m, between the sides, each of which slips on its own ground.

    Attributes
    ----------
    slip : Slip
    drift : float
        Standard deviation of a constant error of the yaw rate, rad/s (a gyroscope's bias).
    """

    def __init__(self, slip: Slip, track: float) -> None:
        self.slip, self.drift, self._track = slip, 0.0, track
        # x, y, yaw of the pose by way, side and drift, whose errors are the same all along
        self._common = [[0.0] * 3 for _ in range(3)]
        self._turned = [[0.0] * 3 for _ in _NODES]  # by an error of the turned angle that is the same all along
        self._changing = (0.0,) * 6  # xx, xy, xt, yy, yt, tt of the covariance by those that change

    def spread(self, dx: float, dy: float, turn: float, rolled: float, dt: float = 0.0) -> None:
        """Carry the errors on over a step (m, m, rad in `odom`), in which the faster wheel rolled so far (m).

        In plain numbers: nodes do this a hundred times a second, and NumPy takes four times as long for so few.
        """
        half, slip = 0.5 * turn, self.slip  # by a wrong turn the step itself leads astray, too
        # a heading that was wrong before the step leads it astray
        for one, (x, y, yaw) in zip(
            self._common, ((dx, dy, 0.0), (-dy, dx, 0.0), (-0.5 * dt * dy, 0.5 * dt * dx, dt)), strict=True
        ):
            one[0] += x - dy * one[2]
            one[1] += y + dx * one[2]
            one[2] += yaw
        for one, (node, _) in zip(self._turned, _NODES, strict=True):
            wrong = slip.turn * turn * node
            middle = one[2] + 0.5 * wrong
            c, s = math.cos(middle) - 1.0, math.sin(middle)
            one[0] += c * dx - s * dy
            one[1] += s * dx + c * dy
            one[2] += wrong
        xx, xy, xt, yy, yt, tt = self._changing
        per_metre = 1.0 / max(rolled, 1e-12)  # of a walk by metres, not by steps
        way, angle, side = (per_metre * each * each for each in (slip.travel, slip.turn, slip.side))
        across = angle * half * half + side
        self._changing = (
            xx - 2.0 * dy * xt + dy * dy * tt + way * dx * dx + across * dy * dy,
            xy + dx * xt - dy * yt - dx * dy * tt + (way - across) * dx * dy,
            xt - dy * tt - angle * half * turn * dy,
            yy + 2.0 * dx * yt + dx * dx * tt + way * dy * dy + across * dx * dx,
            yt + dx * tt + angle * half * turn * dx,
            tt + angle * turn * turn,
        )

    def wander(self, variance: float, place: float = 0.0) -> None:
        """Add variances of the heading (rad²), and of the place in each direction (m²)."""
        xx, xy, xt, yy, yt, tt = self._changing
        self._changing = (xx + place, xy, xt, yy + place, yt, tt + variance)

    def sides_slip(self, rolled: float) -> None:
        """Each side slips on its own ground: the heading drifts on a straight line too.

        The error of the travel is the mean of both sides' and is taken for theirs alone; simulations, whose ground is
        the same on both sides, show nothing of it.
        """
        self.wander((2.0 * self.slip.travel / self._track) ** 2 * rolled)

    @property
    def covariance(self) -> Array:
        """Of x, y and yaw, shape (3, 3): the mean squared error about the pose that is believed."""
        return self.covariance_with((0.0, 0.0, 0.0))

    def covariance_with(self, passed: tuple[float, float, float]) -> Array:
        """Mean squared error of x, y and yaw, shape (3, 3), with one error more.

        `passed` are its standard deviations (m, m, rad), all by the same cause.
        """
        slip = self.slip
        xx, xy, xt, yy, yt, tt = self._changing
        for size, (x, y, yaw) in (
            (1.0, passed), *zip((slip.travel, slip.side, self.drift), self._common, strict=True),
            *zip(_ROOTS, self._turned, strict=True),
        ):  # fmt: skip
            square = size * size
            xx += square * x * x
            xy += square * x * y
            xt += square * x * yaw
            yy += square * y * y
            yt += square * y * yaw
            tt += square * yaw * yaw
        a, b, c = FLOOR
        return np.array([[xx + a * a, xy, xt], [xy, yy + b * b, yt], [xt, yt, tt + c * c]])


def diagonal(*deviations: float) -> Array:
    """Covariance of what is independent, at least `FLOOR` each, shape (3, 3)."""
    a, b, c = (own * own + least * least for own, least in zip(deviations, FLOOR, strict=True))
    return np.array([[a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c]])


class Odometry:
    """What the robot believes: its pose from the front wheels' rotations, no slip.

    Parameters
    ----------
    metres_per_radian : float
        ``r_w tau``, ground per radian of a front motor.
    track : float
        ``i_y`` of the front module, m.
    slip : Slip, optional
    same_ground : bool
        Whether both sides are known to slip alike, as in simulations.

    Attributes
    ----------
    pose : (x, y, yaw), m and rad
    twist : (forward, yaw rate), m/s and rad/s
    """

    def __init__(
        self, metres_per_radian: float, track: float, slip: Slip | None = None, *, same_ground: bool = False
    ) -> None:
        self._metres = metres_per_radian
        self._track = track
        self._slip = slip or Slip()
        self._same_ground = same_ground
        self.reset(0.0, 0.0, 0.0)

    def reset(self, x: float, y: float, yaw: float) -> None:
        """Believe this pose (m, rad), at rest and for certain; the next motor positions are the zero of rotation."""
        self.pose, self.twist = (x, y, yaw), (0.0, 0.0)
        self._last: tuple[float, float] | None = None
        self._error = PoseError(self._slip, self._track)

    def update(self, position: tuple[float, float], velocity: tuple[float, float]) -> None:
        """Go on by the front motors' positions (rad) and velocities (rad/s), right and left.

        Between two readings the path is an arc, followed by its chord at mean yaw.
        """
        right, left = self._metres * velocity[0], self._metres * velocity[1]
        self.twist = (0.5 * (right + left), (right - left) / self._track)
        if self._last is not None:
            right = self._metres * (position[0] - self._last[0])
            left = self._metres * (position[1] - self._last[1])
            turn, way, (x, y, yaw) = (right - left) / self._track, 0.5 * (right + left), self.pose
            length = way * (math.sin(0.5 * turn) / (0.5 * turn) if abs(turn) > 1e-9 else 1.0)
            dx, dy = length * math.cos(yaw + 0.5 * turn), length * math.sin(yaw + 0.5 * turn)
            if way or turn:
                rolled = max(abs(right), abs(left))
                self._error.spread(dx, dy, turn, rolled)
                if not self._same_ground:
                    self._error.sides_slip(rolled)
            self.pose = (x + dx, y + dy, yaw + turn)
        self._last = position

    @property
    def pose_covariance(self) -> Array:
        """Of x, y and yaw, shape (3, 3)."""
        return self._error.covariance

    @property
    def twist_covariance(self) -> Array:
        """Of the velocities forward and to the left and of the yaw rate, shape (3, 3), diagonal."""
        slip, (speed, rate) = self._slip, self.twist
        turned = math.hypot(slip.turn * rate, 2.0 * slip.travel * speed / self._track)
        return diagonal(slip.travel * speed, slip.side * speed, turned)


def measured_slip(robot: Robot) -> Slip:
    """Root mean square of the three relative errors in simulations of all shipped manoeuvres, over windows of 1 s."""
    found: list[list[Array]] = [[], [], []]
    for name in manoeuvre_names():
        for kappa in (0.7, 1.0):
            result = rollout(robot, plan(load_manoeuvre(name), robot).commands(), kappa=kappa, every=10)
            _add_errors(found, robot, result.q, round(1.0 / float(result.t[1] - result.t[0])))
    return Slip(*(float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) for errors in found))


def _add_errors(found: list[list[Array]], robot: Robot, q: Array, n: int) -> None:
    """Take the errors of a run (coordinates `q`) over windows of `n` rows, of those with enough way or turn."""
    steps, yaw = np.diff(q[:, :2], axis=0), q[:-1, 5]
    along = np.cumsum(np.cos(yaw) * steps[:, 0] + np.sin(yaw) * steps[:, 1])[n - 1 :: n]
    aside = np.cumsum(np.cos(yaw) * steps[:, 1] - np.sin(yaw) * steps[:, 0])[n - 1 :: n]
    right, left = (metres_per_radian(robot) * q[n::n, 6:8]).T[:, : len(along)]
    way, turn = np.diff(0.5 * (right + left), prepend=0.0), np.diff((right - left) / robot.front.i_y, prepend=0.0)
    true = (
        np.diff(along, prepend=0.0),
        np.diff(q[n::n, 5], prepend=q[0, 5])[: len(along)],
        np.diff(aside, prepend=0.0),
    )
    moved, turned = np.abs(way) > 0.05, np.abs(turn) > 0.02
    found[0].append((true[0] / np.where(moved, way, 1.0) - 1.0)[moved])
    found[1].append((true[1] / np.where(turned, turn, 1.0) - 1.0)[turned])
    found[2].append((true[2] / np.where(moved, way, 1.0))[moved])


def normalised_errors(robot: Robot) -> tuple[Array, Array]:
    """Squared errors of odometry by their stated covariance, in simulations on soils other than the robot file's.

    Parameters
    ----------
    robot : Robot
        Whose odometry is asked; the one that drives has the friction of `OTHER_SOILS`.

    Returns
    -------
    two arrays, shape (n,)
        ``e' P⁻¹ e`` of x, y and yaw, each second of all shipped manoeuvres, by the covariance that nodes state, and by
        that for sides that slip alike, as they do here. Their mean is 3 where errors are as stated, less where more is
        stated than there is.
    """
    stated = {f"odometry.{name}_slip": -1.0 for name in ("travel", "turn", "side")}
    slip = Slip.of(stated, robot)
    found: list[list[float]] = [[], []]
    for friction in OTHER_SOILS:
        other = robot.replace({f"contact.{mu}": friction * getattr(robot.contact, mu) for mu in ("mu_s", "mu_d")})
        for name in manoeuvre_names():
            result = rollout(other, plan(load_manoeuvre(name), robot).commands(), kappa=0.8, every=50)
            for squares, same in zip(found, (False, True), strict=True):
                odometry = Odometry(metres_per_radian(robot), robot.front.i_y, slip, same_ground=same)
                squares += _squared_errors(odometry, result)
    return np.array(found[0]), np.array(found[1])


def _squared_errors(odometry: Odometry, result: Rollout) -> Iterator[float]:
    """Squared errors by their covariance along a run, a value every second."""
    n = round(1.0 / float(result.t[1] - result.t[0]))
    for row, (q, v) in enumerate(zip(result.q, result.v, strict=True)):
        odometry.update((q[6], q[7]), (v[6], v[7]))
        if row and not row % n:
            error = np.array(odometry.pose) - q[[0, 1, 5]]
            yield float(error @ np.linalg.solve(odometry.pose_covariance, error))


if __name__ == "__main__":
    for robot_name in config_names("robots"):
        shipped = load_robot(robot_name)
        print(robot_name, measured_slip(shipped))
        for what, squares in zip(
            ("as nodes state it", "for sides that slip alike"), normalised_errors(shipped), strict=True
        ):
            outside = 100.0 * float(np.mean(squares > 7.815))
            print(
                f"  normalised squared error, {what}: mean {squares.mean():.2f} (3 where as stated), "
                f"{outside:.1f} % beyond 95 %"
            )
