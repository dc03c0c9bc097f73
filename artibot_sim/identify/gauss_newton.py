"""Gauss–Newton for many windows: their starts are eliminated one by one, the parameters are what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.sensitivity import Sensitivity

Array = NDArray[np.float64]

_DAMPING = 1e-3
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
    residuals : list of array
        Window by window, in units of noise.
    losses : array, shape (windows,)
        With the priors of the starts.
    cost : float
        Their sum with the prior of the parameters.
    """

    coordinates: Array
    starts: Array
    residuals: list[Array]
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
    """

    matrix: Array
    gradient: Array
    matrices: Array
    steps: Sequence[tuple[Array, Array]]


def evaluate(problem: Problem, loss: Loss, coordinates: Sequence[Array], starts: Array) -> list[Point]:
    """The loss at several sets of coordinates; `starts` as in `Problem.residuals`."""
    all_starts = np.broadcast_to(starts, (len(coordinates), len(problem), problem.size))
    sets = problem.residuals(coordinates, all_starts)
    return [
        assess(problem, loss, c, s, residuals) for c, s, residuals in zip(coordinates, all_starts, sets, strict=True)
    ]


def assess(problem: Problem, loss: Loss, coordinates: Array, starts: Array, residuals: list[Array]) -> Point:
    """The loss of residuals that are known."""
    away = np.einsum("wij,wj->wi", problem.start_weight, starts - problem.starts)
    losses = loss.total(problem.windows, residuals) + (away**2).sum(axis=1)
    return Point(coordinates, np.array(starts), residuals, losses, float(losses.sum() + prior(problem, coordinates)))


def prior(problem: Problem, coordinates: Array) -> float:
    """Loss of the parameters' prior."""
    return float(coordinates @ problem.parameters.prior_information @ coordinates)


def reduce(
    problem: Problem, loss: Loss, residuals: Sequence[Array], sensitivities: Sequence[Sensitivity], starts: Array
) -> Reduced:
    """Eliminate every window's start by its Schur complement."""
    gradients, matrices, steps = [], [], []
    for i, (residual, sensitivity) in enumerate(zip(residuals, sensitivities, strict=True)):
        weight, _ = loss.weigh(problem.windows[i], residual)
        J_s, J_p = sensitivity.start, sensitivity.parameters
        known = problem.start_weight[i].T @ problem.start_weight[i]
        A = (J_s.T * weight) @ J_s + known
        B = (J_s.T * weight) @ J_p
        g_s = J_s.T @ (weight * residual) + known @ (starts[i] - problem.starts[i])
        g_p = J_p.T @ (weight * residual)
        scale = np.sqrt(np.diag(A))
        solved = (
            np.linalg.solve(A / np.outer(scale, scale), np.column_stack([B, g_s]) / scale[:, None]) / scale[:, None]
        )
        S, s = solved[:, :-1], solved[:, -1]
        matrices.append((J_p.T * weight) @ J_p - B.T @ S)
        gradients.append(g_p - B.T @ s)
        steps.append((s, S))
    stacked = np.array(matrices)
    return Reduced(stacked.sum(axis=0), np.array(gradients), stacked, steps)


def step(
    problem: Problem,
    loss: Loss,
    point: Point,
    free: Sequence[int],
    damping: float = _DAMPING,
    known: Sequence[Sensitivity] | None = None,
    tries: int = 4,
) -> tuple[Point, Reduced, float]:
    """One step: the new point (the old one if nothing is gained), what it was computed from, and the next damping.

    A window whose start gets worse by its own step keeps the old one: a start that slips over a switch of eq. 16
    must not hold back all others. Sensitivities to `free` that are `known` from near by save computing them.
    """
    residuals, sensitivities = point.residuals, known
    if sensitivities is None:
        residuals, sensitivities = problem.linearised(point.coordinates, point.starts, free)
    reduced = reduce(problem, loss, residuals, sensitivities, point.starts)
    index = list(free)
    information = problem.parameters.prior_information
    gradient = reduced.gradient.sum(axis=0) + (information @ point.coordinates)[index]
    H = reduced.matrix + information[np.ix_(index, index)]
    for _ in range(tries):
        move = np.linalg.solve(H + damping * np.diag(np.diag(H)), -gradient) if index else np.empty(0)
        move *= min(1.0, 1.0 / max((np.abs(move) / problem.parameters.longest[index]).max(initial=0.0), 1e-12))
        coordinates = point.coordinates.copy()
        coordinates[index] += move
        coordinates = problem.parameters.inside(coordinates)
        taken = coordinates[index] - point.coordinates[index]
        moved = np.array([-(s + S @ taken) for s, S in reduced.steps])
        limit = _START_STEPS * problem.start_sd
        moved = np.clip(moved, -limit, limit)
        new = best_of(problem, loss, coordinates, [point.starts + share * moved for share in _SHARES])
        if new.cost < point.cost:
            return new, reduced, max(damping / 5.0, 1e-6)
        damping = max(damping, 1e-3) * 10.0
    return point, reduced, damping


def best_of(problem: Problem, loss: Loss, coordinates: Array, candidates: Sequence[Array]) -> Point:
    """The point at `coordinates` where each window takes the best of several starts, each aligned to its path first."""
    points = evaluate(problem, loss, [coordinates] * len(candidates), np.array(candidates))
    return merged_points(problem, [*points, *(align(problem, loss, point) for point in points)])


def merged_points(problem: Problem, points: Sequence[Point]) -> Point:
    """Of points with the same coordinates, window by window the one with the least loss."""
    choice = np.argmin([point.losses for point in points], axis=0)
    starts = np.array([points[k].starts[i] for i, k in enumerate(choice)])
    residuals = [points[k].residuals[i] for i, k in enumerate(choice)]
    losses = np.array([points[k].losses[i] for i, k in enumerate(choice)])
    coordinates = points[0].coordinates
    return Point(coordinates, starts, residuals, losses, float(losses.sum() + prior(problem, coordinates)))


def polished(problem: Problem, loss: Loss, point: Point, starts: Array, steps: int = 2) -> Point:
    """The point where each window may take another start, compared only after steps of the starts alone."""
    other = best_of(problem, loss, point.coordinates, [starts])
    for _ in range(steps):
        other, _, _ = step(problem, loss, other, ())
    return merged_points(problem, [point, other])


def align(problem: Problem, loss: Loss, point: Point) -> Point:
    """Every window's start moved and turned as its path wants it; simulated again where the ground is not uniform."""
    pairs = [problem.aligned(i, r, s) for i, (r, s) in enumerate(zip(point.residuals, point.starts, strict=True))]
    starts = np.array([s for s, _ in pairs])
    if not problem.parameters.uniform:
        return evaluate(problem, loss, [point.coordinates], starts)[0]
    return assess(problem, loss, point.coordinates, starts, [r for _, r in pairs])


def again(problem: Problem, loss: Loss, point: Point) -> Point:
    """The same point under another loss."""
    new = assess(problem, loss, point.coordinates, point.starts, point.residuals)
    return replace(new, starts=point.starts)
