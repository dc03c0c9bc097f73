"""Whether what is to be named says more of held-out windows than ground that varies does by itself.

A law that is not linear is another one in the mean over many soils, so that an effect may describe that mean and
predict better with nothing missing. Both models therefore compete with a spread of their own from window to window, the
likeliest one in fitted windows: windows are what counts, not samples, for a window's soil errs in all of its samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.policy import FALSE_ALARM_RATE
from artibot_sim.diagnose.validation.error_budget import as_fitted, candidates, held_windows, levels_of, sum_interval
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.variation import spread_of, windows_of
from artibot_sim.identify.validation import PredictedRecording

Array = NDArray[np.float64]

Model = tuple[Problem, Fit, Sequence[PredictedRecording]]
"""A fit, and held-out recordings as it predicts them."""
_FEWEST = 12
"""Held-out windows without which nothing is sure."""


def beside_varying_ground(
    without: Model, with_it: Model, seed: int, false_alarms: float = FALSE_ALARM_RATE
) -> tuple[float, float]:
    """Nats by which held-out windows are likelier with what is to be named: an interval from windows drawn anew.

    Parameters
    ----------
    without, with_it : Model
        The paper's model with its soil identified, and the one with effects, whose noise both have.
    seed : int
    false_alarms : float
        Probability outside the interval.
    """
    problem, fit, held = with_it
    if sum(len(one.windows) for one in held) < _FEWEST:
        return -np.inf, np.inf
    levels, thinning = levels_of(problem), fit.loss.thinning
    gained = _likelihoods(with_it, levels, thinning) - _likelihoods(without, levels, thinning)
    return sum_interval(gained, seed, false_alarms)


def _likelihoods(model: Model, levels: Array, thinning: Array) -> Array:
    """Log-likelihood of each held-out window (n,), the parameter that varies integrated over, nats."""
    problem, fit, held = model
    alike = problem.rescaled(levels / levels_of(problem))
    which, point = candidates(problem), fit.point
    seen = windows_of(alike, point.coordinates, point.starts, thinning, which)
    spreads = [spread_of(one) for one in seen]
    likely = [one.log_likelihood(s.spread, s.level, s.shift).sum() for one, s in zip(seen, spreads, strict=True)]
    best = int(np.argmax(likely))
    spread = spreads[best]
    problems = [as_fitted(problem, one, levels) for one in held]
    parts = held_windows(problems, point.coordinates, thinning, which[best])
    return np.concatenate([one.log_likelihood(spread.spread, spread.level, spread.shift) for one in parts])
