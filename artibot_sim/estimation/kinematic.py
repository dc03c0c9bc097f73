"""Kinematic models of skid steering, which a model with forces has to beat: from the wheels' speeds to where they lead.

They are fitted to the ends of windows, for there they are judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from artibot_sim.estimation.problem import Problem
from artibot_sim.model import Robot

Array = NDArray[np.float64]

STEP = 0.05
"""s between the speeds that models are given."""
BEFORE, AFTER = 0.5, 0.5
"""s of speeds before a window and after it, for what is late."""
_BEND = 0.05
"""m and rad from which an error counts linearly in a fit."""

UNTIMED, TIMED = "ICR", "ICR with timing"
FREE: dict[str, tuple[str, ...]] = {
    "effective track": ("track",),
    UNTIMED: ("track", "scale", "lateral"),
    TIMED: ("track", "scale", "lateral", "delay"),
}
"""Kinematic model → what is fitted."""
_BOUNDS = {"track": (0.1, 30.0), "scale": (-2.0, 3.0), "lateral": (-3.0, 3.0), "delay": (-BEFORE, BEFORE)}


@dataclass(frozen=True)
class DrivenWindows:
    """Where a robot was at the starts and the ends of windows, and how its wheels turned.

    Attributes
    ----------
    t, length : array, shape (n,)
        Starts, s of the recording, and lengths, s.
    start, end : array, shape (n, 3)
        Measured poses, m and rad; headings continuous from start to end, NaN where they were not measured.
    speed : array, shape (n, m, 2)
        Of the right and the left wheels, rad/s, `STEP` apart from `BEFORE` the start on.
    """

    t: Array
    length: Array
    start: Array
    end: Array
    speed: Array

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, rows: NDArray[Any]) -> DrivenWindows:
        return DrivenWindows(self.t[rows], self.length[rows], self.start[rows], self.end[rows], self.speed[rows])

    @property
    def moved(self) -> Array:
        """Ends as seen from the starts, (n, 3): forward, to the left, turned."""
        c, s = np.cos(self.start[:, 2]), np.sin(self.start[:, 2])
        dx, dy, turn = (self.end - self.start).T
        return np.column_stack([c * dx + s * dy, c * dy - s * dx, turn])


@dataclass(frozen=True)
class Kinematic:
    """Skid steering by three numbers, from speeds that may be late or early.

    Attributes
    ----------
    radius : float
        m that are rolled per radian of a motor.
    track : float
        That the speeds of both sides turn, m.
    scale : float
        Speed over that of rolling.
    lateral : float
        Leftward speed per yaw rate, m.
    delay : float
        By which poses are later than speeds, s.
    """

    radius: float
    track: float
    scale: float = 1.0
    lateral: float = 0.0
    delay: float = 0.0

    def rates(self, speed: Array) -> Array:
        """Forward and leftward speed and yaw rate, (…, 3), of wheel speeds (…, 2)."""
        rim = self.radius * self.scale * speed
        turn = (rim[..., 0] - rim[..., 1]) / self.track
        return np.stack([rim.mean(axis=-1), self.lateral * turn, turn], axis=-1)

    def path(self, at: Array, t: Array, speed: Array) -> Array:
        """Poses (n, 3) at times `at` (n,) as seen from the first, of wheel speeds (m, 2) at times `t` (m,)."""
        forward, left, turn = (np.interp(at - self.delay, t, column) for column in self.rates(speed).T)
        yaw = _integral(turn, at)
        c, s = np.cos(yaw), np.sin(yaw)
        return np.column_stack([_integral(c * forward - s * left, at), _integral(s * forward + c * left, at), yaw])

    def __call__(self, windows: DrivenWindows) -> Array:
        """Where windows end as seen from their starts, (n, 3)."""
        grid: Array = np.arange(windows.speed.shape[1], dtype=np.float64) * STEP - BEFORE
        found = np.empty((len(windows), 3))
        for i, length in enumerate(windows.length):
            found[i] = self.path(np.linspace(0.0, length, round(length / STEP) + 1), grid, windows.speed[i])[-1]
        return found


def _integral(rate: Array, t: Array) -> Array:
    """By the trapezoidal rule, from 0."""
    return np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t) * (rate[1:] + rate[:-1]))))


def ideal(robot: Robot) -> Kinematic:
    """Wheels that roll without slip."""
    return Kinematic(robot.wheel.r_w * robot.drive.front.tau, robot.front.i_y)


def fit_kinematic(windows: DrivenWindows, robot: Robot, free: Sequence[str]) -> Kinematic:
    """The kinematic model whose predictions of windows' ends are nearest, large errors counting linearly."""
    first, wanted = ideal(robot), windows.moved

    def residual(values: Array) -> Array:
        model = replace(first, **dict(zip(free, values.tolist(), strict=True)))
        return np.nan_to_num(model(windows) - wanted).ravel()

    low, high = zip(*(_BOUNDS[name] for name in free), strict=True)
    guess = [np.clip(1.6 * first.track if name == "track" else getattr(first, name), *_BOUNDS[name]) for name in free]
    found = least_squares(residual, guess, bounds=(low, high), loss="huber", f_scale=_BEND, x_scale=0.1, diff_step=1e-3)
    return replace(first, **dict(zip(free, found.x.tolist(), strict=True)))


def kinematic_models(problem: Problem) -> dict[str, Kinematic]:
    """Ideal rolling, and all of FREE fitted to a problem's windows, by name."""
    robot, windows = problem.parameters.robot, driven_windows(problem)
    return {"ideal": ideal(robot)} | {name: fit_kinematic(windows, robot, free) for name, free in FREE.items()}


def driven_windows(problem: Problem) -> DrivenWindows:
    """A problem's windows from their measured starts to the last position that was measured in each."""
    rows = []
    longest = float(problem.durations.max())
    grid = STEP * np.arange(-round(BEFORE / STEP), round((longest + AFTER) / STEP) + 1)
    for window, start in zip(problem.windows, problem.starts, strict=True):
        inputs = problem.stretches[window.stretch].inputs
        x, y, heading = window.places
        length, yaw = float(window.plan.t[x[-1]]), np.nan
        if len(heading):
            turned = np.unwrap(np.concatenate(([start[2]], window.value[heading])))[1:]
            yaw = float(np.interp(length, window.plan.t[heading], turned))
        at = inputs.t[window.first] + grid
        speed = np.column_stack([np.interp(at, inputs.t, column) for column in inputs.velocity[:, :2].T])
        rows.append((window.t, length, start[:3], np.array([window.value[x[-1]], window.value[y[-1]], yaw]), speed))
    return DrivenWindows(*(np.array(column) for column in zip(*rows, strict=True)))
