"""What changes with time or speed is told from what stays, though a constant explains most of both."""

from __future__ import annotations

import numpy as np
import pytest
from diagnose.hidden import case

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.validation.stability import drifts
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import SOIL, Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot


def fitted(hidden: str, severity: float, seed: int, by: str = "motor_drag") -> tuple[Problem, Fit]:
    """Recordings in which something is hidden, by a model with an effect, from the true soil."""
    found = case((hidden,), severity, seed, runs=2, held_out=0, duration=30.0)
    acting = {**found.truth.effects, **found.truth.unlisted}[hidden]
    plain = problem_of(found.recordings, parameter_set(load_robot("agriq"), SOIL), 5.0, 2)
    extension = Extension(by, {"motor": acting["motor"]} if by == "motor_drag" else {})
    problem = with_effect(plain, extension)
    soil = plain.parameters.coordinates([found.truth.soil[name] for name in SOIL])
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    begin = evaluate(problem, loss, [np.concatenate([soil, [0.2]])], problem.starts)[0]
    return problem, converge(problem, begin, loss, 4)


@pytest.mark.long
def test_a_drag_that_fades_drifts() -> None:
    assert drifts(*fitted("cold_gear", 0.3, 3))["motor_drag"] > 58.0


def test_a_drag_that_grows_otherwise_with_speed_does() -> None:
    """In time nothing changes; where it is fast and turns tightly the resistance seems another."""
    assert drifts(*fitted("air_drag", 1.0, 4, "rolling_resistance_speed"))["rolling_resistance_speed"] > 58.0


@pytest.mark.parametrize(("effect", "severity"), [("motor_drag", 0.3), ("rolling_resistance_speed", 1.0)])
def test_what_is_there_does_not(effect: str, severity: float) -> None:
    assert 0.0 <= drifts(*fitted(effect, severity, 4, effect))[effect] < 15.0


def test_without_effects_there_is_nothing_to_drift() -> None:
    found = case((), 1.0, 3, runs=1, held_out=0, duration=20.0)
    problem = problem_of(found.recordings, parameter_set(load_robot("agriq"), SOIL), 5.0, 2)
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(problem, loss, [np.zeros(len(SOIL))], problem.starts)[0]
    assert drifts(problem, converge(problem, point, loss, 1)) == {}
