"""A fit's values and how sure they are: where it could have ended as well, and what the other view says.

A fit's curvature holds mu_s fixed, and the loss is jagged: it says too little. So the fit is made again at other values
of mu_s and of the effect's size. Then windows are weighted at random many times (Rubin's bootstrap), each time the
place with the least loss is taken, and one step from it. Losses and steps are those with the encoders' noise taken off
(`estimation/encoder_noise.py`). The mean of all draws is the value, for single places hold by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.records import Found
from artibot_sim.diagnose.selection.ridge_search import beside
from artibot_sim.estimation.encoder_noise import NoiseShare, noise_share
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.parameters import Extension, ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import FINE, Fit, Tick, scan
from artibot_sim.estimation.solver import step
from artibot_sim.estimation.uncertainty import Node, profile, refitted, reweighted
from artibot_sim.identify.judgement import SYSTEMATIC

Array = NDArray[np.float64]
FromCommands = Mapping[str, Mapping[str, Found]]
"""By effect, what another view says of its parameters."""

_AWAY = (1.5, 3.0, 6.0, 12.0, 24.0)
"""Changes of an effect's size that are tried, in standard deviations of the curvature, or in _LEAST of the size."""
_ALWAYS, _FLAT = 3, 30.0
"""So many of them on both sides in any case; the others as long as the loss has not risen by this much."""
_LEAST = 0.01
_FARTHEST = 0.3
"""The largest, as a share of the size."""
_GRIPS = np.array([-0.03, -0.02, -0.012, -0.006, 0.0, 0.006, 0.012, 0.02, 0.03])
"""Changes of mu_s's coordinate beside each."""
_DRAWS = 600
_OWN_SYSTEMATIC = 0.02
"""Standard deviation, as a share of an effect's coordinate, of what no residual shows."""
_NORMAL = 1.96


@dataclass(frozen=True)
class Uncertain:
    """A fit's coordinates with their covariance.

    Attributes
    ----------
    coordinates : array, shape (p,)
    covariance : array, shape (p, p)
        Of the values' logarithms and the effects' coordinates.
    """

    coordinates: Array
    covariance: Array


@dataclass(frozen=True)
class Surroundings:
    """What is known around a fit.

    Attributes
    ----------
    nodes : tuple of Node
        Other fits beside it.
    noise : NoiseShare
    """

    nodes: tuple[Node, ...]
    noise: NoiseShare


def uncertain(
    problem: Problem, fit: Fit, seed: int, from_commands: FromCommands | None = None, tick: Tick = lambda: None
) -> Uncertain:
    """Values and covariances of what was fitted: the wider of curvature and bootstrap, and what neither sees."""
    return judged(problem, fit, surroundings([(problem, fit)], tick)[0], seed, from_commands)


def surroundings(
    fits: Sequence[tuple[Problem, Fit]], tick: Tick = lambda: None, beside: Sequence[Fit] = ()
) -> list[Surroundings]:
    """What is around some fits, all of it side by side.

    Other ends of the search for the last one, `beside` it, are around it as well: where the loss is jagged a search
    ends at one of several optima, and which of them is the best depends on the windows that were recorded.
    """
    works: list[tuple[int, Callable[[], Sequence[Node] | NoiseShare]]] = []
    works += [(len(fits) - 1, partial(profile, fits[-1][0], other)) for other in beside]
    for number, (problem, fit) in enumerate(fits):
        for which in range(len(problem.parameters.extensions)):
            works += [(number, work) for work in along(problem, fit, which)]
        works += [(number, partial(profile, problem, fit)), (number, partial(noise_share, problem, fit))]
    workers = fits[0][0].workers if fits else None
    done = side_by_side(lambda work: work[1](), works, workers, tick)
    found = []
    for number in range(len(fits)):
        mine = [result for (whose, _), result in zip(works, done, strict=True) if whose == number]
        nodes = [node for result in mine if not isinstance(result, NoiseShare) for node in result]
        noise = next(result for result in mine if isinstance(result, NoiseShare))
        found.append(Surroundings(tuple(nodes), noise))
    return found


def judged(
    problem: Problem, fit: Fit, around: Surroundings, seed: int, from_commands: FromCommands | None = None
) -> Uncertain:
    """Values and intervals of a fit from the profile over mu_s and the noise found around it."""
    parameters, index = problem.parameters, list(fit.free)
    nodes, noise = around.nodes, around.noise
    mean, spread = drawn(problem, nodes, index, noise, seed)
    best = min(nodes, key=lambda node: noise.cost_without(node.point))
    curvature = np.zeros_like(spread)
    information = best.reduced.matrix + parameters.prior_information[np.ix_(index, index)]
    curvature[np.ix_(index, index)] = np.linalg.inv(information)
    both = [parameters.mixing @ one @ parameters.mixing.T for one in (curvature, spread)]
    wider = max(both, key=np.trace)
    sd = np.sqrt(np.maximum(np.diag(both[0]), np.diag(both[1])))
    scale = np.maximum(sd / np.sqrt(np.maximum(np.diag(wider), 1e-30)), 1.0)
    extra = np.full(len(parameters), SYSTEMATIC**2)
    extra[len(parameters.parameters) :] = (_OWN_SYSTEMATIC * mean[len(parameters.parameters) :]) ** 2
    return combined(parameters, Uncertain(mean, wider * np.outer(scale, scale) + np.diag(extra)), from_commands or {})


def along(problem: Problem, fit: Fit, which: int) -> list[Callable[[], list[Node]]]:
    """What fits the effect numbered `which` with other sizes, to either side; across, too, where it has two."""
    own = fit.point.coordinates[problem.parameters.places[which]]
    length = max(float(np.linalg.norm(own)), 1e-9)
    directions = [own / length]
    if len(own) == 2:
        directions.append(np.array([-own[1], own[0]]) / length)
    return [partial(_line, problem, fit, which, s * one, length) for one in directions for s in (-1.0, 1.0)]


def _line(problem: Problem, fit: Fit, which: int, direction: Array, length: float) -> list[Node]:
    """Fits along a direction (k,) of an effect's coordinates, mu_s scanned beside each, as far as the loss is flat."""
    parameters, free, place = problem.parameters, list(fit.free), problem.parameters.places[which]
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
        node = _moved(problem, here, (size - at) * direction, which)
        here, at = replace(fit, point=node.point, reduced=node.reduced), size
        found.append(node)
    return found


def _moved(problem: Problem, fit: Fit, move: Array, which: int) -> Node:
    """The fit with an effect's coordinates changed by `move` (k,), all others fitted again, mu_s scanned."""
    place = problem.parameters.places[which]
    rest = tuple(i for i in fit.free if not place.start <= i < place.stop)
    best = min(beside(problem, fit.loss, fit, move, _GRIPS, which), key=lambda point: point.cost)
    best = scan(problem, fit.loss, step(problem, fit.loss, best, rest)[0], FINE)
    return refitted(problem, fit.loss, best, best.coordinates, rest, fit.free)


def drawn(
    problem: Problem, nodes: Sequence[Node], free: Sequence[int], noise: NoiseShare, seed: int
) -> tuple[Array, Array]:
    """Mean (p,) and covariance (p, p) of the coordinates that windows weighted at random would have given."""
    rng = np.random.default_rng(seed)
    # no window is left out: an effect may act in few of them
    weights = (rng.exponential(size=len(problem)) for _ in range(_DRAWS))
    table = list(reweighted(problem, nodes, free, noise, weights))
    return np.mean(table, axis=0), np.atleast_2d(np.cov(np.array(table).T))


def combined(parameters: ParameterSet, what: Uncertain, from_commands: FromCommands) -> Uncertain:
    """Values once the command view has measured effects' sizes too; the soil follows by the covariance.

    Views that contradict each other are both less sure of that size than they say (Birge's ratio), and of the rest as
    far as it goes along.
    """
    mean, covariance = parameters.mixing @ what.coordinates, what.covariance
    for extension, part in zip(parameters.extensions, parameters.places, strict=True):
        seen = _measured(extension, from_commands.get(extension.id, {}))
        if seen is not None:
            (value, variance), place = seen, part.start
            total = covariance[place, place] + variance
            away = value - mean[place]
            along = covariance[:, place] / covariance[place, place]
            mean = mean + covariance[:, place] / total * away
            kept = covariance[place, place] * variance / total * max(1.0, away**2 / total)
            covariance = covariance - np.outer(along, covariance[place]) + kept * np.outer(along, along)
    return Uncertain(np.asarray(np.linalg.solve(parameters.mixing, mean), float), covariance)


def _measured(extension: Extension, found: Mapping[str, Found]) -> tuple[float, float] | None:
    """The single coordinate of an effect and its variance as another view has them; None where it has none."""
    names = list(extension.search.sizes)
    if len(extension) != 1 or names[0] not in found or found[names[0]].ci95 is None:
        return None
    one = found[names[0]]
    assert one.ci95 is not None
    value, low, high = (float(extension.coordinates({names[0]: v})[0]) for v in (one.value, *one.ci95))
    return value, max(((high - low) / (2.0 * _NORMAL)) ** 2, 1e-12)
