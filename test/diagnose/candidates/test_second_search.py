"""A baseline on a soil that is none: once a search has bettered it another one is made, and the right effect named."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.hidden import case
from diagnose.searches import FEW, baseline, try_only

from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.selection.stepwise import StepwiseSelection
from artibot_sim.diagnose.timetable import Timetable
from artibot_sim.estimation.search import Fit, free_parameters
from artibot_sim.estimation.solver import evaluate, reduce
from artibot_sim.model import load_robot

AWAY = np.array([0.5, -0.5, 0.35, 0.35, 0.0])
"""Of the soil's logarithms. With one search alone joint_friction is named first."""


@pytest.mark.long
def test_the_right_effect_is_named_from_a_baseline_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    try_only(monkeypatch, *FEW)
    hidden = case(("joint_damping",), seed=31, runs=2, held_out=0, duration=14.0, manoeuvres=("eight", "stop_and_go"))
    robot, options = load_robot("agriq"), Options()
    problem, fit = baseline(hidden.recordings, robot, options)
    there = problem.parameters.inside(fit.point.coordinates + AWAY)
    point = evaluate(problem, fit.loss, [there], problem.starts)[0]
    free = free_parameters(problem)
    residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    far = Fit(point, fit.loss, reduce(problem, fit.loss, residuals, sensitivity, point.starts), free, False)
    found = StepwiseSelection(problem, far, options, Timetable(), command_view(hidden.recordings, robot)).decide()
    assert [named.effect for named in found.named] == ["joint_damping"]
    assert np.abs(found.neutral_fit.point.coordinates - fit.point.coordinates).max() < 0.2 * np.abs(AWAY).max()
    assert found.stages[0].bettered(3) < 100.0, "the search that counts began at its own baseline"
