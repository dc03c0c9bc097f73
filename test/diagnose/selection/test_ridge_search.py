"""Far other sizes of an effect: nearer to the truth, and never to a worse place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.selection.ridge_search import at_size, from_far_sizes
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, free_parameters
from artibot_sim.estimation.solver import evaluate, reduce
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")
MASS = 15.0
LOSS = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
PAYLOAD = Extension("payload", {"module": "front"})


@pytest.fixture(scope="module")
def problem() -> Problem:
    real = replace(ROBOT, effects={"payload": {"mass": MASS, "module": "front"}})
    run = synthetic(real, random_manoeuvre(np.random.default_rng(2), 12.0), duration=12.0, kappa=0.8, seed=3)
    return problem_of([run], parameter_set(ROBOT), 5.0, 2)


def held_at(problem: Problem, coordinates: np.ndarray) -> Fit:
    """A fit that stands at some place."""
    point = evaluate(problem, LOSS, [coordinates], problem.starts)[0]
    free = free_parameters(problem)
    residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    return Fit(point, LOSS, reduce(problem, LOSS, residuals, sensitivity, point.starts), free, False)


@pytest.mark.parametrize("share", [0.3, 1.0, 2.5])
def test_a_leap_reaches_a_size_that_is_far_away(problem: Problem, share: float) -> None:
    beside = with_effect(problem, PAYLOAD)
    fit = held_at(beside, np.append(np.zeros(5), share * PAYLOAD.coordinates({"mass": MASS, "module": "front"})))
    found = from_far_sizes(beside, LOSS, fit, 2)
    mass = PAYLOAD.values(found.point.coordinates[-1:])["mass"]
    assert found.point.cost <= fit.point.cost
    assert abs(mass - MASS) <= max(0.4 * abs(share * MASS - MASS), 0.15 * MASS)


def test_without_an_effect_there_is_no_other_size(problem: Problem) -> None:
    fit = held_at(problem, np.zeros(5))
    assert from_far_sizes(problem, LOSS, fit, 2) is fit


def test_an_effect_of_known_size_takes_its_share_from_the_soil(problem: Problem) -> None:
    plain = held_at(problem, np.zeros(5))
    more, fit = at_size(problem, plain, PAYLOAD, PAYLOAD.coordinates({"mass": MASS, "module": "front"}), 1)
    assert fit.point.cost < plain.point.cost
    assert PAYLOAD.values(fit.point.coordinates[-1:])["mass"] == pytest.approx(MASS, rel=0.15)
    assert more.parameters.extensions == (PAYLOAD,)
