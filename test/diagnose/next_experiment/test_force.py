"""What to measure next for a force on no list: what a manoeuvre promises comes when another simulator drives it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnose.hidden import case
from diagnose.hidden.cases import experiment, recipe, run
from diagnose.hidden.machine import machine
from diagnose.hidden.rover import at_rest
from diagnose.hidden.sensors import Noise

from artibot_sim.diagnose.next_experiment.choice import (
    ENOUGH,
    duration,
    expected,
    known_equations,
    law,
    next_for_force,
    recording,
    rivals,
    separation,
)
from artibot_sim.diagnose.next_experiment.simulation import KAPPA, LIBRARY, LibraryManoeuvre
from artibot_sim.diagnose.unlisted.finding import ForceFinding, search_forces
from artibot_sim.diagnose.unlisted.forms import TIME, WANDERING
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.problem import Problem
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import plan

AGRIQ = load_robot("agriq")
LEVELS = {
    "position": 0.0035, "yaw_rate": 0.004, "articulation_yaw": 0.002, "torque_front": 0.022, "torque_back": 0.022,
}  # fmt: skip
BY_NAME = {entry.name: entry for entry in LIBRARY}
SHORT = [BY_NAME[name] for name in ("bends", "stop_and_go", "creep")]


@cache
def found_in(name: str) -> tuple[Problem, ForceFinding, dict, dict]:
    """Recordings of a rover on which such a force acts, what was found in them, the truth about it and the soil."""
    hidden = case((name,), 1.0, 2, runs=3, held_out=0, duration=30.0)
    problem = problem_of(hidden.recordings, parameter_set(AGRIQ, SOIL), 5.0, 2)
    soil = problem.parameters.coordinates([hidden.truth.soil[key] for key in SOIL])
    return problem, search_forces(problem, soil), hidden.truth.unlisted[name], hidden.truth.soil


def robot_of(problem: Problem, found: ForceFinding) -> Robot:
    return problem.parameters.robot_at(found.soil)


def driven_elsewhere(name: str, entry: LibraryManoeuvre) -> Experiment:
    """A recording of the manoeuvre as the tests' own simulator drives it, the force at work."""
    _, _, truth, soil = found_in(name)
    plain = machine(AGRIQ, dict(soil), KAPPA)
    pushed = recipe(name).apply(plain, truth)
    planned = plan(entry.manoeuvre, AGRIQ)
    t = np.arange(0.0, planned.duration, 0.01)
    drive = run(pushed, plain, KAPPA, entry.name, t, planned.at(t).velocity, at_rest(pushed.rover, 0.0, 0.0, entry.yaw))
    return experiment(drive, Noise(), np.random.default_rng(7), entry.name)


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("joint_preload", "bends"),
        *(
            pytest.param(*both, marks=pytest.mark.long)
            for both in (("joint_preload", "stop_and_go"), ("joint_preload", "creep"), ("yaw_drag", "slalom"))
        ),
    ],
)
def test_what_is_expected_comes(name: str, entry: str) -> None:
    problem, found, _, _ = found_in(name)
    robot, first, others = robot_of(problem, found), found.chosen[0], rivals(found)
    wanted = expected(robot, recording(robot, BY_NAME[entry], (0.0, 0.0), LEVELS), first, others)
    came = separation(*known_equations(robot, driven_elsewhere(name, BY_NAME[entry])), first, others)
    assert wanted > 10.0
    assert wanted / 2.5 < came < 2.5 * wanted


@pytest.mark.long
def test_where_a_force_does_nothing_nothing_is_expected() -> None:
    problem, found, _, _ = found_in("yaw_drag")
    robot = robot_of(problem, found)
    straight, bends = (
        expected(robot, recording(robot, BY_NAME[name], (0.0, 0.0), LEVELS), found.chosen[0], rivals(found))
        for name in ("forth_and_back", "bends")
    )
    assert straight < 0.1 < 5.0 < bends


def test_noise_costs_and_so_does_what_is_not_measured() -> None:
    problem, found, _, _ = found_in("joint_preload")
    robot, first, others = robot_of(problem, found), found.chosen[0], rivals(found)
    loud = {channel: 6.0 * sigma for channel, sigma in LEVELS.items()}
    blind = {channel: LEVELS[channel] for channel in ("position", "torque_front", "torque_back")}
    usual, *worse = (
        expected(robot, recording(robot, BY_NAME["creep"], (0.0, 0.0), noise), first, others)
        for noise in (LEVELS, loud, blind)
    )
    assert max(worse) < 0.8 * usual


def test_the_shortest_that_is_enough_is_chosen() -> None:
    problem, found, _, _ = found_in("joint_preload")
    advice = next_for_force(problem, found, LEVELS, library=SHORT)
    assert advice is not None and advice.nats > ENOUGH
    robot = robot_of(problem, found)
    for entry in SHORT:
        if duration(entry, AGRIQ) < duration(BY_NAME[advice.manoeuvre], AGRIQ):
            driven = recording(robot, entry, (0.0, 0.0), LEVELS)
            assert expected(robot, driven, found.chosen[0], rivals(found)) < ENOUGH
    assert advice.separates[0] == law(found.chosen[0])
    assert len(set(advice.separates)) == len(advice.separates) > 1
    assert all(name in advice.what for name in advice.separates)


def test_what_wanders_in_time_is_no_rival_of_what_does_not() -> None:
    problem, found, _, _ = found_in("joint_preload")
    first = found.chosen[0]
    wandering = replace(first, form=replace(first.form, name=WANDERING, variable=TIME))
    assert rivals(replace(found, rivals=(first, wandering))) == []
    assert rivals(replace(found, chosen=(wandering,), rivals=(wandering, first))) == [first]
    assert next_for_force(problem, replace(found, rivals=(first,)), LEVELS) is None


def test_what_wandered_in_one_recording_alone_is_not_known_beforehand() -> None:
    problem, found, _, _ = found_in("joint_preload")
    wandering = replace(found.chosen[0], form=replace(found.chosen[0].form, name=WANDERING, across=False))
    assert next_for_force(problem, replace(found, chosen=(wandering,)), LEVELS) is None


@pytest.mark.long
def test_what_wanders_alike_in_every_recording_is_told_from_others() -> None:
    hidden = case(("wandering_moment",), 1.0, 2, runs=3, held_out=0, duration=45.0)
    problem = problem_of(hidden.recordings, parameter_set(AGRIQ, SOIL), 5.0, 2)
    soil = problem.parameters.coordinates([hidden.truth.soil[key] for key in SOIL])
    found = search_forces(problem, soil, windows=150)
    assert found.chosen[0].form.name == WANDERING
    advice = next_for_force(problem, found, LEVELS, library=SHORT)
    assert advice is not None and advice.nats > 5.0
    assert advice.separates[0] == law(found.chosen[0]) and len(advice.separates) > 1


def test_what_is_not_measured_is_not_in_the_recording() -> None:
    found = recording(AGRIQ, BY_NAME["jerks"], (2.0, -1.0), {"position": 0.01})
    assert set(found.channels) == {"motor_torques", "total_station", "motor_command"}
    assert not any(name.endswith("effort") for name in found.channels["motor_torques"].columns)
    station = found.channels["total_station"]
    assert (station["x"][0], station["y"][0]) == pytest.approx((2.0, -1.0), abs=0.05)
