"""A walk along the valley of an effect: its size changed, with the soil that goes with it.

Some effects and the soil explain nearly the same, a payload and less friction for one: their steps end where the jagged
loss holds them, far from the valley's lowest place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.gauss_newton import Point, evaluate, step
from artibot_sim.identify.parameters import MU_S
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.search import Fit

Array = NDArray[np.float64]

_FACTORS = (0.6, 0.75, 0.88, 1.14, 1.33, 1.7)
"""Of the effect's coordinates."""
_GRIPS = np.log1p(np.array([-0.2, -0.12, -0.06, 0.0, 0.06, 0.12, 0.2]))
"""Changes of mu_s beside, as logarithms."""
_FARTHEST = 0.5
"""Largest change of a soil's logarithm."""
_TRIED = 2
"""So many places are polished by a step before they are compared."""


def walked(problem: Problem, loss: Loss, fit: Fit) -> Point:
    """The best place along the valley of the last effect, the fit's own if none is better or there is no effect."""
    parameters, point, free = problem.parameters, fit.point, list(fit.free)
    if not parameters.extensions:
        return point
    size = len(parameters.extensions[-1])
    own = point.coordinates[-size:]
    H = fit.reduced.matrix + parameters.prior_information[np.ix_(free, free)]
    follow = -np.linalg.solve(H[:-size, :-size], H[:-size, -size:])
    grip = parameters.index(MU_S)
    coordinates, starts = [], []
    for factor in _FACTORS:
        away = (factor - 1.0) * own
        beside = point.coordinates.copy()
        beside[free] += np.concatenate([np.clip(follow @ away, -_FARTHEST, _FARTHEST), away])
        for change in _GRIPS if grip is not None else (0.0,):
            place = beside.copy()
            if grip is not None:
                place[grip] += change
            place = parameters.inside(place)
            moved = fit.reduced.back[:, :, :-1] @ (place - point.coordinates)[free]
            coordinates.append(place)
            starts.append(point.starts - np.clip(moved, -problem.start_sd, problem.start_sd))
    found = sorted(evaluate(problem, loss, coordinates, np.array(starts)), key=lambda p: p.cost)
    ends = [step(problem, loss, place, free)[0] for place in found[:_TRIED]]
    return min([point, *ends], key=lambda p: p.cost)
