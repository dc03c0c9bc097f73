"""What windows are made of: how motors turned, what is sampled when, and which robot runs from which state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.equations.transmission import Mode
from artibot_sim.model.robot.robot import Robot

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KINDS = (
    "x", "y", "yaw", "articulation_yaw", "yaw_rate", "v_x", "v_y", "a_x", "a_y", "articulation_rate",
    "torque_front_right", "torque_front_left", "torque_back_right", "torque_back_left", "sliding", "grip",
    "origin_x", "origin_y", "heading", "turn_rate",
)  # fmt: skip
"""What can be sampled, by its name.

As sensors see it, their errors included (`sensors.SensorErrors`): position of the tracked point in `map` and the yaw
that comes with it, yaw rate, motor torques (N·m). Without such errors: articulation, and in the front module's frame
velocity and acceleration of its origin (m/s, m/s²); its origin, heading and turn rate; which wheels slide (bit i for
wheel i of WHEELS, as eq. 16 had it at the row before), and the largest share of its normal force that a wheel holds
without sliding."""

OF_TWO = len(KINDS)
"""Kinds of a robot of two modules; behind them stand OF_MODULE for each module more."""
OF_MODULE = ("articulation_yaw", "articulation_rate", "torque_right", "torque_left")


def kind_of(name: str) -> int:
    """The number of what can be sampled, by its name: of KINDS, or of a module or joint behind the first two.

    These are ``articulation_yaw_2``, ``articulation_rate_2``, …, ``torque_module_3_right``, ….
    """
    if name in KINDS:
        return KINDS.index(name)
    if name.startswith("torque_module_"):
        number, side = name.removeprefix("torque_module_").split("_")
        return OF_TWO + len(OF_MODULE) * (int(number) - 3) + OF_MODULE.index(f"torque_{side}")
    what, number = name.rsplit("_", 1)
    return OF_TWO + len(OF_MODULE) * (int(number) - 2) + OF_MODULE.index(what)


@dataclass(frozen=True)
class MotorTable:
    """How the motors turned through one stretch of a recording: knots `dt` apart, cubic between them.

    Attributes
    ----------
    dt : float, s
    position, velocity : array, shape (n, 4)
        Motor-side as recorded, rad and rad/s; zeros for motors that do not exist. A robot whose encoders have a scale
        turned by as much less. A column for each of `Robot.motors`, of which a train may have more than four.
    torque : array, shape (n, 4)
        N m, for motors under torque, recorded likewise; NaN is eq. 30.
    modes : tuple of Mode
        Of each motor.
    kappa : float or None
        Front share of eq. 29, where a motor is under eq. 30's torque; None is the robot's own.
    from_speeds : tuple of bool
        Of each motor whether nothing but its speed was recorded, so that a low-pass of it moves its angle, too. None
        is by default.
    """

    dt: float
    position: Array
    velocity: Array
    torque: Array
    modes: tuple[Mode, ...]
    kappa: float | None = None
    from_speeds: tuple[bool, ...] = ()

    @cached_property
    def behind(self) -> Array:
        """By how much its angles, then its speeds trail for each second of a low-pass, shape (n, 4 + 4)."""
        return behind(self.velocity, self.dt, self.from_speeds)


def behind(speed: Array, dt: float, from_speeds: Sequence[bool]) -> Array:
    """By how much angles (rad), then speeds (rad/s) trail for each second of a low-pass that `speed` (n, 4) came from.

    What comes out of a low-pass of time constant T is T times its own rate behind what goes in; the rate is that of
    parabolas over `_SLOPE` s, for speeds are noisy, and angles, counted from the first knot, are its integral. Motors
    of which angles were recorded turned as these say: zero where not `from_speeds`. Shape (n, 4 + 4).
    """
    alone, found = np.flatnonzero(from_speeds), np.zeros((len(speed), 2 * speed.shape[1]))
    if len(alone):
        from scipy.integrate import cumulative_trapezoid  # half a second to import both, which few robots ask for
        from scipy.signal import savgol_filter

        size = min(2 * round(0.5 * _SLOPE / dt) + 1, len(speed) - (len(speed) + 1) % 2)
        rate = savgol_filter(speed[:, alone], size, min(2, size - 1), 1, dt, axis=0)
        found[:, alone] = cumulative_trapezoid(rate, dx=dt, axis=0, initial=0.0)
        found[:, speed.shape[1] + alone] = rate
    return found


_SLOPE = 0.2


def longest_step(steps: Sequence[float], limit: float, tables: Sequence[MotorTable]) -> float | None:
    """The first of some steps (s) that is no longer than the limit and divides the tables' spacing; None if none is."""
    for dt in steps:
        if dt <= limit and all(abs(table.dt / dt - round(table.dt / dt)) < 1e-6 for table in tables):
            return dt
    return None


@dataclass(frozen=True)
class SamplingPlan:
    """Where a window is looked at.

    Attributes
    ----------
    t : array, shape (m,)
        s after the window's first knot, at most its length.
    kind : array, shape (m,)
        Which of KINDS, or what `kind_of` says.
    """

    t: Array
    kind: Indices


@dataclass(frozen=True)
class Items:
    """What to run, one row each: all arrays have the same length n.

    Attributes
    ----------
    robot, table, plan : array of int, shape (n,)
        Indices into what the batch was given.
    first, knots : array of int, shape (n,)
        First knot of the table, and how many intervals follow.
    q, v : array, shape (n, 16)
        Start states: the rover's own, motors included, not as its sensors show them; (n, 8 modules) of trains.
    t : array, shape (n,)
        When they are, s since the recording's start: some effects change with time.
    memory : array, shape (n, 32), optional
        What wheels remember then, see `layout.MEMORY`; (n, 16 modules) of trains, all zero by default.
    """

    robot: Indices
    table: Indices
    plan: Indices
    first: Indices
    knots: Indices
    q: Array
    v: Array
    t: Array
    memory: Array | None = None

    def __len__(self) -> int:
        return len(self.robot)


def whole(values: Indices) -> Indices:
    """A copy that compiled code takes whatever it was."""
    return np.array(values, dtype=np.int64, order="C")


def real(values: Array) -> Array:
    """Numbers as compiled code takes them: float64, contiguous."""
    return np.array(values, dtype=np.float64, order="C")


def by_numbers(robots: Sequence[Robot]) -> tuple[list[Robot], Indices]:
    """The robots that differ in the paper's numbers or in their sensors, and which of them each one is like.

    Robots are alike that are made of the very same parts (objects), whatever their effects do in the extended model
    only: a search for forces asks for thousands of these.
    """
    places: dict[tuple[int, ...], int] = {}
    different: list[Robot] = []
    like = np.empty(len(robots), np.int64)
    for i, robot in enumerate(robots):
        bodies = robot.front, robot.back, robot.trailing
        parts = (*bodies, robot.wheel, robot.contact, robot.drive, robot.control, robot.readings)
        changing = [values for name, values in robot.effects.items() if name in _CHANGING]
        key = (*map(id, parts), *map(id, changing))
        if key not in places:
            places[key] = len(different)
            different.append(robot)
        like[i] = places[key]
    return different, like


_CHANGING = frozenset(name for name, effect in EFFECTS.items() if effect.adapt or effect.sensor)
