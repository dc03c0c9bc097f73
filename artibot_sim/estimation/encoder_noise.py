"""What noise of the measured rotations, which turn the model's motors, does to predictions and to a fit's loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.parameters import ParameterSet
from artibot_sim.estimation.problem import Draw, Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.solver import Point, evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.inputs import rotations
from artibot_sim.experiment.smoothing import noise_of

# ----------------------------------------------------------------------
# One more draw of the encoders' noise: what noise of the measured rotations does to predictions.
#
# Motors are turned as encoders saw them, and the steps of encoders go through the contact into predicted torques.
# How much noise that makes is found by simulating once more with as much noise again.
# ----------------------------------------------------------------------


_LARGEST = 2.0
"""Change of a residual, in units of the sensor's noise, beyond which a wheel broke away at another instant: chance."""


def with_noisy_inputs(problem: Problem, number: int) -> Problem:
    """A problem whose recordings have one more draw of their encoders' noise.

    As large as neighbouring samples of the motors show it, and smoothed with them as before.
    """
    rng = problem.generator(Draw.ENCODER_NOISE, number)
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


# ----------------------------------------------------------------------
# How much of a fit's loss the encoders' noise makes, as a function of its coordinates.
#
# With x the rotations, n their noise and f what the model predicts from them, a sum of squares holds (f'(x) n)²
# beside what it should. That term falls where the model answers rotations less, so the least sum of squares lies
# there: back wheels with too little grip, forces too small. What is to be least is the sum of squares less that
# term (a corrected score; Carroll et al., Measurement Error in Nonlinear Models). (f' n)² is simulated with drawn
# noise, its logarithm taken as linear in the coordinates: forces go with stiffnesses, so it goes with their
# squares.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

_DRAWS = 2
"""Of noise."""
_STEP = 0.03
"""Change of a coordinate for a slope."""
_USUAL = 3.0
"""Times the middle window's, beyond which a wheel broke away at another instant: chance."""
_STEEPEST = 3.0
"""Largest slope of a logarithm: more than squares go is chance, too."""
_MEDIAN = 1.4826 * 1.2533
"""From a median's absolute deviation times the root of the number to its standard error."""
_FARTHEST = 0.7
"""Change of the logarithm beyond which nothing is extrapolated."""


@dataclass(frozen=True)
class NoiseShare:
    """The term around a fit.

    Attributes
    ----------
    middle : array, shape (p,)
        Coordinates of the fit.
    sizes : array, shape (windows, channels)
        What it adds to losses there.
    slopes : array, shape (p, channels)
        How its logarithm goes with the coordinates.
    """

    middle: Array
    sizes: Array
    slopes: Array

    def _sizes_at(self, coordinates: Array) -> Array:
        rise = np.clip((coordinates - self.middle) @ self.slopes, -_FARTHEST, _FARTHEST)
        return np.asarray(self.sizes * np.exp(rise), float)

    def losses(self, coordinates: Array) -> Array:
        """What it adds to each window's loss, shape (windows,)."""
        return np.asarray(self._sizes_at(coordinates).sum(axis=1), float)

    def cost_without(self, point: Point) -> float:
        """The cost of a point, less what it adds."""
        return point.cost - float(self.losses(point.coordinates).sum())

    def gradients(self, coordinates: Array, free: Sequence[int]) -> Array:
        """Its gradients by window, shape (windows, f), in the units of `Reduced.gradient`: half a loss's."""
        return np.asarray(0.5 * self._sizes_at(coordinates) @ self.slopes[list(free)].T, float)


def noise_share(problem: Problem, fit: Fit) -> NoiseShare:
    """Simulate with noise drawn anew, at the fit and beside it in each coordinate."""
    draws = [with_noisy_inputs(problem, number) for number in range(_DRAWS)]
    middle = fit.point.coordinates
    here = _blocks(draws, problem, fit, middle)
    limit = _USUAL * np.median(here, axis=0)
    slopes = np.zeros((len(middle), here.shape[1]))
    for i in _changing(problem.parameters):
        sides = []
        for side in (1.0, -1.0):
            moved = middle.copy()
            moved[i] += side * _STEP
            sides.append(_blocks(draws, problem, fit, problem.parameters.inside(moved)))
        slopes[i] = _slopes(sides[0], sides[1], limit)
    counts = np.array([window.counts for window in problem.windows]) / fit.loss.thinning
    return NoiseShare(middle, np.minimum(here, limit) * counts, np.clip(slopes, -_STEEPEST, _STEEPEST))


def _slopes(above: Array, below: Array, limit: Array) -> Array:
    """Slopes of logarithms by channel, (channels,), from blocks (windows, channels) on both sides.

    The window in the middle says it, less what its scatter makes of nothing: in single windows a wheel breaks away on
    one side and not on the other, and noise seems to grow with whatever was changed.
    """
    found = np.zeros(above.shape[1])
    for c in range(len(found)):
        sound = (above[:, c] > 0.0) & (below[:, c] > 0.0) & (above[:, c] < limit[c]) & (below[:, c] < limit[c])
        if not sound.any():
            continue
        each = np.log(above[sound, c] / below[sound, c]) / (2.0 * _STEP)
        middle = float(np.median(each))
        error = _MEDIAN * float(np.median(np.abs(each - middle))) / np.sqrt(len(each))
        found[c] = middle * max(0.0, 1.0 - (error / max(abs(middle), 1e-12)) ** 2)
    return found


def _changing(parameters: ParameterSet) -> list[int]:
    """Coordinates that the rover feels: what only a sensor says makes the model answer rotations no more or less."""
    own = len(parameters.parameters)
    sizes = [(len(extension), extension.effect.sensor is None) for extension in parameters.extensions]
    real_sizes = np.repeat([real for _, real in sizes], [size for size, _ in sizes]).astype(bool)
    return [*range(own), *(own + np.flatnonzero(real_sizes)).tolist()]


def _blocks(draws: Sequence[Problem], problem: Problem, fit: Fit, coordinates: Array) -> Array:
    """Mean squares of what the noise changes in residuals, shape (windows, channels); 0 where nothing is measured."""
    point = evaluate(problem, fit.loss, [coordinates], fit.point.starts)[0]
    return np.nan_to_num(np.mean([answers(problem, noisy, point) for noisy in draws], axis=0))
