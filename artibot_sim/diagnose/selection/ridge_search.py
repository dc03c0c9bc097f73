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
from artibot_sim.estimation.solver import Point, evaluate, reduce, step
from artibot_sim.estimation.surroundings import moved_points

Array = NDArray[np.float64]

_FACTORS = (0.6, 0.75, 0.88, 1.14, 1.33, 1.7)
"""Of the effect's coordinates."""
_SMALL = 0.2
_STEPS = (-0.3, -0.16, -0.08, 0.08, 0.16, 0.3)
"""Coordinates so near to neutral are changed by steps instead: the soil may have taken nearly all of an effect."""
_GRIPS = np.log1p(np.array([-0.2, -0.12, -0.06, 0.0, 0.06, 0.12, 0.2]))
"""Changes of mu_s beside, as logarithms."""
_FINE = np.array([-0.02, -0.01, -0.005, 0.0, 0.005, 0.01, 0.02])
"""Changes of mu_s beside, as logarithms, where the effect declares how mu_s goes with it."""
_FAR = (0.5, 1.7, 3.0)
"""Factors on an effect's coordinates for far sizes,"""
_WIDE = np.linspace(-0.3, 0.3, 13)
"""and changes of mu_s beside."""
_TRIED = 2
"""So many places are polished by a step before they are compared."""


def along_ridge(problem: Problem, loss: Loss, fit: Fit, which: int = -1) -> Point:
    """The best place along the ridge of an effect, the fit's own if none is better or there is no effect."""
    parameters, point, free = problem.parameters, fit.point, list(fit.free)
    if not parameters.extensions:
        return point
    mine = parameters.places[which]
    own = point.coordinates[mine]
    grips = _FINE if parameters.extensions[which].search.ridge else _GRIPS
    places = [place for move in _moves(own) for place in moved_points(problem, loss, fit, mine, move, grips)]
    found = sorted(places, key=lambda p: p.cost)
    ends = [step(problem, loss, place, free)[0] for place in found[:_TRIED]]
    return min([point, *ends], key=lambda p: p.cost)


def along_earlier_ridges(problem: Problem, fit: Fit, steps: int, worth: float) -> Fit:
    """The fit after a search along all ridges but the last effect's: the others were fitted without that one.

    Some steps follow a search that gains what is `worth` it, nats.
    """
    for which in range(len(problem.parameters.extensions) - 1):
        lower = along_ridge(problem, fit.loss, fit, which)
        if lower.cost < fit.point.cost - 2.0 * worth:
            fit = converge(problem, lower, fit.loss, steps)
    return fit


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


def _moves(own: Array) -> list[Array]:
    """Changes of an effect's coordinates (k,): of all together, and of each alone where there are several."""
    if len(own) == 1:
        return _along(own, np.ones(1))
    eye = np.eye(len(own))
    alone = [move for size, axis in zip(own, eye, strict=True) for move in _along(size * axis, axis)]
    return _along(own, eye[0]) + alone


def _along(part: Array, axis: Array) -> list[Array]:
    """Changes along a part of the coordinates (k,), or along an axis (k,) where that is none."""
    length = float(np.linalg.norm(part))
    if length > _SMALL:
        return [(factor - 1.0) * part for factor in _FACTORS]
    direction = part / length if length else axis
    return [change * direction for change in _STEPS]


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
