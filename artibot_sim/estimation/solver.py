"""Gauss–Newton for many windows: their starts are eliminated one by one, the parameters are what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.kernels import Parts
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.problem import Problem, Sensitivity

Array = NDArray[np.float64]

_DAMPING = 1e-3
"""Levenberg's damping at the start of a fit."""
_SHARES = (1.0, 0.3, 0.0)
"""How much of its own step a window's start takes: the best of these."""
_START_STEPS = 3.0
"""Longest step of a start, in its prior deviations."""


@dataclass(frozen=True)
class Point:
    """Where a fit stands.

    Attributes
    ----------
    coordinates : array, shape (p,)
    starts : array, shape (windows, 8 or 6)
    residuals : Parts
        Window by window, in units of noise.
    losses : array, shape (windows,)
        With the priors of the starts.
    cost : float
        Their sum with the prior of the parameters.
    """

    coordinates: Array
    starts: Array
    residuals: Parts
    losses: Array
    cost: float


@dataclass(frozen=True)
class Reduced:
    """The normal equations of the parameters alone, in units of the loss.

    Attributes
    ----------
    matrix : array, shape (f, f)
        Information of the data about the free parameters, the starts eliminated; the prior left out.
    gradient : array, shape (windows, f)
        What each window pulls, with the same elimination.
    matrices : array, shape (windows, f, f)
        Information of each window.
    back : array, shape (windows, 8 or 6, f + 1)
        How each start goes along with the parameters, and last how far it is from its own best, both negative.
    """

    matrix: Array
    gradient: Array
    matrices: Array
    back: Array


@dataclass(frozen=True)
class FrozenWindows:
    """Windows that are not simulated: what they lose as the free coordinates move, by their normal equations.

    Attributes
    ----------
    middle : array, shape (f,)
        Where these are known.
    gradient : array, shape (windows, f)
    matrices : array, shape (windows, f, f)
        As in `Reduced`.
    """

    middle: Array
    gradient: Array
    matrices: Array

    def losses(self, free: Array) -> Array:
        """What each window loses more than in the middle, (windows,)."""
        moved = free - self.middle
        return np.asarray(2.0 * self.gradient @ moved + np.einsum("wij,i,j->w", self.matrices, moved, moved), float)

    def normal_equations(self, free: Array) -> tuple[Array, Array]:
        """Gradient (f,) and information (f, f) of all of them."""
        matrix = self.matrices.sum(axis=0)
        return self.gradient.sum(axis=0) + matrix @ (free - self.middle), matrix


def evaluate(problem: Problem, loss: Loss, coordinates: Sequence[Array], starts: Array) -> list[Point]:
    """The loss at several sets of coordinates; `starts` as in `Problem.residuals`."""
    every = np.broadcast_to(starts, (len(coordinates), len(problem), problem.size))
    return assess(problem, loss, coordinates, every, problem.flat_residuals(coordinates, every))


def assess(problem: Problem, loss: Loss, coordinates: Sequence[Array], starts: Array, residuals: Array) -> list[Point]:
    """The loss of several sets of residuals that are known, (sets, n), with as many starts (sets, windows, 8 or 6)."""
    away = np.einsum("wij,swj->swi", problem.start_weight, starts - problem.starts)
    losses = loss.totals(problem.samples, residuals) + (away**2).sum(axis=2)
    return [
        Point(
            c, np.array(starts[k]), problem.parts(residuals[k]), losses[k], float(losses[k].sum() + prior(problem, c))
        )
        for k, c in enumerate(coordinates)
    ]


def prior(problem: Problem, coordinates: Array) -> float:
    """Loss of the parameters' prior."""
    return float(coordinates @ problem.parameters.prior_information @ coordinates)


def reduce(problem: Problem, loss: Loss, residuals: Parts, sensitivity: Sensitivity, starts: Array) -> Reduced:
    """Eliminate every window's start by its Schur complement."""
    return eliminated(problem, loss.weights(problem.samples, residuals.flat), residuals, sensitivity, starts)[0]


def eliminated(
    problem: Problem, weight: Array, residuals: Parts, sensitivity: Sensitivity, starts: Array
) -> tuple[Reduced, Array]:
    """Normal equations of the parameters, starts eliminated, and each window's weighted squares at its best start.

    `weight` (n,) are the samples'; the squares are (windows,).
    """
    p = len(sensitivity.parameters)
    rows = np.concatenate([sensitivity.parameters, sensitivity.starts, residuals.flat[None]])
    weighted = rows * weight
    edges = problem.samples.begin.tolist()
    sums = np.array([weighted[:, a:b] @ rows[:, a:b].T for a, b in zip(edges, edges[1:], strict=False)])
    known = problem.start_information
    A, B = sums[:, p:-1, p:-1] + known, sums[:, p:-1, :p]
    g_s = sums[:, p:-1, -1] + np.einsum("wij,wj->wi", known, starts - problem.starts)
    scale = np.sqrt(np.einsum("wii->wi", A))
    right = np.concatenate([B, g_s[:, :, None]], axis=2) / scale[:, :, None]
    solved = np.linalg.solve(A / (scale[:, :, None] * scale[:, None, :]), right) / scale[:, :, None]
    matrices = sums[:, :p, :p] - B.transpose(0, 2, 1) @ solved[:, :, :-1]
    gradients = sums[:, :p, -1] - np.einsum("wsp,ws->wp", B, solved[:, :, -1])
    away = starts - problem.starts
    squares = (
        sums[:, -1, -1] + np.einsum("wi,wij,wj->w", away, known, away) - np.einsum("wi,wi->w", g_s, solved[:, :, -1])
    )
    return Reduced(matrices.sum(axis=0), gradients, matrices, solved), squares


def step(
    problem: Problem,
    loss: Loss,
    point: Point,
    free: Sequence[int],
    damping: float = _DAMPING,
    known: Sensitivity | None = None,
    tries: int = 4,
    beside: FrozenWindows | None = None,
) -> tuple[Point, Reduced, float]:
    """One step: the new point (the old one if nothing is gained), what it was computed from, and the next damping.

    A window whose start gets worse by its own step keeps the old one: a start that slips over a switch of eq. 16
    must not hold back all others. Sensitivities to `free` that are `known` from near by save computing them. Windows
    `beside` the problem's have their say in where the parameters go.
    """
    residuals, sensitivity = point.residuals, known
    if sensitivity is None:
        residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    reduced = reduce(problem, loss, residuals, sensitivity, point.starts)
    index = list(free)
    information = problem.parameters.prior_information
    gradient = reduced.gradient.sum(axis=0) + (information @ point.coordinates)[index]
    H = reduced.matrix + information[np.ix_(index, index)]
    if beside is not None:
        outside, matrix = beside.normal_equations(point.coordinates[index])
        gradient, H = gradient + outside, H + matrix

    def cost(of: Point) -> float:
        return of.cost + (0.0 if beside is None else float(beside.losses(of.coordinates[index]).sum()))

    for _ in range(tries if index else 1):  # damping is for the parameters: without any it changes nothing
        move = np.linalg.solve(H + damping * np.diag(np.diag(H)), -gradient) if index else np.empty(0)
        move *= min(1.0, 1.0 / max((np.abs(move) / problem.parameters.longest[index]).max(initial=0.0), 1e-12))
        coordinates = point.coordinates.copy()
        coordinates[index] += move
        coordinates = problem.parameters.inside(coordinates)
        taken = coordinates[index] - point.coordinates[index]
        moved = -(reduced.back[:, :, -1] + reduced.back[:, :, :-1] @ taken)
        limit = _START_STEPS * problem.start_sd
        moved = np.clip(moved, -limit, limit)
        new = best_of(problem, loss, coordinates, [point.starts + share * moved for share in _SHARES])
        if cost(new) < cost(point):
            return new, reduced, max(damping / 5.0, 1e-6)
        damping = max(damping, 1e-3) * 10.0
    return point, reduced, damping


def best_of(problem: Problem, loss: Loss, coordinates: Array, candidates: Sequence[Array]) -> Point:
    """The point at `coordinates` where each window takes the best of several starts, each aligned to its path first."""
    points = evaluate(problem, loss, [coordinates] * len(candidates), np.array(candidates))
    moved = _guessed(problem, loss, points)
    if not problem.parameters.uniform:  # one more simulation, of the best guesses
        moved = evaluate(problem, loss, [coordinates], merged_points(problem, moved).starts)
    return merged_points(problem, [*points, *moved])


def merged_points(problem: Problem, points: Sequence[Point]) -> Point:
    """Of points with the same coordinates, window by window the one with the least loss."""
    losses = np.array([point.losses for point in points])
    choice, each = np.argmin(losses, axis=0), np.arange(losses.shape[1])
    starts = np.array([point.starts for point in points])[choice, each]
    flat = np.concatenate([points[k].residuals[i] for i, k in enumerate(choice.tolist())])
    least, coordinates = losses[choice, each], points[0].coordinates
    return Point(coordinates, starts, problem.parts(flat), least, float(least.sum() + prior(problem, coordinates)))


def polished(problem: Problem, loss: Loss, point: Point, starts: Array, steps: int = 2) -> Point:
    """The point where each window may take another start, compared only after steps of the starts alone."""
    other = best_of(problem, loss, point.coordinates, [starts])
    for _ in range(steps):
        other, _, _ = step(problem, loss, other, ())
    return merged_points(problem, [point, other])


def _guessed(problem: Problem, loss: Loss, points: Sequence[Point]) -> list[Point]:
    """Points with starts moved over the ground, without a simulation: where the ground is not uniform a guess."""
    flat = np.array([point.residuals.flat for point in points])
    starts, flat = problem.aligned(flat, np.array([point.starts for point in points]))
    return assess(problem, loss, [point.coordinates for point in points], starts, flat)


def reassessed(problem: Problem, loss: Loss, point: Point) -> Point:
    """A point assessed anew under another loss."""
    return assess(problem, loss, [point.coordinates], point.starts[None], point.residuals.flat[None])[0]
