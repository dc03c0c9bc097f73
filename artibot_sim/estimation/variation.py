"""Parameters that differ from window to window: how much, and whether the data ask for it.

Ground is not the same everywhere. A model with one friction coefficient for a whole field then misses every window by
another amount, and no law is missing. Here a parameter has a value of its own in each window, drawn from a normal
distribution about a common middle. What each window says of it is known from a linearised fit, its start eliminated
(`solver.reduce`), so these values are integrated over in closed form, and only the distribution's width is left.

Against that stands noise of any size with heavy tails: a window may be badly predicted as a whole for many reasons.
Only windows whose errors have the shape that the parameter would give them speak for a spread.

Values may be alike in windows that are near each other in time or in place, or in all of a recording: then it is known
where the next one lies. That is a Gaussian process over the windows, whose length is the likeliest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
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
    information, gradient : array, shape (w,)
        Second and first derivative of half the sum of squares by the parameter's coordinate, the start eliminated.
    squares : array, shape (w,)
        The sum of squares itself.
    counts : array, shape (w,)
        Of how many independent samples.
    """

    information: Array
    gradient: Array
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
        n, tails = self.counts, _TAILS
        wider, left = self._left(spread, level, shift)
        return np.asarray(
            gammaln(0.5 * (tails + n)) - gammaln(0.5 * tails) - 0.5 * n * np.log(tails) - n * np.log(level)
            - 0.5 * np.log(wider) - 0.5 * (tails + n) * np.log1p(left / tails)
        )  # fmt: skip

    def _left(self, spread: float, level: float, shift: float) -> tuple[Array, Array]:
        """How much wider the parameter makes each window, and its squares beside the parameter's likeliest value."""
        h, g = self.information / level**2, (self.gradient + self.information * shift) / level**2
        squares = (self.squares + (2.0 * self.gradient + self.information * shift) * shift) / level**2
        wider = 1.0 + spread**2 * h
        return wider, np.maximum(squares - spread**2 * g**2 / wider, 0.0)

    def values(self, spread: float, level: float, shift: float) -> tuple[Array, Array]:
        """Each window's own value about the middle, and its variance, (w,); a window with large errors says little."""
        _, left = self._left(spread, level, shift)
        variance = level**2 * (_TAILS + left) / (_TAILS + self.counts)
        information = np.maximum(self.information, 1e-12)
        return -self.gradient / information - shift, variance / information


def joined(parts: Sequence[Windows]) -> Windows:
    """The windows of several problems, one after the other."""
    return Windows(*(np.concatenate([vars(one)[name] for one in parts]) for name in Windows.__annotations__))


@dataclass(frozen=True)
class ParameterSpread:
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


def spread_of(windows: Windows) -> ParameterSpread:
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
    return ParameterSpread(spread, level, shift, max(float(none.fun - best.fun), 0.0), without)


@dataclass(frozen=True)
class Distances:
    """How far windows are from each other, shape (w, w); infinite where that is not known.

    Attributes
    ----------
    recording : array
        0 within a recording.
    time, place : array
        s within a recording, and m in a map that is common to all.
    """

    recording: Array
    time: Array
    place: Array

    @classmethod
    def of(cls, recording: NDArray[np.int64], t: Array, place: Array | None) -> Distances:
        """Of windows that begin at `t` (w,), s, and at `place` (w, 2), m, of recordings with these numbers (w,)."""
        same = np.where(recording[:, None] == recording[None, :], 0.0, np.inf)
        away = np.full_like(same, np.inf)
        if place is not None:
            away = np.hypot(*np.moveaxis(place[:, None] - place[None, :], -1, 0))
        return cls(same, np.abs(t[:, None] - t[None, :]) + same, away)


@dataclass(frozen=True)
class Correlation:
    """How values of a parameter are alike in windows near each other.

    Attributes
    ----------
    over : str
        ``"time"``, ``"place"`` or ``"recording"``: what windows are near in.
    length : float
        s or m over which they are alike; infinite within a recording.
    share : float
        Of their variance that near windows have in common.
    nats : float
        By how much windows are likelier so than with values that know nothing of each other.
    """

    over: str
    length: float
    share: float
    nats: float

    def correlation(self, distances: Distances) -> Array:
        """Of the windows' values, shape (w, w)."""
        away = getattr(distances, self.over)
        near = (away == 0.0).astype(float) if np.isinf(self.length) else np.exp(-away / self.length)
        return np.asarray(self.share * near + (1.0 - self.share) * np.eye(len(away)))

    def gained(self, windows: Windows, distances: Distances, spread: ParameterSpread) -> Array:
        """Nats by which each window is likelier, given those before it, than without them, shape (w,)."""
        value, variance = windows.values(spread.spread, spread.level, spread.shift)
        own = np.eye(len(value))
        return _given_those_before(value, variance, spread.spread**2 * self.correlation(distances)) - (
            _given_those_before(value, variance, spread.spread**2 * own)
        )


_SHARES = (0.3, 0.5, 0.7, 0.9, 0.99)
_LENGTHS = 10


def correlation_of(windows: Windows, distances: Distances, spread: ParameterSpread) -> Correlation | None:
    """How values that differ from window to window are alike in windows near each other, the likeliest way."""
    found = [Correlation("recording", np.inf, share, 0.0) for share in _SHARES]
    for over in ("time", "place"):
        away = getattr(distances, over)
        known = away[np.isfinite(away) & (away > 0.0)]
        if len(known):
            nearest = np.where(away > 0.0, away, np.inf).min(axis=1)
            shortest = float(np.median(nearest[np.isfinite(nearest)]))
            lengths = np.geomspace(shortest, known.max(), _LENGTHS).tolist()
            found += [Correlation(over, length, share, 0.0) for length in lengths for share in _SHARES]
    gains = [float(one.gained(windows, distances, spread).sum()) for one in found]
    best = int(np.argmax(gains))
    return replace(found[best], nats=gains[best]) if gains[best] > 0.0 else None


def _given_those_before(value: Array, variance: Array, covariance: Array) -> Array:
    """Log-density of each of some normal values (w,), known to `variance` (w,), given those before it, nats."""
    factor = np.linalg.cholesky(covariance + np.diag(variance))
    scaled = solve_triangular(factor, value, lower=True)
    return np.asarray(-0.5 * (scaled**2 + np.log(2.0 * np.pi)) - np.log(np.diag(factor)))


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
