"""What noise of the measured rotations adds to a fit's cost: a model that answers them less is not the truer for it.

The steps of encoders go through the contact into predicted torques (`identify/noisy_inputs.py`). Back wheels with less
grip, say, make less of that noise, and so a better fit of recordings with nothing hidden.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from artibot_sim.diagnose.contest import Rival
from artibot_sim.identify.noisy_inputs import answers, with_noisy_inputs
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.search import Fit

Array = NDArray[np.float64]


def excess_of(problem: Problem, fit: Fit, rivals: Sequence[Rival], seed: int) -> list[float]:
    """Cost that the noise makes in `fit` and not in each rival, all fitted under the same loss; never negative.

    A rival that answers the noise more gets nothing for it: fits were not made to weigh that.
    """
    noisy = with_noisy_inputs(problem, seed)
    mine = answers(problem, noisy, fit.point)
    counts = np.sum([window.counts for window in problem.windows], axis=0) / fit.loss.thinning
    found = []
    for rival in rivals:
        theirs = noisy.with_parameters(rival.problem.parameters)
        less = mine - answers(rival.problem, theirs, rival.fit.point)
        total = sum(n * _usual(column) for n, column in zip(counts, less.T, strict=True) if n > 0.0)
        found.append(max(0.0, float(total)))
    return found


def _usual(values: Array) -> float:
    """Mean (of numbers, NaN left out) without the largest and the smallest fifth: windows that took another branch."""
    known = values[np.isfinite(values)]
    return float(trim_mean(known, 0.2)) if len(known) else 0.0
