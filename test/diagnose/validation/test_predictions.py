"""What each of two causes is worth on held-out data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.commands.view import command_view
from artibot_sim.diagnose.records import EffectEstimate, Options
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.forward import SearchStage
from artibot_sim.diagnose.validation.predictions import gains, improvements, likelihood_interval, predict
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.identify.validation import PredictedRecording
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")
LAG, TORQUE = 0.25, 12.0
REAL = replace(ROBOT, effects={"joint_friction": {"torque": TORQUE}, "speed_loop_lag": {"time_constant": LAG}})
OPTIONS = Options(horizon=3.0)


def turn_at(problem: Problem, own: np.ndarray) -> SearchStage:
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(problem, loss, [np.concatenate([np.zeros(5), own])], problem.starts)[0]
    return SearchStage((), (), {}, problem, Fit(point, loss, None, (), True), loss, point.cost)  # type: ignore[arg-type]


@pytest.mark.parametrize("lag_first", [False, True])
def test_each_cause_takes_its_own_error_away(lag_first: bool) -> None:
    run = synthetic(REAL, random_manoeuvre(np.random.default_rng(2), 12.0), duration=12.0, kappa=0.8, seed=3)
    problem, friction = problem_of([run], parameter_set(ROBOT), 5.0, 1), Extension("joint_friction")
    stages = (
        turn_at(problem, np.empty(0)),
        turn_at(with_effect(problem, friction), friction.coordinates({"torque": TORQUE})),
    )
    named = [
        Named("joint_friction", 500.0, ()),
        Named("speed_loop_lag", 400.0, (), {"time_constant": EffectEstimate(LAG, "s")}),
    ]
    fits = tuple((one.problem, one.fit) for one in stages)
    decision = Decision(tuple(named[::-1] if lag_first else named), 40.0, fits, stages, {})
    pair = predict(run, True, ROBOT, REAL, OPTIONS.horizon, 1)
    found = improvements(decision, [pair], REAL, command_view([run], ROBOT), OPTIONS)
    assert set(found) == {"joint_friction", "speed_loop_lag"}
    assert all(0.0 < one.share <= 1.0 for one in found.values()), found
    assert all(one.nats > 100.0 for one in found.values()), found
    second = list(found)[1]
    assert found[second].share > 0.8, "after the second cause noise is left"
    assert 1.0 - np.prod([1.0 - one.share for one in found.values()]) > 0.9
    interval = likelihood_interval([pair], found, 1)
    assert interval is not None and 0.0 < interval[0] <= sum(one.nats for one in found.values()) <= interval[1]


def test_what_is_not_there_makes_nothing_likelier() -> None:
    """Held out is a rover without the lag that was named: its commands speak against that."""
    run = synthetic(ROBOT, random_manoeuvre(np.random.default_rng(2), 12.0), duration=12.0, kappa=0.8, seed=3)
    problem = problem_of([run], parameter_set(ROBOT), 5.0, 1)
    stages = (turn_at(problem, np.empty(0)),)
    named = (Named("speed_loop_lag", 400.0, (), {"time_constant": EffectEstimate(LAG, "s")}),)
    decision = Decision(named, 40.0, ((problem, stages[0].fit),), stages, {})
    slow = replace(ROBOT, effects={"speed_loop_lag": {"time_constant": LAG}})
    pair = predict(run, True, ROBOT, slow, OPTIONS.horizon, 1)
    found = improvements(decision, [pair], slow, command_view([run], ROBOT), OPTIONS)
    assert found["speed_loop_lag"].nats < -100.0
    interval = likelihood_interval([pair], found, 1)
    assert interval is not None and interval[1] < 0.0, "commands count, which have no windows"
    assert likelihood_interval([pair], {}, 1) is None


def test_a_median_window_is_not_decided_by_the_one_in_which_a_pose_leapt() -> None:
    run = synthetic(REAL, random_manoeuvre(np.random.default_rng(2), 25.0), duration=25.0, kappa=0.8, seed=3)
    pair = predict(run, True, ROBOT, REAL, OPTIONS.horizon, 1)
    whole = gains([pair], [], 1)["articulation_yaw"]
    assert whole.median_ci95[0] > 0.0 and whole.median_after < whole.median_before

    def leapt(of: PredictedRecording) -> PredictedRecording:
        return replace(of, residuals=(of.residuals[0] + 1e4, *of.residuals[1:]))

    lost = replace(pair, before=leapt(pair.before), after=leapt(pair.after))
    spoilt = gains([lost], [], 1)["articulation_yaw"]
    assert spoilt.before > 10.0 * whole.before and spoilt.ci95[0] <= 0.0
    assert spoilt.median_ci95[0] > 0.0 and spoilt.median_after < spoilt.median_before < 2.0 * whole.median_before
