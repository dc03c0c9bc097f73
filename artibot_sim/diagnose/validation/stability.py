"""Whether what was fitted is the same all the time, at all speeds, in all recordings: what is not has another cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, free_parameters
from artibot_sim.estimation.solver import Reduced, reduce
from artibot_sim.experiment.measured import forward_speed

Array = NDArray[np.float64]


def drifts(problem: Problem, fit: Fit) -> dict[str, float]:
    """Nats by which each fitted effect would explain more if its size changed evenly with time, speed or turn rate.

    Parameters
    ----------
    problem : Problem
        With the effects among its parameters.
    fit : Fit
        Its end.

    Returns
    -------
    dict of str to float
        By effect, with whichever of the three explains most: time since the start, size of the forward speed, of the
        turn rate, all as means of windows. The normal equations tell, with soil and starts as free as in the fit;
        nothing is fitted again.
    """
    parameters = problem.parameters
    if not parameters.extensions:
        return {}
    along = [(one - one.mean()) / max(float(one.std()), 1e-9) for one in _conditions(problem).T]
    free, reduced = _equations(problem, fit)
    return {
        extension.effect.id: max(
            _gained(problem, fit, free, reduced, range(len(parameters))[part], one[:, None]) for one in along
        )
        for extension, part in zip(parameters.extensions, parameters.places, strict=True)
    }


def _conditions(problem: Problem) -> Array:
    """Time since the start (s), size of forward speed (m/s) and of turn rate (rad/s) in all windows, (windows, 3)."""
    found = []
    for window, duration in zip(problem.windows, problem.durations, strict=True):
        times, motion = problem.stretches[window.stretch].motion
        inside = np.nan_to_num(motion[(times >= window.t) & (times <= window.t + duration)])
        speed, rate = np.abs(forward_speed(inside)).mean(), np.abs(inside[:, 5]).mean()
        found.append((window.t + 0.5 * duration, speed, rate))
    return np.array(found)


def disagreement(problem: Problem, fit: Fit) -> float:
    """Nats by which all that was fitted would explain more if it had other values in each recording; mu_s has no say.

    Parameters and result as in `drifts`; 0 for a single recording. No window counts as an exception: where recordings
    contradict each other, a firm loss follows one of them, and what the others say has no weight any more.
    """
    names, recording = problem.recordings
    if len(names) < 2:
        return 0.0
    free, reduced = _equations(problem, replace(fit, loss=replace(fit.loss, firm=False)))
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
    gradient = reduced.gradient.sum(axis=0) + (prior @ fit.point.coordinates)[free]
    beside = np.einsum("wij,wc->icj", reduced.matrices[:, :, own], along).reshape(len(free), -1)
    both = np.einsum("wij,wc,wd->cidj", reduced.matrices[:, own][:, :, own], along, along, optimize=True)
    size = beside.shape[1]
    wide = np.block([[matrix, beside], [beside.T, both.reshape(size, size)]])
    wider = np.concatenate([gradient, np.einsum("wi,wc->ci", reduced.gradient[:, own], along).ravel()])
    return _gain(wide, wider) - _gain(matrix, gradient)


def _gain(matrix: Array, gradient: Array) -> float:
    """Nats between here and where the normal equations lead; directions of which nothing is known lead nowhere."""
    return float(0.5 * gradient @ np.linalg.lstsq(matrix, gradient, rcond=1e-12)[0])
