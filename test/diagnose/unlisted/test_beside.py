"""An effect and a force on no list: both are found where both act, and the force alone where it acts alone."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.hidden import case
from diagnose.turns import EVEN

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.unlisted.beside import Explanations
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.run import problem_of
from artibot_sim.model import load_robot

SLOPE = {"grade": 0.002, "heading": 0.5}
"""Where the fit of a slope begins that is not there."""


def with_slope(*hidden: str) -> tuple[Decision, dict]:
    """What a search of the lists may come to that names a slope; and the truth about it."""
    found = case(hidden, 1.0, 4, runs=3, held_out=0, duration=15.0)
    robot = load_robot("agriq")
    problem = problem_of(found.recordings, parameter_set(robot, SOIL), 4.0, 1)
    soil = problem.parameters.coordinates([found.truth.soil[name] for name in SOIL])
    neutral = converge(problem, evaluate(problem, EVEN, [soil], problem.starts)[0], EVEN, 8)
    slope = sized("slope", robot)
    larger, truth = with_effect(problem, slope), dict(found.truth.effects.get("slope", {}))
    begin = np.concatenate([neutral.point.coordinates, slope.coordinates(truth or SLOPE)])
    fit = converge(larger, evaluate(larger, EVEN, [begin], neutral.point.starts)[0], EVEN, 8)
    left = remains(larger, fit.point)
    assert leaves_more_than_noise(left)
    named = (Named("slope", 1000.0, ()),)
    return Decision(named, 58.0, problem, neutral, larger, fit, (), {}, left), truth


def test_a_force_is_found_beside_an_effect_and_the_effect_stays() -> None:
    found, truth = with_slope("slope", "joint_preload")
    explanations = Explanations(found)
    best = explanations.best()
    assert best is not None and best.effects == (0,)
    both = explanations.decision(best)
    assert [one.effect for one in both.named] == ["slope"] and not leaves_more_than_noise(both.left)
    problem, fit = both.whole
    robot = problem.parameters.robot_at(fit.point.coordinates)
    assert robot.effects["slope"]["grade"] == pytest.approx(truth["grade"], rel=0.1)
    law = robot.effects["force_law"]
    assert (law["where"], law["variable"]) == ("joint", "nothing") and abs(law["size"]) == pytest.approx(12.0, rel=0.15)


def test_an_effect_that_is_not_there_is_not_needed_beside_the_force() -> None:
    found, _ = with_slope("joint_preload")
    best = Explanations(found).best()
    assert best is not None and best.effects == () and len(best.laws.spans) == 1
