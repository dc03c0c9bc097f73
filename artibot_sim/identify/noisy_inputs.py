"""One more draw of the encoders' noise: what noise of the measured rotations does to predictions.

Motors are turned as encoders saw them, and the steps of encoders go through the contact into predicted torques. How
much noise that makes is found by simulating once more with as much noise again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.local_fit import noise_of
from artibot_sim.experiment.motor_inputs import rotations
from artibot_sim.identify.gauss_newton import Point
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.windows import CHANNEL_NAMES

Array = NDArray[np.float64]

_LARGEST = 2.0
"""Change of a residual, in units of the sensor's noise, beyond which a wheel broke away at another instant: chance."""


def with_noisy_inputs(problem: Problem, seed: int) -> Problem:
    """The same windows of recordings with one more draw of their encoders' noise.

    As large as neighbouring samples of the motors show it, and smoothed with them as before.
    """
    rng = np.random.default_rng([seed, 5])
    noisy: dict[str, Experiment] = {}
    found = []
    for stretch in problem.stretches:
        own = stretch.experiment
        if str(own.path) not in noisy:
            motors = _with_noise(own.channels["motor_torques"], rng)
            noisy[str(own.path)] = replace(own, channels={**own.channels, "motor_torques": motors})
        t = stretch.inputs.t
        robot = problem.parameters.robot
        inputs = rotations(noisy[str(own.path)], robot, float(t[0]), float(t[-1]), stretch.half_width)
        found.append(replace(stretch, inputs=inputs))
    return replace(problem, stretches=tuple(found))


def answers(problem: Problem, noisy: Problem, point: Point) -> Array:
    """Mean squares of what the noise changes in residuals, shape (windows, channels); NaN where nothing is measured.

    Parameters
    ----------
    problem, noisy : Problem
        As measured, and what `with_noisy_inputs` makes of it.
    point : Point
        Of `problem`.
    """
    other = noisy.residuals([point.coordinates], point.starts)[0]
    table = np.full((len(problem), len(CHANNEL_NAMES)), np.nan)
    for i, (window, a, b) in enumerate(zip(problem.windows, point.residuals, other, strict=True)):
        change = np.minimum(np.abs(b - a), _LARGEST)
        total = np.bincount(window.channel, change**2, minlength=len(CHANNEL_NAMES))
        table[i] = np.where(window.counts > 0, total / np.maximum(window.counts, 1.0), np.nan)
    return table


def _with_noise(motors: Channel, rng: np.random.Generator) -> Channel:
    columns = dict(motors.columns)
    for name, values in motors.columns.items():
        if not name.endswith((".position", ".velocity")):
            continue
        level = noise_of(motors.t, values)
        if np.isfinite(level):
            turning = np.abs(np.diff(values, prepend=values[0])) > 0.0  # encoders that stand are silent
            columns[name] = values + np.where(turning, level * rng.standard_normal(len(values)), 0.0)
    return replace(motors, columns=columns)
