"""Whether what was fitted is the same all the time and in all recordings: what is not has another cause."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.gauss_newton import Reduced, reduce
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
    parameters = problem.parameters
    since = np.array([window.t for window in problem.windows]) + 0.5 * problem.durations  # when they are half over
    since = (since - since.mean()) / max(float(since.std()), 1e-9)
    free, reduced = _equations(problem, fit)
    return {
        extension.effect.id: _gained(problem, fit, free, reduced, range(len(parameters))[part], since[:, None])
        for extension, part in zip(parameters.extensions, parameters.places, strict=True)
    }


def disagreement(problem: Problem, fit: Fit) -> float:
    """Nats by which all that was fitted would explain more if it had other values in each recording; mu_s has no say.

    Parameters and result as in `drifts`; 0 for a single recording.
    """
    names, recording = problem.recordings
    if len(names) < 2:
        return 0.0
    free, reduced = _equations(problem, fit)
    return _gained(problem, fit, free, reduced, free, (recording[:, None] == np.arange(1, len(names))).astype(float))


def _equations(problem: Problem, fit: Fit) -> tuple[list[int], Reduced]:
    """The free parameters, and the normal equations of all windows."""
    free = list(free_parameters(problem))
    residuals, sensitivity = problem.linearised(fit.point.coordinates, fit.point.starts, free)
    return free, reduce(problem, fit.loss, residuals, sensitivity, fit.point.starts)


def _gained(
    problem: Problem, fit: Fit, free: Sequence[int], reduced: Reduced, which: Sequence[int], along: Array
) -> float:
    """Nats gained by letting the parameters `which` follow covariates, `along` (windows, c), beside their values."""
    own = [free.index(i) for i in which]
    prior = problem.parameters.prior_information
    matrix = reduced.matrix + prior[np.ix_(free, free)]
    pull = reduced.gradient.sum(axis=0) + (prior @ fit.point.coordinates)[free]
    beside = np.einsum("wij,wc->icj", reduced.matrices[:, :, own], along).reshape(len(free), -1)
    both = np.einsum("wij,wc,wd->cidj", reduced.matrices[:, own][:, :, own], along, along, optimize=True)
    size = beside.shape[1]
    wide = np.block([[matrix, beside], [beside.T, both.reshape(size, size)]])
    wider = np.concatenate([pull, np.einsum("wi,wc->ci", reduced.gradient[:, own], along).ravel()])
    return _gain(wide, wider) - _gain(matrix, pull)


def _gain(matrix: Array, pull: Array) -> float:
    """Nats between here and where the normal equations lead; directions of which nothing is known lead nowhere."""
    return float(0.5 * pull @ np.linalg.lstsq(matrix, pull, rcond=1e-12)[0])
