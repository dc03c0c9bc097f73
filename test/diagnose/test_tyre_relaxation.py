"""Lateral forces that lag: windows start with what the way before them built up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.hidden.cases import Case, case

from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.estimation.measurements import PAST
from artibot_sim.estimation.parameters import ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.windows import Past, _in_modules, lagging_forces, time_over
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import load_robot
from artibot_sim.model.robot.derived import params

LENGTH = 0.3
ROBOT = replace(load_robot("agriq"), effects={"tyre_relaxation": {"length": LENGTH}})


@pytest.fixture(scope="module")
def hidden() -> Case:
    """Recordings of another simulator than ours."""
    return case(
        ("tyre_relaxation",), 1.0, 5, runs=2, held_out=1, duration=14.0, manoeuvres=("eight", "slalom", "stop_and_go")
    )


def known(hidden: Case) -> Problem:
    """Its windows, soil and effect as they are."""
    soil = {f"contact.{name}": value for name, value in hidden.truth.soil.items()}
    robot = replace(ROBOT.replace(soil), effects={name: dict(v) for name, v in hidden.truth.effects.items()})
    return problem_of(hidden.recordings, ParameterSet(robot, ()), 5.0, 2)


def test_forces_are_a_mean_over_the_way_that_wheels_came() -> None:
    """Of a wheel that drifted aside until `way` before the start, exp(−way / length) is left."""
    way = 0.2
    past = Past(np.array([[5.0, way, 0.0]]), np.zeros((1, 2, 2, 5)))
    past.lateral[0, 0, 0, 0] = 0.1
    q, v = np.zeros((1, 16)), np.zeros((1, 16))
    zero = np.zeros(1, np.int64)
    forces = lagging_forces([ROBOT], zero, zero, q, v, past)[0]
    expected = -params(ROBOT).front.k_t * 0.1 * np.exp(-way / LENGTH)
    assert forces[:4] == pytest.approx(np.full(4, expected))
    assert forces[4:] == pytest.approx(np.zeros(4))


def test_where_the_tracked_point_sits_and_how_it_is_turned_is_taken_off() -> None:
    """Of the same way, measured at the origin and beside it, at an angle, the same forces are left."""
    x, y, angle, bend = 0.3, -0.2, 1e-3, 0.4
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 1.0, PAST)
    rate, forward, left = 0.3 * np.sin(3.0 * t), 0.5 + 0.1 * t, 0.05 * rng.standard_normal(len(t))
    zero = np.zeros((2, len(t)))
    forces = []
    for arm_x, arm_y, turned in ((0.0, 0.0, 0.0), (x, y, angle)):
        motion = np.column_stack(
            [*zero, zero[0] + turned, forward - arm_y * rate, left + arm_x * rate, rate, bend + zero[0], zero[0]]
        )
        _, aside = _in_modules(motion, [(0.4, 0.4)])
        past = Past(0.03 * np.arange(len(t), -1, -1)[None], (aside - aside[-1])[None])
        robot = replace(ROBOT, effects=dict(ROBOT.effects) | {
            "pose_lever_arm": {"x": arm_x, "y": arm_y}, "pose_heading_offset": {"angle": turned},
        })  # fmt: skip
        none = np.zeros(1, np.int64)
        forces.append(lagging_forces([robot], none, none, np.zeros((1, 16)), np.zeros((1, 16)), past)[0])
    assert np.abs(forces[0]).min() > 1.0
    assert forces[1] == pytest.approx(forces[0], rel=1e-4)  # to first order in the angle


def test_without_the_effect_nothing_lags() -> None:
    past = Past(np.array([[1.0, 0.0]]), np.ones((1, 1, 2, 5)))
    zero = np.zeros(1, np.int64)
    assert not lagging_forces([load_robot("agriq")], zero, zero, np.zeros((1, 16)), np.ones((1, 16)), past).any()


def test_the_true_rover_leaves_noise(hidden: Case) -> None:
    problem = known(hidden)
    left = remains(problem, fitted_starts(problem, 2))
    assert left["position"].typical < 2.6 and not leaves_more_than_noise(left), left


def test_the_time_over_a_way_is_that_in_which_it_is_driven(hidden: Case) -> None:
    stretch = known(hidden).stretches[0]
    times, motion = stretch.motion
    for begin in (4.0, 6.5):
        for way in (0.3, 0.9):
            end = begin + time_over(stretch, begin, way)
            driven = np.hypot(*np.diff(motion[(times >= begin) & (times <= end), :2], axis=0).T).sum()
            assert driven == pytest.approx(way, abs=0.15)
    assert time_over(stretch, 4.0, 0.0) == 0.0


@pytest.mark.parametrize("remembers", [True, False])
def test_what_a_window_began_with_is_no_force(hidden: Case, remembers: bool) -> None:
    """Errors of its first tenth of a second are the start's where tyres remember."""
    problem = known(hidden)
    if not remembers:
        problem = problem.with_parameters(ParameterSet(replace(problem.parameters.robot, effects={}), ()))
    point = fitted_starts(problem, 2)
    begun = [np.where(w.plan.t < 0.1, 40.0, one) for w, one in zip(problem.windows, point.residuals, strict=True)]
    clean, spoiled = (
        remains(problem, point),
        remains(problem, replace(point, residuals=problem.parts(np.concatenate(begun)))),
    )
    assert (spoiled == clean) is remembers
