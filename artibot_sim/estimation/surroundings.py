"""What is known around a fit: where its search could have ended as well, and how encoders' noise bends its loss.

A fit's curvature holds mu_s fixed, and the loss is jagged: it says too little. So the fit is made again at other values
of mu_s and of each size that is no soil, and other ends of its search are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.encoder_noise import NoiseShare, noise_share
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.parameters import MU_S
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import FINE, Fit, Tick, scan
from artibot_sim.estimation.solver import Point, evaluate, step
from artibot_sim.estimation.uncertainty import Node, profile, refitted

Array = NDArray[np.float64]

_AWAY = (1.5, 3.0, 6.0, 12.0, 24.0)
"""Changes of a size that are tried, in standard deviations of the curvature, or in _LEAST of the size."""
_ALWAYS, _FLAT = 3, 30.0
"""So many of them on both sides in any case; the others as long as the loss has not risen by this much."""
_LEAST = 0.01
_FARTHEST = 0.3
"""The largest, as a share of the size; that of a parameter, which has no zero of its own, is its prior's width."""
_GRIPS = np.array([-0.03, -0.02, -0.012, -0.006, 0.0, 0.006, 0.012, 0.02, 0.03])
"""Changes of mu_s's coordinate beside each."""
_PREFERRED = 6.0
"""Standard deviations of its lead by which the best fit may lose it: what is around another end is better still."""
_FARTHEST_SOIL = 0.5
"""Largest change of a soil's logarithm that goes along."""


@dataclass(frozen=True)
class Surroundings:
    """What is known around a fit.

    Attributes
    ----------
    profile : tuple of Node
        Fits at other values of mu_s, it among them.
    beside : tuple of Node
        Fits with other sizes of what is no soil, and around other ends of the search.
    noise : NoiseShare
    """

    profile: tuple[Node, ...]
    beside: tuple[Node, ...]
    noise: NoiseShare

    @property
    def nodes(self) -> tuple[Node, ...]:
        """All fits: places where the search could have ended had other windows been recorded."""
        return self.profile + self.beside


def surroundings(
    fits: Sequence[tuple[Problem, Fit]], tick: Tick = lambda: None, others: Sequence[Fit] = ()
) -> list[Surroundings]:
    """What is around some fits, all of it side by side.

    Parameters
    ----------
    fits : sequence of (Problem, Fit)
    tick : callable
        Called when a part of the work is done.
    others : sequence of Fit
        Other ends of the search for the last one: where the loss is jagged a search ends at one of several optima,
        and which of them is the best depends on the windows that were recorded. What no other windows of this kind
        would make the best is left out.
    """
    works: list[tuple[int, Callable[[], Sequence[Node] | NoiseShare]]] = []
    for number, (problem, fit) in enumerate(fits):
        works += [(number, partial(profile, problem, fit)), (number, partial(noise_share, problem, fit))]
        for place in problem.parameters.beside_soil:
            works += [(number, work) for work in along(problem, fit, place)]
    last, best = fits[-1]
    works += [(len(fits) - 1, partial(profile, last, other)) for other in others if _could_be_best(other, best)]
    done = side_by_side(lambda work: work[1](), works, last.workers, tick)
    found = []
    for number in range(len(fits)):
        mine = [result for (whose, _), result in zip(works, done, strict=True) if whose == number]
        noise = next(result for result in mine if isinstance(result, NoiseShare))
        own, *beside_it = (result for result in mine if not isinstance(result, NoiseShare))
        found.append(Surroundings(tuple(own), tuple(node for nodes in beside_it for node in nodes), noise))
    return found


def _could_be_best(other: Fit, best: Fit) -> bool:
    """Whether windows weighted at random, each by 1 ± 1, may prefer another fit to the best one."""
    behind = other.point.losses - best.point.losses
    return float(behind.sum()) < _PREFERRED * float(np.sqrt(np.sum(behind**2)))


def along(problem: Problem, fit: Fit, place: slice) -> list[Callable[[], list[Node]]]:
    """What fits the model with other sizes at some coordinates, to either side; across, too, where there are two.

    Parameters
    ----------
    problem : Problem
    fit : Fit
    place : slice
        An effect's coordinates, which are 0 where it is absent, or a parameter's, which is 0 at its prior's middle.
    """
    parameters = problem.parameters
    if place.start < len(parameters.parameters):
        directions, length = [np.ones(1)], parameters.parameters[place.start].spread
    else:
        own = fit.point.coordinates[place]
        length = max(float(np.linalg.norm(own)), 1e-9)
        directions = [own / length]
        if len(own) == 2:
            directions.append(np.array([-own[1], own[0]]) / length)
    return [partial(_line, problem, fit, place, s * one, length) for one in directions for s in (-1.0, 1.0)]


def _line(problem: Problem, fit: Fit, place: slice, direction: Array, length: float) -> list[Node]:
    """Fits along a direction (k,) of some coordinates, mu_s scanned beside each, as far as the loss is flat."""
    parameters, free = problem.parameters, list(fit.free)
    mine = [k for k, i in enumerate(free) if place.start <= i < place.stop]
    H = fit.reduced.matrix + parameters.prior_information[np.ix_(free, free)]
    sd = float(np.sqrt(direction @ np.linalg.inv(H)[np.ix_(mine, mine)] @ direction))
    unit = max(sd, _LEAST * length)
    sizes = sorted({min(k * unit, _FARTHEST * length) for k in _AWAY})
    found: list[Node] = []
    here, at = fit, 0.0
    for number, size in enumerate(sizes):
        if number >= _ALWAYS and here.point.cost > fit.point.cost + _FLAT:
            break
        node = _moved(problem, here, place, (size - at) * direction)
        here, at = replace(fit, point=node.point, reduced=node.reduced), size
        found.append(node)
    return found


def _moved(problem: Problem, fit: Fit, place: slice, move: Array) -> Node:
    """The fit with some coordinates changed by `move` (k,), all others fitted again, mu_s scanned."""
    rest = tuple(i for i in fit.free if not place.start <= i < place.stop)
    best = min(moved_points(problem, fit.loss, fit, place, move, _GRIPS), key=lambda point: point.cost)
    best = scan(problem, fit.loss, step(problem, fit.loss, best, rest)[0], FINE)
    return refitted(problem, fit.loss, best, best.coordinates, rest, fit.free)


def moved_points(problem: Problem, loss: Loss, fit: Fit, place: slice, move: Array, grips: Array) -> list[Point]:
    """The fit with some coordinates moved (k,), the soil that goes with them, and some changes of mu_s.

    Parameters
    ----------
    problem : Problem
    loss : Loss
    fit : Fit
    place : slice
        Of the coordinates that are moved: an effect's, or one parameter's.
    move : array, shape (k,)
    grips : array
        Changes of mu_s's coordinate.
    """
    there, starts = _by_declared_ridge(problem, fit, place, move) or _by_normal_equations(problem, fit, place, move)
    grip = problem.parameters.index(MU_S)
    found = []
    for change in grips if grip is not None else np.zeros(1):
        one = there.copy()
        if grip is not None:
            one[grip] += change
        found.append(problem.parameters.inside(one))
    return evaluate(problem, loss, found, starts)


def _by_normal_equations(problem: Problem, fit: Fit, place: slice, move: Array) -> tuple[Array, Array]:
    """Coordinates and starts after a move, by the fit's normal equations; mu_s, of which they know nothing, stays."""
    parameters, free = problem.parameters, list(fit.free)
    mine = np.array([place.start <= i < place.stop for i in free])
    H = fit.reduced.matrix + parameters.prior_information[np.ix_(free, free)]
    follow = -np.linalg.solve(H[np.ix_(~mine, ~mine)], H[np.ix_(~mine, mine)])
    taken = np.empty(len(free))
    taken[mine], taken[~mine] = move, np.clip(follow @ move, -_FARTHEST_SOIL, _FARTHEST_SOIL)
    there = fit.point.coordinates.copy()
    there[free] += taken
    moved = fit.reduced.back[:, :, :-1] @ taken
    return there, fit.point.starts - np.clip(moved, -problem.start_sd, problem.start_sd)


def _by_declared_ridge(problem: Problem, fit: Fit, place: slice, move: Array) -> tuple[Array, Array] | None:
    """A step along the ridge that an effect declares (`Search.ridge`): soil and mu_s follow it, starts stay."""
    parameters = problem.parameters
    extension = next((e for e, own in zip(parameters.extensions, parameters.places, strict=True) if own == place), None)
    if extension is None or not extension.search.ridge:
        return None
    own = fit.point.coordinates[place]
    after = extension.nearest(own + move)
    soil = parameters.along_ridge(parameters.values(fit.point.coordinates), extension, own, after)
    moved = fit.point.coordinates.copy()
    moved[place] = after
    return parameters.coordinates(soil, moved[len(parameters.parameters) :]), fit.point.starts
