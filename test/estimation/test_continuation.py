"""The search's continuation: eq. 16 without its jump, then with one that grows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.hidden.cases import case
from diagnose.hidden.logged import VARYING

from artibot_sim.estimation.alignment import on_one_clock
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import MU_D, MU_S, SOIL
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Effort, converge, first_guesses, jump_opened, search, without_jump
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot

EVEN = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
ROBOT = load_robot("husky_driven")
FACTORS = (0.4, 1.0, 2.5)


@pytest.fixture(scope="module", params=[pytest.param(61, marks=pytest.mark.long), 62])
def problem(request: pytest.FixtureRequest) -> Problem:
    """A Husky whose wheels the ground resists, in each place otherwise, and a model that knows nothing of it."""
    hidden = case(("wheel_resistance", VARYING), 1.0, request.param, runs=2, duration=40.0, robot="husky_driven")
    recordings = [one.experiment for one in on_one_clock(hidden.recordings, ROBOT, 0)]
    return problem_of(recordings, parameter_set(ROBOT), 2.0, 1)


def soils(problem: Problem) -> list[np.ndarray]:
    """Soils of very different stiffness and grip."""
    values = problem.parameters.values(np.zeros(len(problem.parameters)))
    moved = []
    for factor in FACTORS:
        one = values.copy()
        one[: SOIL.index("mu_s")] *= factor
        moved.append(problem.parameters.inside(problem.parameters.coordinates(one)))
    return moved


@pytest.mark.parametrize("fit", [SOIL, ("mu_s", "mu_d"), ("k_l", "mu_s"), ("k_t", "mu_d"), ("u_w",)])
def test_mu_s_follows_mu_d_while_its_jump_is_held(fit: tuple[str, ...]) -> None:
    free = parameter_set(ROBOT, fit)
    held = replace(free, jump=1.3)
    rng = np.random.default_rng(3)
    for size in (0.1, 0.5, 3.0):
        inside = held.inside(size * rng.standard_normal(len(held)))
        values = held.values(inside)
        low, high = np.array([(p.low, p.high) for p in held.parameters]).T
        assert (values >= low * (1.0 - 1e-12)).all() and (values <= high * (1.0 + 1e-12)).all()
        robot = held.robot_at(inside)
        if "mu_s" in fit:
            assert robot.contact.mu_s == pytest.approx(1.3 * robot.contact.mu_d, rel=1e-12)
        assert np.allclose(free.values(inside), values, rtol=1e-12), "its own coordinate goes along"
    assert held.keys == free.keys


def test_a_search_ends_where_the_best_of_its_ways_does(problem: Problem) -> None:
    """A jump that grows from none, and one that is there from the start: neither is enough."""
    effort = Effort()
    guesses = first_guesses(problem, effort)[:3]
    smooth = min((without_jump(problem, guess, EVEN, effort.first) for guess in guesses), key=lambda end: end.cost)
    continued = converge(problem, jump_opened(problem, EVEN, smooth), EVEN, effort.last).point.cost
    straight = [
        converge(problem, evaluate(problem, EVEN, [guess], problem.starts)[0], EVEN, effort.first).point.cost
        for guess in guesses
    ]
    found = search(problem, effort)
    assert found.point.cost <= min(continued, *straight) + 1e-6
    assert abs(continued - min(straight)) > 20.0, "two ways, two ends"
    assert found.report is not None and found.report.restarts == effort.starts and found.report.reached < 1.0


def test_guesses_are_of_very_different_ground(problem: Problem) -> None:
    """The robot file's first, softer and stiffer ground, then others: each parameter's draws fill its range evenly."""
    values = np.array([problem.parameters.values(guess) for guess in first_guesses(problem, Effort())])
    k_l, k_t, mu_s, mu_d, _ = values.T
    middles = [parameter.prior.value for parameter in problem.parameters.parameters]
    assert values[0] == pytest.approx(middles)
    assert k_l[1] < k_l[0] < k_l[2] and k_l[1:3] / k_l[0] == pytest.approx(k_t[1:3] / k_t[0], rel=0.01)
    assert (mu_d <= mu_s * (1.0 + 1e-12)).all()
    places = np.sort(np.log(k_l[3:] / middles[0]))
    assert np.diff(places).max() < 2.5 * np.ptp(places) / (len(places) - 1), "none is left out"


def test_opening_the_jump_never_loses_what_was_found(problem: Problem) -> None:
    end = without_jump(problem, soils(problem)[1], EVEN, 25)
    opened = jump_opened(problem, EVEN, end)
    assert opened.cost <= end.cost + 1e-6
    values = dict(zip(problem.parameters.keys, problem.parameters.values(opened.coordinates), strict=True))
    assert values[MU_S] >= values[MU_D]


def test_a_search_is_judged_by_the_loss_that_it_is_given(problem: Problem) -> None:
    halved = Loss(1.0, np.full(len(CHANNEL_NAMES), 2.0))
    found = search(problem, Effort(starts=1), loss=halved)
    again = evaluate(problem, halved, [found.point.coordinates], found.point.starts)[0]
    assert found.loss == halved and found.point.cost == pytest.approx(again.cost, rel=1e-9)
    assert found.point.cost < 0.9 * evaluate(problem, EVEN, [found.point.coordinates], found.point.starts)[0].cost
