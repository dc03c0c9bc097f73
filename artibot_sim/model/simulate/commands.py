"""What the motors are commanded to do, and what becomes of it on the way to them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import at_work
from artibot_sim.model.robot.robot import Robot

# ----------------------------------------------------------------------
# What the motors are commanded: angles, speeds and torques at evenly spaced knots.
# ----------------------------------------------------------------------


def _frozen(array: Array) -> Array:
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Commands:
    """Motor commands at ``t0 + i*dt``, motor side, columns in the order of MOTORS (of `Robot.motors` for a train).

    Between knots a commanded angle is the cubic that meets both knots' angles and speeds; a torque is held from
    its knot to the next. After the last knot angles and torques stay.

    Attributes
    ----------
    dt : float
        Spacing of the knots, s.
    velocity : array, shape (n, 4)
        Speeds, rad/s. NaN in a whole column where a motor is not commanded by speed. A robot with more driven modules
        takes two columns more for each; with four its other motors are under eq. 30's torque.
    position : array, shape (n, 4), optional
        Angles, rad; integrated from the speeds (trapezoidal rule, from 0) when absent.
    torque : array, shape (n, 4), optional
        Torques, N m; NaN for a back motor means eq. 30, for a front motor zero.
    t0 : float
        Time of the first knot, s.

    Raises
    ------
    ArtibotError
        On a wrong shape, a NaN among numbers, or dt that is not positive.
    """

    dt: float
    velocity: Array
    position: Array = None  # type: ignore[assignment]  # filled in by __post_init__, as torque is
    torque: Array = None  # type: ignore[assignment]
    t0: float = 0.0
    commanded: tuple[bool, ...] = field(init=False, default=(False,) * 4)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise ArtibotError(f"commands.dt: {self.dt} s; expected a finite spacing of knots greater than 0")
        if not np.isfinite(self.t0):
            raise ArtibotError(f"commands.t0: {self.t0} s; expected a finite time")
        velocity = self._array("velocity", self.velocity)
        present = np.asarray(~np.isnan(velocity).all(axis=0))
        self._refuse_gaps("velocity", velocity[:, present])
        position = _integrate(velocity, self.dt) if self.position is None else self._array("position", self.position)
        self._like("position", position, velocity)
        self._refuse_gaps("position", position[:, present])
        torque = np.full(velocity.shape, np.nan) if self.torque is None else self._array("torque", self.torque)
        self._like("torque", torque, velocity)
        if np.isinf(torque).any():
            raise ArtibotError("commands.torque: infinite; expected numbers in N m, or NaN for eq. 30")
        object.__setattr__(self, "commanded", tuple(bool(flag) for flag in present))
        object.__setattr__(self, "velocity", _frozen(velocity))
        object.__setattr__(self, "position", _frozen(position))
        object.__setattr__(self, "torque", _frozen(torque))

    @property
    def duration(self) -> float:
        """Time from the first knot to the last, s."""
        return (len(self.velocity) - 1) * self.dt

    @staticmethod
    def _array(name: str, values: ArrayLike) -> Array:
        array = np.array(values, dtype=float, order="C")  # another order would be compiled for anew
        if array.ndim != 2 or array.shape[1] < 4 or array.shape[1] % 2 or len(array) < 1:
            raise ArtibotError(
                f"commands.{name}: shape {array.shape}; expected (knots, 4), columns front_right, front_left, "
                "back_right, back_left, and two more for each driven module behind them"
            )
        return array

    @staticmethod
    def _like(name: str, array: Array, velocity: Array) -> None:
        if array.shape != velocity.shape:
            raise ArtibotError(f"commands.{name}: shape {array.shape}; expected that of velocity, {velocity.shape}")

    @staticmethod
    def _refuse_gaps(name: str, array: Array) -> None:
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            raise ArtibotError(
                f"commands.{name}: {array[tuple(bad[0])]} at knot {bad[0][0]}; expected finite numbers "
                "(leave a whole column NaN for a motor that is not commanded)"
            )


def _integrate(velocity: Array, dt: float) -> Array:
    steps = 0.5 * dt * (velocity[1:] + velocity[:-1])
    return np.vstack([np.zeros((1, velocity.shape[1])), np.cumsum(steps, axis=0)])


# ----------------------------------------------------------------------
# The way from a command to what the front motors are to follow: delays, lags and dead bands, where effects say
# so.
#
# :class:`Commands` of a rollout are what motors follow. Whoever has commands from before that way, such as a
# planner's, sends them along it by `as_executed`, or sample by sample by :class:`CommandChain`; rotations that were
# measured have it behind them.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


class CommandChain:
    """What becomes of the front motors' speeds, sample by sample.

    Parameters
    ----------
    robot : Robot
    h : float
        Time from sample to sample, s.
    first : array, shape (2,)
        Speeds at the first sample (rad/s), which were commanded for long.

    Attributes
    ----------
    now : array, shape (2,)
        What the motors are to follow at the last sample.
    """

    def __init__(self, robot: Robot, h: float, first: Array) -> None:
        self._steps = []
        self.now = np.asarray(first, dtype=float)
        for effect, values in at_work(robot.effects).values():
            if effect.command is not None:
                step = effect.command(values, h, self.now)
                self.now = step(self.now)
                self._steps.append(step)

    def __bool__(self) -> bool:
        """Whether anything happens on the way."""
        return bool(self._steps)

    def follow(self, speeds: Array) -> Array:
        """What the motors follow at the samples after the last one, for `speeds` (n, 2) commanded there, rad/s."""
        rows = np.empty((len(speeds), 2))
        for i, speed in enumerate(speeds):
            self.now = np.asarray(speed, dtype=float)
            for step in self._steps:
                self.now = step(self.now)
            rows[i] = self.now
        return rows


def as_executed(robot: Robot, commands: Commands) -> Commands:
    """`commands` at the end of their way to the front motors; the same object where nothing happens on it."""
    front = commands.velocity[:, :2]
    if not all(commands.commanded[:2]):
        return commands
    way = CommandChain(robot, commands.dt, front[0])
    if not way:
        return commands
    velocity, position = commands.velocity.copy(), commands.position.copy()
    velocity[0, :2] = way.now
    velocity[1:, :2] = way.follow(front[1:])
    position[1:, :2] = position[0, :2] + travelled(velocity[:, :2], commands.dt)
    return dataclasses.replace(commands, velocity=velocity, position=position)


def travelled(speeds: Array, h: float) -> Array:
    """Angles since the first sample at those after it, shape (n − 1, 2), for speeds (n, 2) that are linear between."""
    return np.asarray(np.cumsum(0.5 * h * (speeds[1:] + speeds[:-1]), axis=0))
