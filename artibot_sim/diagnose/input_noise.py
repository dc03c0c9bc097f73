"""What noise of the measured rotations adds to a fit's cost: a model that answers them less is not the truer for it.

Motors are turned as encoders saw them, and the steps of encoders go through the contact into predicted torques. Back
wheels with less grip, say, make less of that noise, and so a better fit of recordings with nothing hidden. How much it
is is found by simulating once more with as much noise again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from artibot_sim.diagnose.contest import Rival
from artibot_sim.diagnose.options import HALF_WIDTH
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.local_fit import noise_of
from artibot_sim.experiment.motor_inputs import rotations
from artibot_sim.identify.gauss_newton import Point
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.search import Fit
from artibot_sim.identify.sensing import Stretch
from artibot_sim.identify.windows import CHANNEL_NAMES
from artibot_sim.model import Robot

Array = NDArray[np.float64]

_LARGEST = 2.0
"""Change of a residual, in units of the sensor's noise, beyond which a wheel broke away at another instant: chance."""


@dataclass(frozen=True)
class NoisyInputs:
    """The same recordings with one more draw of their encoders' noise.

    Attributes
    ----------
    stretches : tuple of Stretch
    """

    stretches: tuple[Stretch, ...]

    def blocks(self, problem: Problem, point: Point) -> Array:
        """Mean squares of what the noise changes in residuals, shape (windows, channels); NaN where nothing is."""
        plain = problem.residuals([point.coordinates], point.starts)[0]
        other = replace(problem, stretches=self.stretches).residuals([point.coordinates], point.starts)[0]
        table = np.full((len(problem), len(CHANNEL_NAMES)), np.nan)
        for i, (window, a, b) in enumerate(zip(problem.windows, plain, other, strict=True)):
            change = np.minimum(np.abs(b - a), _LARGEST)
            total = np.bincount(window.channel, change**2, minlength=len(CHANNEL_NAMES))
            table[i] = np.where(window.counts > 0, total / np.maximum(window.counts, 1.0), np.nan)
        return table

    def excess(self, problem: Problem, fit: Fit, rivals: Sequence[Rival]) -> list[float]:
        """Cost that the noise makes in `fit` and not in each rival, all fitted under the same loss; never negative.

        A rival that answers the noise more gets nothing for it: fits were not made to weigh that.
        """
        mine = self.blocks(problem, fit.point)
        counts = np.sum([window.counts for window in problem.windows], axis=0) / fit.loss.thinning
        found = []
        for rival in rivals:
            less = mine - self.blocks(rival.problem, rival.fit.point)
            total = sum(n * _usual(column) for n, column in zip(counts, less.T, strict=True) if n > 0.0)
            found.append(max(0.0, float(total)))
        return found


def _usual(values: Array) -> float:
    """Mean (of numbers, NaN left out) without the largest and the smallest fifth: windows that took another branch."""
    known = values[np.isfinite(values)]
    return float(trim_mean(known, 0.2)) if len(known) else 0.0


def noisy_inputs(stretches: Sequence[Stretch], robot: Robot, seed: int) -> NoisyInputs:
    """Draw noise as large as neighbouring samples of the motors show it, and smooth the sum as before."""
    rng = np.random.default_rng([seed, 5])
    noisy: dict[str, Experiment] = {}
    found = []
    for stretch in stretches:
        own = stretch.experiment
        if str(own.path) not in noisy:
            motors = _with_noise(own.channels["motor_torques"], rng)
            noisy[str(own.path)] = replace(own, channels={**own.channels, "motor_torques": motors})
        t = stretch.inputs.t
        inputs = rotations(noisy[str(own.path)], robot, float(t[0]), float(t[-1]), HALF_WIDTH)
        found.append(replace(stretch, inputs=inputs))
    return NoisyInputs(tuple(found))


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
