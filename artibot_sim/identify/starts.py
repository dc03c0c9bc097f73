"""Where windows start: the measured state and its uncertainty, and the model's state at many guesses of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment.measured import Motion
from artibot_sim.experiment.start_state import start_state
from artibot_sim.model import Robot, initial_state
from artibot_sim.model.layout import MOTOR_COORDINATES
from artibot_sim.model.sensors import sensor_errors, true_starts

Array = NDArray[np.float64]
_MOTORS = list(MOTOR_COORDINATES)

START = ("x", "y", "yaw", "forward", "left", "yaw_rate", "articulation", "articulation_rate")
"""What a start is described by: pose in `map` (m, rad), velocity in the front module's frame (m/s, rad/s), joint."""

_SD = {
    "x": 0.03, "y": 0.03, "yaw": 0.1, "forward": 0.03, "left": 0.03, "yaw_rate": 0.015, "articulation": 0.01,
    "articulation_rate": 0.05,
}  # fmt: skip
"""Standard deviations of the measured start. A window's own samples correct it, so these are wide; the heading's in
particular, which an integrated gyroscope would tie to its bias."""
_BLIND = {"forward": 0.2, "left": 0.2, "yaw_rate": 0.3, "articulation": 0.5, "articulation_rate": 0.5, "yaw": 1.0}
"""The same where nothing measures it."""


@dataclass(frozen=True)
class Start:
    """A window's start as measured.

    Attributes
    ----------
    mean, sd : array, shape (8,)
        In the order of START; a rigid robot has the first 6.
    weight : array, shape (8, 8)
        weight · (start − mean) has unit covariance. What was measured is the velocity in `map`, so a start that heads
        more to the left has its velocity more to the right.
    q, v : array, shape (16,)
        The model's state at the mean, for sensors without errors.
    late : bool
        Whether the heading was measured with the positions, and is as late as they may be.
    """

    mean: Array
    sd: Array
    weight: Array
    q: Array
    v: Array
    late: bool = False


def start_of(
    robot: Robot,
    motion: Motion,
    angles: Array,
    speeds: Array,
    poor: frozenset[str] = frozenset(),
    known: Mapping[str, float] | None = None,
    late: bool = False,
) -> Start:
    """A start from measurements.

    Parameters
    ----------
    robot : Robot
    motion : Motion
        NaN is unknown.
    angles, speeds : array, shape (4,)
        Of the motors, rad and rad/s.
    poor : set of str
        Names of START that are measured badly though they have a value.
    known : mapping of str to float, optional
        Standard deviations of names of START that are measured better or worse than usual.
    late : bool
        See `Start`.
    """
    c, s = np.cos(np.nan_to_num(motion.yaw)), np.sin(np.nan_to_num(motion.yaw))
    forward, left = c * motion.vx + s * motion.vy, c * motion.vy - s * motion.vx
    mean = np.array(
        [motion.x, motion.y, motion.yaw, forward, left, motion.yaw_rate, motion.articulation, motion.articulation_rate]
    )
    count = 8 if robot.articulated else 6
    blind = ~np.isfinite(mean) | np.array([name in poor for name in START])
    usual = _SD | dict(known or {})
    sd = np.array([_BLIND.get(name, usual[name]) if b else usual[name] for name, b in zip(START, blind, strict=True)])
    turn = np.eye(8)
    turn[3, 2], turn[4, 2] = -np.nan_to_num(left), np.nan_to_num(forward)
    weight = (turn / sd[:, None])[:count, :count]
    state = start_state(robot, motion, angles, speeds)
    return Start(np.nan_to_num(mean)[:count], sd[:count], weight, state.q, state.v, late)


def turned(starts: Array, angle: float) -> Array:
    """Starts (n, 8 or 6) that head `angle` rad more to the left and move as before."""
    new = starts.copy()
    c, s = np.cos(angle), np.sin(angle)
    new[:, 2] += angle
    new[:, 3], new[:, 4] = c * starts[:, 3] + s * starts[:, 4], c * starts[:, 4] - s * starts[:, 3]
    return new


class Postures(NamedTuple):
    """Of some robots what a start takes from them.

    Attributes
    ----------
    level : array, shape (r, 16)
        At rest on their wheels: heights, roll and pitch.
    arms : array, shape (r, 2)
        l_f and l_b, m.
    sensors : array, shape (r, 6)
        `SensorErrors` of each.
    articulated : bool
    """

    level: Array
    arms: Array
    sensors: Array
    articulated: bool


def postures(robots: Sequence[Robot]) -> Postures:
    """What `states` needs to know of robots, which are all articulated or all rigid."""
    level = np.array([initial_state(robot).q for robot in robots])
    arms = np.array([(robot.front.l, robot.back.l if robot.back else 0.0) for robot in robots])
    sensors = np.array([sensor_errors(robot) for robot in robots])
    return Postures(level, arms, sensors, robots[0].articulated)


def states(
    of: Postures, robot: NDArray[np.int64], q: Array, v: Array, guesses: Array, late: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """The model's states at guesses of starts: q and v, shape (n, 16) each.

    Parameters
    ----------
    of : Postures
    robot : array of int, shape (n,)
    q, v : array, shape (n, 16)
        States whose motors are taken over, as their encoders show them.
    guesses : array, shape (n, 8 or 6)
        In the order of START, as sensors show it: a guess means another motion for a robot whose sensors have errors.
    late : array of bool, shape (n,)
        See `Start`.

    Notes
    -----
    The joint is closed as seen from above (eq. 13), its rates as well; pitch, where there is any, changes that by
    less than 1e-4 of l, which eq. 25's stabilisation draws in.
    """
    turned = of.sensors[robot, :1]
    motor_q, motor_v = q[:, _MOTORS] / turned, v[:, _MOTORS] / turned
    guesses = true_starts(of.sensors[robot], guesses, late)
    q, v = of.level[robot], np.zeros_like(v)
    q[:, _MOTORS], v[:, _MOTORS] = motor_q, motor_v
    x, y, yaw, forward, left, rate = guesses[:, :6].T
    c, s = np.cos(yaw), np.sin(yaw)
    q[:, 0], q[:, 1], q[:, 5] = x, y, yaw
    v[:, 0], v[:, 1], v[:, 5] = c * forward - s * left, s * forward + c * left, rate
    if not of.articulated:
        return q, v
    bend, bend_rate = guesses[:, 6:].T
    l_f, l_b = of.arms[robot].T
    yaw_b, rate_b = yaw + bend, rate + bend_rate
    c_b, s_b = np.cos(yaw_b), np.sin(yaw_b)
    q[:, 8], q[:, 9], q[:, 13] = x - l_f * c - l_b * c_b, y - l_f * s - l_b * s_b, yaw_b
    v[:, 8] = v[:, 0] + l_f * rate * s + l_b * rate_b * s_b
    v[:, 9] = v[:, 1] - l_f * rate * c - l_b * rate_b * c_b
    v[:, 13] = rate_b
    return q, v
