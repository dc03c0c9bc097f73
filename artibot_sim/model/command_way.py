"""The way from a command to what the front motors are to follow: delays, lags and dead bands, where effects say so.

:class:`Commands` of a rollout are what motors follow. Whoever has commands from before that way, such as a planner's,
sends them along it by `as_executed`, or sample by sample by :class:`CommandWay`; rotations that were measured have it
behind them.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.commands import Commands
from artibot_sim.model.effects import at_work
from artibot_sim.model.robot import Robot

Array = NDArray[np.float64]


class CommandWay:
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
    way = CommandWay(robot, commands.dt, front[0])
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
