"""Effects that the others make up for: what is not there is told from what is, and nothing else of the model moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.turns import EVEN, TURNS

from artibot_sim.diagnose.candidates.hypotheses import with_effect, without_effect
from artibot_sim.diagnose.selection.elimination import removal_of, superfluous, with_soil_searched
from artibot_sim.diagnose.selection.joint_fits import Rounds, settled
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")
TORQUE, COEFFICIENT = 12.0, 25.0
REAL = replace(ROBOT, effects={"joint_friction": {"torque": TORQUE}, "joint_damping": {"coefficient": COEFFICIENT}})
FRICTION, DAMPING, PAYLOAD = (
    Extension("joint_friction"), Extension("joint_damping"), Extension("payload", {"module": "front"})
)  # fmt: skip
OWN = {
    "joint_friction": FRICTION.coordinates({"torque": TORQUE}),
    "joint_damping": DAMPING.coordinates({"coefficient": COEFFICIENT}),
    "payload": np.full(1, 0.05),
}
LEAST = 58.0


@pytest.fixture(scope="module")
def problem() -> Problem:
    return problem_of([synthetic(REAL, TURNS, kappa=0.8, seed=4)], parameter_set(ROBOT), 5.0, 2)


def fitted(problem: Problem, *effects: Extension) -> tuple[Problem, Fit]:
    """The model with these, fitted from the truth."""
    for effect in effects:
        problem = with_effect(problem, effect)
    there = np.concatenate([np.zeros(5), *(OWN[effect.id] for effect in effects)])
    point = evaluate(problem, EVEN, [there], problem.starts)[0]
    return problem, converge(problem, point, EVEN, Rounds().few)


@pytest.mark.long
def test_both_of_two_that_are_there_are_needed(problem: Problem) -> None:
    for both in ((FRICTION, DAMPING), (DAMPING, FRICTION)):
        assert superfluous(*fitted(problem, *both), EVEN, LEAST, Rounds()) is None


@pytest.mark.long
def test_what_is_not_there_is_spare_wherever_it_stands_but_last(problem: Problem) -> None:
    for which, three in ((0, (PAYLOAD, FRICTION, DAMPING)), (1, (FRICTION, PAYLOAD, DAMPING))):
        beside, fit = fitted(problem, *three)
        found = superfluous(beside, fit, EVEN, LEAST, Rounds())
        assert found is not None and found.which == which and found.nats < LEAST
        assert found.problem.parameters.extensions == (FRICTION, DAMPING)
        effects = found.problem.parameters.robot_at(found.fit.point.coordinates).effects
        assert effects["joint_friction"]["torque"] == pytest.approx(TORQUE, rel=0.15)
        assert effects["joint_damping"]["coefficient"] == pytest.approx(COEFFICIENT, rel=0.3)
    last = fitted(problem, FRICTION, DAMPING, PAYLOAD)
    assert superfluous(*last, EVEN, LEAST, Rounds()) is None, "of the last one it is not asked"


@pytest.mark.long
def test_what_is_there_is_worth_what_it_gains(problem: Problem) -> None:
    both, fit = fitted(problem, FRICTION, DAMPING)
    for which, kept in ((0, DAMPING), (1, FRICTION)):
        alone, other = fitted(problem, kept)
        found = removal_of(both, fit, EVEN, which, Rounds())
        assert found.nats > 2.0 * LEAST
        assert found.fit.point.cost <= other.point.cost + 2.0 * Rounds().worth
        assert found.problem.parameters.extensions == alone.parameters.extensions


@pytest.mark.long
def test_a_soil_that_made_up_for_an_effect_gives_way_beside_it(problem: Problem) -> None:
    """From a soil far away steps with the effects in end behind the fit that begins at the truth."""
    both, right = fitted(problem, FRICTION, DAMPING)
    there = np.concatenate([[-2.5, -2.5, -0.9, -0.9, 0.0], OWN["joint_friction"], OWN["joint_damping"]])
    point = evaluate(both, EVEN, [both.parameters.inside(there)], both.starts)[0]
    stuck = converge(both, point, EVEN, Rounds().few)
    assert stuck.point.cost > right.point.cost + 2.0 * LEAST, "it is stuck"
    found = with_soil_searched(both, stuck.point, EVEN, Rounds())
    assert found.point.cost < settled(both, stuck.point, EVEN, Rounds()).point.cost
    assert found.point.cost <= right.point.cost + 2.0 * Rounds().worth


def test_leaving_one_out_leaves_the_others_where_they_are(problem: Problem) -> None:
    three, fit = fitted(problem, FRICTION, PAYLOAD, DAMPING)
    there = np.arange(8.0) / 10.0
    for which in range(3):
        part, point = without_effect(three, EVEN, replace(fit.point, coordinates=there), which)
        assert np.array_equal(point.coordinates, np.delete(there, 5 + which))
        assert len(part.parameters.extensions) == 2


def test_leaving_out_where_a_point_is_tracked_leaves_the_rover_s_motion(problem: Problem) -> None:
    """Starts that stayed would be another motion, with other forces: the model without would seem worse than it is."""
    more = with_effect(problem, Extension("pose_lever_arm"))
    there = np.append(np.zeros(5), [1.0, 0.5])
    point = evaluate(more, EVEN, [there], more.starts)[0]
    part, left = without_effect(more, EVEN, point)
    channels = [CHANNEL_NAMES.index(name) for name in ("yaw_rate", "torque_front")]
    elsewhere = np.flatnonzero(np.isin(part.samples.channel, channels))
    assert left.residuals.flat[elsewhere] == pytest.approx(point.residuals.flat[elsewhere], abs=1e-6)
    stayed = evaluate(part, EVEN, [np.zeros(5)], point.starts)[0]
    assert np.abs(stayed.residuals.flat - point.residuals.flat)[elsewhere].max() > 1.0
    assert left.cost == evaluate(part, EVEN, [np.zeros(5)], left.starts)[0].cost
