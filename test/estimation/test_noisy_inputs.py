"""Noise of measured rotations: as large as encoders' steps make it, and larger in what grips more."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.estimation.encoder_noise import answers, with_noisy_inputs
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.solver import Point, evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import load_robot
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Stop

ROBOT = load_robot("agriq")
TURN = Manoeuvre("turn", (Dwell(0.5), Ramp(speed=0.5), Arc(radius=2.0, angle=2.0), Stop()), a_max=0.5, blend=0.3)
BACK = CHANNEL_NAMES.index("torque_back")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return problem_of([synthetic(ROBOT, TURN, kappa=0.8, seed=6)], parameter_set(ROBOT), 5.0, 2)


@pytest.fixture(scope="module")
def noisy(problem: Problem) -> Problem:
    return with_noisy_inputs(problem, 0)


def typical(noisy: Problem, problem: Problem, point: Point) -> float:
    """Share of the noise of back torques that comes from the rotations."""
    return float(np.nanmedian(answers(problem, noisy, point)[:, BACK]))


def test_rotations_err_as_neighbouring_samples_show(problem: Problem, noisy: Problem) -> None:
    for old, new in zip(problem.stretches, noisy.stretches, strict=True):
        assert len(old.inputs.t) == len(new.inputs.t)
        turning = np.abs(old.inputs.velocity).min(axis=1) > 20.0
        change = (new.inputs.velocity - old.inputs.velocity)[turning]
        assert 0.005 < np.sqrt(np.mean(change**2)) < 0.2  # a count is 3 mrad, a fit is over some 80 ms
        standing = np.abs(old.inputs.velocity).max(axis=1) == 0.0
        assert np.abs((new.inputs.velocity - old.inputs.velocity)[standing]).max(initial=0.0) < 1e-9


def test_what_grips_more_answers_more(problem: Problem, noisy: Problem) -> None:
    point = fitted_starts(problem, 2)
    values = problem.parameters.values(point.coordinates)
    values[problem.parameters.index("contact.k_l")] *= 0.7
    softer = evaluate(problem, Loss(1.0, np.ones(len(CHANNEL_NAMES))), [problem.parameters.coordinates(values)],
                      point.starts)[0]  # fmt: skip
    assert 0.0 < typical(noisy, problem, softer) < 0.8 * typical(noisy, problem, point) < 1.0


def test_the_same_seed_draws_the_same(problem: Problem, noisy: Problem) -> None:
    again = with_noisy_inputs(problem, 0)
    assert np.array_equal(again.stretches[0].inputs.velocity, noisy.stretches[0].inputs.velocity)
