"""How much the data speak for an effect: log-likelihood gained, less what its freedom would gain by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.contest import Rival
from artibot_sim.diagnose.hypotheses import Hypothesis
from artibot_sim.identify.extension import SPREAD
from artibot_sim.identify.gauss_newton import reduce
from artibot_sim.identify.search import free_parameters

Array = NDArray[np.float64]

DECADE = float(np.log(10.0))
"""Nats of a factor of ten."""


@dataclass(frozen=True)
class Evidence:
    """What one view says about an effect that was fitted.

    Attributes
    ----------
    gained : float
        Nats of log-likelihood over the baseline.
    occam : float
        Nats that its freedom costs (Laplace's approximation): negative.
    own : array, shape (k,)
        The effect's coordinates.
    covariance : array, shape (k, k)
    """

    gained: float
    occam: float
    own: Array
    covariance: Array

    @property
    def nats(self) -> float:
        """Logarithm of the Bayes factor."""
        return self.gained + self.occam

    @property
    def away(self) -> float:
        """How many standard deviations the effect is from neutral."""
        squared = float(self.own @ np.linalg.solve(self.covariance, self.own))
        return max(0.0, squared) ** 0.5


def evidence(rival: Rival, baseline_cost: float) -> Evidence:
    """The evidence of the view that is driven by rotations; both were fitted under the same loss."""
    problem, point, loss = rival.problem, rival.fit.point, rival.fit.loss
    free = free_parameters(problem)
    residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    reduced = reduce(problem, loss, residuals, sensitivity, point.starts)
    prior = problem.parameters.prior_information
    covariance = np.asarray(np.linalg.inv(reduced.matrix + prior[np.ix_(list(free), list(free))]), float)
    size = len(rival.own)
    mine = covariance[-size:, -size:]
    return Evidence(0.5 * (baseline_cost - point.cost), occam(rival.trial.hypothesis, mine), rival.own, mine)


def occam(hypothesis: Hypothesis, covariance: Array) -> float:
    """Logarithm of posterior over prior volume of an effect's coordinates, and of the choices made for it."""
    sd = np.minimum(np.sqrt(np.diag(covariance)), SPREAD)
    correlation = covariance / np.outer(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(covariance)))
    volume = float(np.log(sd / SPREAD).sum()) + 0.5 * float(np.linalg.slogdet(correlation)[1])
    sides = np.log(2.0) * len(covariance) if hypothesis.extension.one_sided else 0.0
    return min(0.0, volume + sides - float(np.log(hypothesis.among)))
