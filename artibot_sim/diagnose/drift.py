"""Whether the size of what is named stays the same: what grows or fades on the way has another cause."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.gauss_newton import reduce
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.search import Fit, free_parameters

Array = NDArray[np.float64]


def drifts(problem: Problem, fit: Fit) -> dict[str, float]:
    """Nats by which each fitted effect would explain more if its size changed evenly with the time since the start.

    Parameters
    ----------
    problem : Problem
        With the effects among its parameters.
    fit : Fit
        Its end.

    Returns
    -------
    dict of str to float
        By effect. The normal equations tell, with soil and starts as free as in the fit; nothing is fitted again.
    """
    parameters, point, free = problem.parameters, fit.point, list(free_parameters(problem))
    residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    reduced = reduce(problem, fit.loss, residuals, sensitivity, point.starts)
    since = np.array([window.t for window in problem.windows]) + 0.5 * problem.durations  # when they are half over
    since = (since - since.mean()) / max(float(since.std()), 1e-9)
    prior = parameters.prior_information
    matrix = reduced.matrix + prior[np.ix_(free, free)]
    pull = reduced.gradient.sum(axis=0) + (prior @ point.coordinates)[free]
    along, twice = (np.einsum("wij,w->ij", reduced.matrices, since**power) for power in (1, 2))
    pulled = since @ reduced.gradient
    found, steady = {}, _gain(matrix, pull)
    for extension, part in zip(parameters.extensions, parameters.places, strict=True):
        own = [free.index(i) for i in range(len(parameters))[part]]
        wide = np.block([[matrix, along[:, own]], [along[own], twice[np.ix_(own, own)]]])
        found[extension.effect.id] = _gain(wide, np.concatenate([pull, pulled[own]])) - steady
    return found


def _gain(matrix: Array, pull: Array) -> float:
    """Nats between here and where the normal equations lead."""
    return float(0.5 * pull @ np.linalg.solve(matrix, pull))
