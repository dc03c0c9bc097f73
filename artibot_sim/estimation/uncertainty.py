"""How sure a fit is: curvature along a profile over mu_s, a bootstrap over windows, and what data leave open."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from artibot_sim.estimation.encoder_noise import NoiseShare
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import MU_S
from artibot_sim.estimation.problem import Draw, Problem
from artibot_sim.estimation.search import Fit, Tick
from artibot_sim.estimation.solver import Point, Reduced, evaluate, polished, reduce, step

Array = NDArray[np.float64]

GRID = np.array([0.0, *(s * x for x in (0.004, 0.009, 0.018, 0.035, 0.06, 0.12, 0.3, 0.6, 1.0) for s in (1.0, -1.0))])
"""Changes of mu_s's coordinate at which a profile is taken, from the inside out."""
_HOPELESS = 30.0
"""A loss this much over the least has no weight; a profile goes no further on that side."""
_ALWAYS = 0.018
"""So far it goes in any case, for other draws of windows may have their best there."""
_DRAWS = 1000
"""Random weightings of the windows."""
_TAILS = (0.025, 0.975)


@dataclass(frozen=True)
class Node:
    """The best of everything else at one value of mu_s.

    Attributes
    ----------
    point : Point
    reduced : Reduced
        Normal equations there.
    width : float
        Of the range of mu_s's coordinate that it stands for.
    """

    point: Point
    reduced: Reduced
    width: float = 1.0


@dataclass(frozen=True)
class Distribution:
    """Distribution of the parameters' logarithms over the prior's middles.

    Attributes
    ----------
    mean : array, shape (p,)
    covariance : array, shape (p, p)
    low, high : array, shape (p,)
        Ends of the 95 % intervals.
    """

    mean: Array
    covariance: Array
    low: Array
    high: Array


def profile(problem: Problem, fit: Fit, tick: Tick = lambda: None) -> tuple[Node, ...]:
    """Fits at fixed values of mu_s around the best one; one node where mu_s is not fitted."""
    i = problem.parameters.index(MU_S)
    if i is None:
        return (_node(problem, fit.loss, fit.point, fit.free),)
    nodes: dict[float, Node] = {}
    least, ends = fit.point.cost, {1.0: np.inf, -1.0: np.inf}
    for change in GRID.tolist():
        side = float(np.sign(change))
        if change and abs(change) > max(ends[side], _ALWAYS):
            continue
        near = min(nodes, key=lambda c: (abs(c - change), abs(c)), default=None)
        begin = fit.point if near is None else nodes[near].point
        coordinates = begin.coordinates.copy()
        coordinates[i] = fit.point.coordinates[i] + change
        inside = problem.parameters.inside(coordinates)
        nodes[change] = refitted(problem, fit.loss, begin, inside, fit.free)
        least = min(least, nodes[change].point.cost)
        if change and nodes[change].point.cost > least + _HOPELESS:
            ends[side] = abs(change)
        tick()
    return _with_widths(nodes)


def refitted(
    problem: Problem,
    loss: Loss,
    begin: Point,
    coordinates: Array,
    free: Sequence[int],
    all_free: Sequence[int] | None = None,
) -> Node:
    """A step of what is `free` (mu_s is not), with starts that may follow the windows before.

    Parameters
    ----------
    begin : Point
        Where the starts are taken from.
    coordinates : array, shape (p,)
    all_free : sequence of int, optional
        What the node's normal equations are for, where more than was free for the step.
    """
    point = evaluate(problem, loss, [coordinates], begin.starts)[0]
    point, _, _ = step(problem, loss, point, free)
    point = polished(problem, loss, point, problem.carried(point.coordinates, point.starts), steps=1)
    return _node(problem, loss, point, all_free or free)


def _node(problem: Problem, loss: Loss, point: Point, free: Sequence[int]) -> Node:
    residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    return Node(point, reduce(problem, loss, residuals, sensitivity, point.starts))


def _with_widths(nodes: dict[float, Node]) -> tuple[Node, ...]:
    places = sorted(nodes)
    edges = [places[0], *((a + b) / 2 for a, b in zip(places, places[1:], strict=False)), places[-1]]
    return tuple(
        Node(nodes[c].point, nodes[c].reduced, max(b - a, 1e-9))
        for c, a, b in zip(places, edges, edges[1:], strict=False)
    )


def from_curvature(problem: Problem, nodes: Sequence[Node], free: Sequence[int], noise: NoiseShare) -> Distribution:
    """What curvature at the nodes and the loss along them say, `noise` taken off: a mixture of normal distributions."""
    index = list(free)
    prior = problem.parameters.prior_information
    loss = np.array([noise.cost_without(node.point) for node in nodes])
    means, covariances, logs = [], [], []
    for node in nodes:
        H = node.reduced.matrix + prior[np.ix_(index, index)]
        by_window = node.reduced.gradient - noise.gradients(node.point.coordinates, index)
        gradient = by_window.sum(axis=0) + (prior @ node.point.coordinates)[index]
        cov = np.zeros((len(prior), len(prior)))
        inverse = np.linalg.inv(H) if index else H
        cov[np.ix_(index, index)] = inverse
        mean = node.point.coordinates.copy()
        mean[index] -= inverse @ gradient
        means.append(problem.parameters.mixing @ problem.parameters.inside(mean))
        covariances.append(problem.parameters.mixing @ cov @ problem.parameters.mixing.T)
        logs.append(0.5 * np.linalg.slogdet(inverse)[1] if index else 0.0)
    weight = np.exp(-0.5 * (loss - loss.min()) + np.array(logs) - max(logs)) * [node.width for node in nodes]
    return mixture(weight / weight.sum(), np.array(means), np.array(covariances))


def mixture(weight: Array, means: Array, covariances: Array) -> Distribution:
    """Mean, covariance and 95 % intervals of a mixture of normal distributions along a path of means.

    Each stands for the path up to halfway to its neighbours, too, as if its mean were evenly spread there.

    Parameters
    ----------
    weight : array, shape (k,)
        Of each, 1 in sum.
    means : array, shape (k, p)
    covariances : array, shape (k, p, p)
    """
    mean = weight @ means
    away = means - mean
    covariance = np.einsum("k,kij->ij", weight, covariances) + np.einsum("k,ki,kj->ij", weight, away, away)
    low, high = np.empty(len(mean)), np.empty(len(mean))
    slope = np.gradient(means, axis=0) if len(means) > 1 else np.zeros_like(means)
    for i in range(len(mean)):
        sd = np.sqrt(np.maximum(covariances[:, i, i], 0.0) + slope[:, i] ** 2 / 12.0)
        sd = np.maximum(sd, 1e-6)
        grid = np.linspace((means[:, i] - 6 * sd).min(), (means[:, i] + 6 * sd).max(), 4001)
        below = (weight[:, None] * norm.cdf((grid - means[:, i, None]) / sd[:, None])).sum(axis=0)
        low[i], high[i] = np.interp(_TAILS, below, grid)
        covariance[i, i] = max(covariance[i, i], sd.min() ** 2)
    return Distribution(mean, covariance, low, high)


def from_bootstrap(problem: Problem, nodes: Sequence[Node], free: Sequence[int], noise: NoiseShare) -> Distribution:
    """What windows weighted at random would have given, `noise` taken off: the best node, and one step (Rubin 1981).

    No window is left out, as in draws with replacement some are: something may act in few of them.
    """
    rng = problem.generator(Draw.BOOTSTRAP)
    weights = (rng.exponential(size=len(problem)) for _ in range(_DRAWS))
    table = np.array([problem.parameters.mixing @ one for one in reweighted(problem, nodes, free, noise, weights)])
    low, high = np.quantile(table, _TAILS, axis=0)
    return Distribution(table.mean(axis=0), np.atleast_2d(np.cov(table.T)), low, high)


def reweighted(
    problem: Problem, nodes: Sequence[Node], free: Sequence[int], noise: NoiseShare, weights: Iterable[Array]
) -> Iterator[Array]:
    """Coordinates (p,) that windows of other weights (windows,) would have given: the best node, one step on.

    Within bounds: where nothing but a bound stops a parameter, its loss is flat, and a step goes anywhere.
    """
    index, prior = list(free), problem.parameters.prior_information
    losses = np.array([node.point.losses - noise.losses(node.point.coordinates) for node in nodes])
    gradients = [node.reduced.gradient - noise.gradients(node.point.coordinates, index) for node in nodes]
    for weight in weights:
        best = int(np.argmin(losses @ weight))
        coordinates = nodes[best].point.coordinates.copy()
        H = np.einsum("w,wij->ij", weight, nodes[best].reduced.matrices) + prior[np.ix_(index, index)]
        if index:
            coordinates[index] -= np.linalg.solve(H, weight @ gradients[best] + (prior @ coordinates)[index])
        yield problem.parameters.inside(coordinates)
