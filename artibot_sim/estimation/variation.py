"""Parameters that differ from window to window: how much, and whether the data ask for it.

Ground is not the same everywhere. A model with one friction coefficient for a whole field then misses every window by
another amount, and no law is missing. Here a parameter has a value of its own in each window, drawn from a normal
distribution about a common middle. What each window says of it is known from a linearised fit, its start eliminated
(`solver.reduce`), so these values are integrated over in closed form, and only the distribution's width is left.

Against that stands noise of any size with heavy tails: a window may be badly predicted as a whole for many reasons.
Only windows whose errors have the shape that the parameter would give them speak for a spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import gammaln

from artibot_sim.estimation.kernels import sample_weights
from artibot_sim.estimation.loss import SAMPLE_BEND
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.solver import eliminated

Array = NDArray[np.float64]

_TAILS = 4.0
"""Degrees of freedom of the noise: as heavy as those of real poses (`pose_noise`)."""
_SPREADS = (0.01, 0.1, 1.0)
"""Widths, as coordinates, from which the search begins."""
_LONGEST = 40.0
"""Largest logarithm of the ratio of two widths or levels that is looked at."""


@dataclass(frozen=True)
class Windows:
    """What each of w windows says of one parameter, in units of noise.

    Attributes
    ----------
    information, pull : array, shape (w,)
        Second and first derivative of half the sum of squares by the parameter's coordinate, the start eliminated.
    squares : array, shape (w,)
        The sum of squares itself.
    counts : array, shape (w,)
        Of how many independent samples.
    """

    information: Array
    pull: Array
    squares: Array
    counts: Array

    def log_likelihood(self, spread: float, level: float, shift: float) -> Array:
        """Of each window, nats, shape (w,): the parameter's own value in it integrated over.

        Parameters
        ----------
        spread : float
            Standard deviation of the parameter's coordinate.
        level : float
            Size of the noise, over what it is taken to be.
        shift : float
            Of the coordinates' middle.
        """
        h, n, tails = self.information / level**2, self.counts, _TAILS
        g = (self.pull + self.information * shift) / level**2
        squares = (self.squares + (2.0 * self.pull + self.information * shift) * shift) / level**2
        wider = 1.0 + spread**2 * h
        left = np.maximum(squares - spread**2 * g**2 / wider, 0.0)
        return np.asarray(
            gammaln(0.5 * (tails + n)) - gammaln(0.5 * tails) - 0.5 * n * np.log(tails) - n * np.log(level)
            - 0.5 * np.log(wider) - 0.5 * (tails + n) * np.log1p(left / tails)
        )  # fmt: skip


@dataclass(frozen=True)
class Spread:
    """How much a parameter differs from window to window.

    Attributes
    ----------
    spread : float
        Standard deviation of its coordinate.
    level, shift : float
        Size of the noise beside it, and where the middle lies from the fit's.
    nats : float
        By how much the windows are likelier than with none, and noise of any size.
    alone : (float, float)
        Level and shift with none.
    """

    spread: float
    level: float
    shift: float
    nats: float
    alone: tuple[float, float]

    def gained(self, windows: Windows) -> Array:
        """Nats by which other windows are likelier with this spread than without, each, shape (w,)."""
        with_it = windows.log_likelihood(self.spread, self.level, self.shift)
        return with_it - windows.log_likelihood(0.0, *self.alone)


def spread_of(windows: Windows) -> Spread:
    """The spread with which windows are likeliest."""
    scale = 1.0 / np.sqrt(max(float(np.mean(windows.information)), 1e-12))

    def alone(x: Array) -> float:
        return -float(windows.log_likelihood(0.0, float(np.exp(x[0])), scale * float(x[1])).sum())

    def varied(x: Array) -> float:
        if np.abs(x[:2]).max() > _LONGEST:
            return np.inf
        found = windows.log_likelihood(float(np.exp(x[2])), float(np.exp(x[0])), scale * float(x[1]))
        return -float(found.sum())

    none = minimize(alone, np.zeros(2), method="Nelder-Mead")
    ends = [
        minimize(varied, [*none.x, np.log(first)], method="Nelder-Mead", options={"maxiter": 2000})
        for first in _SPREADS
    ]
    best = min(ends, key=lambda end: float(end.fun))
    level, shift, spread = float(np.exp(best.x[0])), scale * float(best.x[1]), float(np.exp(best.x[2]))
    without = float(np.exp(none.x[0])), scale * float(none.x[1])
    return Spread(spread, level, shift, max(float(none.fun - best.fun), 0.0), without)


def windows_of(
    problem: Problem, coordinates: Array, starts: Array, thinning: Array, which: Sequence[int]
) -> list[Windows]:
    """What the windows of a problem say of each of the parameters numbered `which`, the others as they are.

    Parameters
    ----------
    coordinates : array, shape (p,)
    starts : array, shape (windows, 8 or 6)
        Near those that fit best; each window takes the rest of the way in the elimination.
    thinning : array, shape (channels,)
        How many samples of a channel are worth one.
    which : sequence of int
    """
    residuals, sensitivity = problem.linearised(coordinates, starts, which)
    weight = np.empty(len(residuals.flat))
    factor = np.tile(1.0 / thinning, (len(problem), 1))
    sample_weights(problem.samples, residuals.flat, 1.0, SAMPLE_BEND, factor, weight)
    reduced, squares = eliminated(problem, weight, residuals, sensitivity, starts)
    counts = (problem.samples.counts / thinning).sum(axis=1)
    return [Windows(reduced.matrices[:, k, k], reduced.gradient[:, k], squares, counts) for k in range(len(which))]
