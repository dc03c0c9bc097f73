"""Kinematic models of skid steering, which a model with forces has to beat: fitted to the same windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import SAMPLE_BEND
from artibot_sim.identify.windows import HEADINGS
from artibot_sim.model import Robot

Array = NDArray[np.float64]

MODELS = {
    "ideal": (),
    "effective track": ("track",),
    "ICR": ("track", "speed_scale", "lateral"),
}
"""Model → what is fitted: the track that turns (m), speed over that of rolling, leftward speed per yaw rate (m)."""


@dataclass(frozen=True)
class Kinematic:
    """One model: m rolled per rad of a motor, effective track (m), speed scale, leftward velocity per yaw rate (m)."""

    name: str
    rolled: float
    track: float
    speed_scale: float = 1.0
    lateral: float = 0.0

    def predict(self, problem: Problem, starts: Array) -> list[Array]:
        """Residuals of position and yaw of every window, in units of noise, (n,) each; others are left out (0)."""
        every = []
        for number, window in enumerate(problem.windows):
            stretch = problem.stretches[window.stretch]
            part = slice(window.first, window.first + window.knots + 1)
            speed, dt = stretch.inputs.velocity[part, :2] * self.rolled, stretch.inputs.dt
            pose = self._integrate(speed, dt, starts[number])
            t = np.arange(len(pose)) * dt
            predicted = window.value.copy()
            for column, kinds in enumerate(((0,), (1,), HEADINGS)):
                mine = np.isin(window.plan.kind, kinds)
                predicted[mine] = np.interp(window.plan.t[mine], t, pose[:, column])
            every.append(predicted)
        return list(problem.parts(problem.compare(np.concatenate(every)[None])[0]))

    def _integrate(self, speed: Array, dt: float, start: Array) -> Array:
        """Poses (n, 3) from speeds of the right and the left wheels (n, 2), m/s."""
        rate = self.speed_scale * (speed[:, 0] - speed[:, 1]) / self.track
        forward, left = self.speed_scale * speed.mean(axis=1), self.lateral * rate
        yaw = start[2] + _cumulated(rate, dt)
        c, s = np.cos(yaw), np.sin(yaw)
        x, y = _cumulated(c * forward - s * left, dt), _cumulated(s * forward + c * left, dt)
        return np.column_stack([start[0] + x, start[1] + y, yaw])


def _cumulated(rate: Array, dt: float) -> Array:
    """Integral by the trapezoidal rule, from 0."""
    return np.concatenate(([0.0], np.cumsum(0.5 * dt * (rate[1:] + rate[:-1]))))


def ideal(robot: Robot) -> Kinematic:
    """Wheels that roll without slip."""
    return Kinematic("ideal", robot.wheel.r_w * robot.drive.front.tau, robot.front.i_y)


def fitted(problem: Problem, names: Sequence[str] = tuple(MODELS)) -> list[Kinematic]:
    """The models fitted to a problem's windows from their measured starts, with the same loss of a sample."""
    robot = problem.parameters.robot
    rolled = robot.wheel.r_w * robot.drive.front.tau
    models = []
    for name in names:
        free = MODELS[name]
        first = {"track": 2.0 * robot.front.i_y, "speed_scale": 1.0, "lateral": 0.0}
        if not free:
            models.append(ideal(robot))
            continue

        def residual(values: Array, name: str = name, free: Sequence[str] = free) -> Array:
            model = Kinematic(name, rolled, **dict(zip(free, values.tolist(), strict=True)))
            return np.concatenate(model.predict(problem, problem.starts))

        found = least_squares(residual, [first[key] for key in free], loss="huber", f_scale=SAMPLE_BEND, x_scale=0.1)
        models.append(Kinematic(name, rolled, **dict(zip(free, found.x.tolist(), strict=True))))
    return models
