"""Where held-out errors come from: ground that differs from window to window is found, and none where it does not."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest
from scipy.stats import norm

from artibot_sim.diagnose.records import HALF_WIDTH
from artibot_sim.diagnose.validation.error_budget import error_budget, shares
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.search import Fit, converge, thinned
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.validation import hold_out
from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import Dwell, Eight, Manoeuvre

EIGHT = Manoeuvre("eight", (Dwell(0.3), Eight(radius=1.8, smooth=True, speed=0.6)), a_max=1.0, blend=0.3)
HORIZON = 4.0
RUNS = 10
SPREAD = 0.3


def budget_of(factors: np.ndarray):
    """Of runs of 13 s with these factors on k_t, half of them held out, from a fit that begins at the true middle."""
    robot = load_robot("agriq")
    runs = [
        synthetic(
            robot.replace({"contact.k_t": float(f * robot.contact.k_t)}), EIGHT, seed=k, name=f"run{k}", duration=13.0
        )
        for k, f in enumerate(factors)
    ]
    fitted, held = runs[::2], runs[1::2]
    problem = problem_of(fitted, parameter_set(robot, ("k_l", "k_t")), HORIZON, 1, HALF_WIDTH, 0)
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    fit = converge(problem, evaluate(problem, loss, [np.zeros(2)], problem.starts)[0], loss, 3)
    fit = Fit(**{**vars(fit), "loss": thinned(problem, fit)})
    final: Robot = problem.parameters.robot_at(fit.point.coordinates)
    predicted = [hold_out(one, final, HORIZON, 1, half_width=HALF_WIDTH) for one in held]
    return error_budget(problem, fit, predicted, {}, {}, 0)


def test_soil_that_differs_is_said_to_vary():
    budget, varies = budget_of(np.exp(SPREAD * np.repeat(norm.ppf((np.arange(RUNS) + 0.5) / RUNS), 2)))
    assert varies is not None
    assert varies.parameter == "k_t" or "k_t" in varies.ties
    assert varies.spread == pytest.approx(SPREAD, rel=0.5)
    assert varies.ci95[0] > 0.0
    assert budget["position"].ground_varies > 0.15  # 0.20 to 0.26 with five draws of the noise


@pytest.mark.long
def test_soil_that_is_the_same_does_not():
    budget, varies = budget_of(np.ones(2 * RUNS))
    assert varies is None
    assert budget["position"].ground_varies == 0.0
    assert budget["position"].sensors + budget["position"].timing > 0.6


@pytest.mark.parametrize("parts", [(0.01, 0.0, 0.3, 0.2), (2.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
def test_shares_add_up(parts):
    found = astuple(shares(2.0, 1.5, *parts))
    assert sum(found) == pytest.approx(1.0)
    assert min(found) >= 0.0
    assert found[0] == pytest.approx(0.25)
