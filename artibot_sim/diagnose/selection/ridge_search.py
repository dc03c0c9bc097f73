"""Ridge search: an effect's sizes are changed together with the soil that goes with them.

Some effects and the soil explain nearly the same, a payload and less friction for one: the likelihood has a ridge, and
steps end where the jagged loss holds them, far from its top.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge, free_parameters
from artibot_sim.estimation.solver import evaluate, reduce
from artibot_sim.estimation.surroundings import moved_points

Array = NDArray[np.float64]

_FINE = np.array([-0.02, -0.01, -0.005, 0.0, 0.005, 0.01, 0.02])
"""Changes of mu_s beside a size that is known, as logarithms."""
_FAR = (0.5, 1.7, 3.0)
"""Factors on an effect's coordinates for far sizes,"""
_WIDE = np.linspace(-0.3, 0.3, 13)
"""and changes of mu_s beside."""


def from_far_sizes(problem: Problem, loss: Loss, fit: Fit, steps: int) -> Fit:
    """The best of the fit and others that begin at far other sizes of the last effect, some steps each.

    Where the loss is jagged no place on the way is better, and none of the far ones before it has been fitted.
    """
    if not problem.parameters.extensions:
        return fit
    last = problem.parameters.places[-1]
    own = fit.point.coordinates[last]
    fits = [fit]
    for factor in _FAR:
        places = moved_points(problem, loss, fit, last, (factor - 1.0) * own, _WIDE)
        fits.append(converge(problem, min(places, key=lambda p: p.cost), loss, steps))
    return min(fits, key=lambda one: one.point.cost)


def at_size(problem: Problem, fit: Fit, extension: Extension, own: Array, steps: int) -> tuple[Problem, Fit]:
    """The fit with one more effect, begun at its coordinates (k,) with the soil that goes with them."""
    more = with_effect(problem, extension)
    point = evaluate(more, fit.loss, [np.concatenate([fit.point.coordinates, np.zeros(len(own))])], fit.point.starts)[0]
    free = free_parameters(more)
    residuals, sensitivity = more.linearised(point.coordinates, point.starts, free)
    neutral = Fit(point, fit.loss, reduce(more, fit.loss, residuals, sensitivity, point.starts), free, False)
    begun = min(
        moved_points(more, fit.loss, neutral, more.parameters.places[-1], own, _FINE), key=lambda place: place.cost
    )
    return more, converge(more, begun, fit.loss, steps)
