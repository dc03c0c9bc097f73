"""The solver against what it stands for: the full equations, differences, and known answers of linear problems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.turns import EVEN, TURNS
from estimation.linear import Linear, linear

from artibot_sim.estimation.encoder_noise import NoiseShare
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.problem import Draw, Problem
from artibot_sim.estimation.search import (
    FINE,
    Effort,
    SearchReport,
    followed_scan,
    free_parameters,
    restarted_windows,
    scan,
    search,
)
from artibot_sim.estimation.solver import evaluate, reduce, step
from artibot_sim.estimation.uncertainty import Node, from_bootstrap, from_curvature
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return problem_of([synthetic(ROBOT, TURNS, kappa=0.8, seed=6)], parameter_set(ROBOT), 3.0, 1)


def solved_in_full(of: Problem, loss: Loss, coordinates: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, ...]:
    """Steps of parameters and starts, and the parameters' information, from the equations of all unknowns at once."""
    free = list(free_parameters(of))
    parts, sensitivity = of.linearised(coordinates, starts, free)
    p, k, w = len(free), of.size, len(of)
    J = np.zeros((len(parts.flat), p + k * w))
    J[:, :p] = sensitivity.parameters.T
    for i, (a, b) in enumerate(zip(of.samples.begin, of.samples.begin[1:], strict=False)):
        J[a:b, p + k * i : p + k * (i + 1)] = sensitivity.starts[:, a:b].T
    weight = loss.weights(of.samples, parts.flat)
    H, g = J.T @ (J * weight[:, None]), J.T @ (weight * parts.flat)
    for i, known in enumerate(of.start_information):
        rows = slice(p + k * i, p + k * (i + 1))
        H[rows, rows] += known
        g[rows] += known @ (starts[i] - of.starts[i])
    schur = H[:p, :p] - H[:p, p:] @ np.linalg.solve(H[p:, p:], H[p:, :p])
    prior = of.parameters.prior_information
    H[:p, :p] += prior[np.ix_(free, free)]
    g[:p] += (prior @ coordinates)[free]
    move = np.linalg.solve(H, -g)
    return move[:p], move[p:].reshape(w, k), schur


@pytest.mark.parametrize("loss", [EVEN, Loss(2.0, 1.5 * np.ones(len(CHANNEL_NAMES)), firm=True)])
def test_starts_eliminated_one_by_one_give_the_full_solution(problem: Problem, loss: Loss) -> None:
    free = list(free_parameters(problem))
    rng = np.random.default_rng(3)
    coordinates = 0.05 * rng.standard_normal(len(problem.parameters))
    starts = problem.starts + 0.3 * problem.start_sd * rng.standard_normal(problem.starts.shape)
    parameters, moved, information = solved_in_full(problem, loss, coordinates, starts)
    residuals, sensitivity = problem.linearised(coordinates, starts, free)
    reduced = reduce(problem, loss, residuals, sensitivity, starts)
    prior = problem.parameters.prior_information
    mine = -np.linalg.solve(
        reduced.matrix + prior[np.ix_(free, free)], reduced.gradient.sum(axis=0) + (prior @ coordinates)[free]
    )
    np.testing.assert_allclose(reduced.matrix, information, rtol=1e-6, atol=1e-6 * np.abs(information).max())
    np.testing.assert_allclose(mine, parameters, rtol=1e-5, atol=1e-9)
    along = -(reduced.back[:, :, -1] + reduced.back[:, :, :-1] @ mine)
    np.testing.assert_allclose(along, moved, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("firm", [False, True])
@pytest.mark.parametrize("inflation", [1.0, 3.0])
def test_weights_are_the_gradient_of_the_loss(problem: Problem, firm: bool, inflation: float) -> None:
    """d loss = 2 w r dr, also where samples and whole channels count less."""
    rng = np.random.default_rng(1)
    loss = Loss(inflation, rng.uniform(1.0, 3.0, len(CHANNEL_NAMES)), firm)
    residuals = 4.0 * rng.standard_normal(problem.samples.begin[-1]) * rng.choice([0.1, 1.0, 10.0])
    direction = rng.standard_normal(len(residuals))
    h = 1e-6
    ends = loss.totals(problem.samples, np.array([residuals + h * direction, residuals - h * direction])).sum(axis=1)
    expected = 2.0 * float(loss.weights(problem.samples, residuals) * residuals @ direction)
    assert (ends[0] - ends[1]) / (2.0 * h) == pytest.approx(expected, rel=1e-5)


def test_sensitivities_are_those_of_central_differences(problem: Problem) -> None:
    """Of a start's place and heading, which are not computed by differences, for every sample.

    Of all else for the usual sample: across a switch of eq. 16 no two steps agree.
    """
    free, origin, measured = free_parameters(problem), np.zeros(len(problem.parameters)), problem.starts
    _, sensitivity = problem.linearised(origin, measured, free)

    def differences(parameter: int | None = None, start: int | None = None, h: float = 1e-4) -> np.ndarray:
        coordinates, starts = np.array([origin, origin]), np.array([measured, measured])
        if parameter is not None:
            coordinates[:, parameter] += h, -h
        if start is not None:
            starts[0, :, start] += h
            starts[1, :, start] -= h
        flat = problem.flat_residuals(list(coordinates), starts)
        return (flat[0] - flat[1]) / (2.0 * h)

    for found, i in zip(sensitivity.parameters, free, strict=True):
        expected = differences(parameter=i)
        notices = np.abs(expected) > 1e-3 * np.quantile(np.abs(expected), 0.99)
        assert np.median(np.abs(found[notices] / expected[notices] - 1.0)) < 0.04
    for j, found in enumerate(sensitivity.starts):
        expected = differences(start=j)
        if j < 3:
            np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
        else:
            usual = np.sqrt(np.mean(np.minimum(np.abs(expected), np.quantile(np.abs(expected), 0.95)) ** 2))
            assert np.median(np.abs(found - expected)) < 0.05 * usual


def test_mu_s_judged_once_all_else_has_followed_leads_along_a_valley(problem: Problem) -> None:
    """What depends on the difference of both holds them together: a scan of mu_s and steps of all else get nowhere."""
    soft = problem.with_parameters(parameter_set(ROBOT, ("mu_s", "u_w")))
    truth, free = np.array([0.1, 0.1]), [1]
    of = linear(soft, truth, np.random.default_rng(3))
    of.parameter_rows[0] = 0.0
    of.parameter_rows[:, ::4] = [[200.0], [-200.0]]
    of.offset = truth @ of.parameter_rows
    point = evaluate(of, EVEN, [np.zeros(2)], of.starts)[0]
    for _ in range(5):
        point, _, _ = step(of, EVEN, scan(of, EVEN, point, FINE), free)
    assert np.abs(point.coordinates).max() < 0.02
    np.testing.assert_allclose(followed_scan(of, EVEN, point, free).coordinates, truth, atol=0.01)


def fitted(of: Linear) -> Node:
    free = free_parameters(of)
    point = evaluate(of, EVEN, [np.zeros(len(of.parameters))], of.starts)[0]
    for _ in range(3):
        point, _, _ = step(of, EVEN, point, free, damping=0.0)
    residuals, sensitivity = of.linearised(point.coordinates, point.starts, free)
    return Node(point, reduce(of, EVEN, residuals, sensitivity, point.starts))


def test_a_linear_problem_is_solved_by_one_step(problem: Problem) -> None:
    """Without robust weights at work: small noise, starts and truth."""
    soft = problem.with_parameters(parameter_set(ROBOT, ("k_l", "k_t", "u_w")))
    truth = np.array([0.01, -0.02, 0.015])
    found = linear(soft, truth, np.random.default_rng(5))
    found.offset = truth @ found.parameter_rows
    node = fitted(found)
    np.testing.assert_allclose(node.point.coordinates, truth, rtol=0.02)  # the prior draws a little to its middle


def test_intervals_of_linear_problems_cover(problem: Problem) -> None:
    """95 % of them, by the curvature and by the bootstrap; two thousand draws of 1200 numbers leave 3 % of doubt."""
    soft = problem.with_parameters(parameter_set(ROBOT, ("k_l", "k_t", "u_w")))
    free = free_parameters(soft)
    rng, inside, ratios = np.random.default_rng(11), [], []
    prior_sd = 1.0 / np.sqrt(np.diag(soft.parameters.prior_information))
    for _ in range(400):
        truth = 0.2 * prior_sd * rng.standard_normal(3)
        one = linear(soft, truth, rng)
        node = fitted(one)
        none = NoiseShare(node.point.coordinates, np.zeros((len(one), len(CHANNEL_NAMES))),
                          np.zeros((3, len(CHANNEL_NAMES))))  # fmt: skip
        spread = from_curvature(one, [node], free, none)
        known = one.parameters.mixing @ truth
        inside.append((spread.low <= known) & (known <= spread.high))
        if len(ratios) < 3:
            drawn = from_bootstrap(one, [node], free, none)
            ratios.append((drawn.high - drawn.low) / (spread.high - spread.low))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize(("gain", "cost", "held"), [(60.0, 60.0, True), (60.0, 600.0, False)])
def test_an_interval_holds_every_optimum_that_the_windows_do_not_tell_apart(
    problem: Problem, gain: float, cost: float, held: bool
) -> None:
    """Another optimum explains half of the windows better and the others worse: as much, or ten times as much."""
    soft = problem.with_parameters(parameter_set(ROBOT, ("k_l", "k_t", "u_w")))
    of = linear(soft, np.zeros(3), np.random.default_rng(7))
    here, count = fitted(of), len(of)
    away = here.point.coordinates + 0.3
    losses = here.point.losses + np.where(np.arange(count) % 2, cost, -gain)
    there = Node(replace(here.point, coordinates=away, losses=losses), here.reduced)
    none = NoiseShare(np.zeros(3), np.zeros((count, len(CHANNEL_NAMES))), np.zeros((3, len(CHANNEL_NAMES))))
    spread = from_bootstrap(of, [here, there], free_parameters(of), none)
    assert (spread.low < 0.1).all()
    assert (spread.high > 0.2).all() if held else (spread.high < 0.1).all()


def test_draws_depend_on_the_seed_alone(problem: Problem) -> None:
    """Not on the data, nor on where a fit stands; another seed draws others."""
    even = evaluate(problem, EVEN, [np.full(len(problem.parameters), 0.1)], problem.starts)[0]
    ends = [restarted_windows(replace(problem, seed=seed), EVEN, even) for seed in (0, 0, 1)]
    assert np.array_equal(ends[0].starts, ends[1].starts)
    assert not np.array_equal(ends[0].starts, ends[2].starts)
    by_hand = [replace(problem, seed=seed).generator(Draw.STARTS, 7).normal(size=4) for seed in (0, 0, 1)]
    assert np.array_equal(by_hand[0], by_hand[1]) and not np.array_equal(by_hand[0], by_hand[2])


def test_a_search_says_how_many_of_its_ends_are_the_best_one(problem: Problem) -> None:
    assert SearchReport.of(5, [10.0, 11.0, 40.0]) == SearchReport(5, 3, 2.0 / 3.0, 15.0)
    found = search(problem, Effort(starts=3, finalists=3)).report
    assert found is not None and found.restarts == 3 and 6 >= found.finalists >= 1
    assert 1.0 / found.finalists <= found.reached <= 1.0 and (found.reached == 1.0) == (found.scatter <= 1.0)
