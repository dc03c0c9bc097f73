"""What is on no list is found in recordings of a rover that is not the model, and nothing where nothing is hidden."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnose.hidden import UNLISTED, Case, case
from diagnose.hidden.score import has_words
from diagnose.hidden.unlisted import ACTS_ON

from artibot_sim.diagnose.candidates.hypotheses import with_effect
from artibot_sim.diagnose.policy import FORCE_NATS
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.unlisted.along_law import residual_forces
from artibot_sim.diagnose.unlisted.finding import ForceFinding, search_forces, unexplained_of
from artibot_sim.diagnose.unlisted.fitting import as_found, extension_of, fitted_laws, law_of
from artibot_sim.diagnose.unlisted.variables import through_gear
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import converge
from artibot_sim.estimation.solver import Point, evaluate, step
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import MOTORS, load_robot

SEED = 2
SLOW = ("wandering_moment",)
"""Half a minute does not show these."""
SHORT = ("ridges",)
"""What `make test` has time for."""
WORDS = ACTS_ON | {"wheel_out_of_round": {"variable": "wheel angle", "form": "periodic, once a turn"}}
"""What an answer must say. A wheel's longitudinal force is nearly all torque to the sensors, and may be called that."""


@cache
def hidden(*effects: str) -> tuple[Case, Problem, np.ndarray]:
    """A case, its recordings as a problem, and the coordinates of its soil."""
    duration = 45.0 if effects == SLOW else 30.0
    found = case(effects, 1.0, SEED, runs=3, held_out=0, duration=duration)
    problem = problem_of(found.recordings, parameter_set(load_robot("agriq"), SOIL), 5.0, 2)
    return found, problem, problem.parameters.coordinates([found.truth.soil[name] for name in SOIL])


@cache
def seen(*effects: str) -> tuple[Case, ForceFinding]:
    found, problem, soil = hidden(*effects)
    return found, search_forces(problem, soil, windows=150)


def settled(problem: Problem, coordinates: np.ndarray) -> Point:
    """The best starts of all windows on a soil."""
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(problem, loss, [coordinates], problem.starts)[0]
    for _ in range(3):
        point, _, _ = step(problem, loss, point, ())
    return point


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=() if one in SHORT else pytest.mark.long) for one in sorted(UNLISTED)]
)
def test_force_and_variable_are_named(name):
    _, found = seen(name)
    assert found.chosen
    answer = unexplained_of(found)
    said = f"{answer.force} {answer.variable} {answer.form}"
    assert has_words(said, WORDS[name].values()), said
    assert answer.size != 0 and answer.where


def test_nothing_is_found_where_nothing_is_hidden():
    _, found = seen()
    assert not found.chosen
    assert max(rival.worth for rival in found.rivals) < FORCE_NATS


def test_the_period_of_ridges_is_found():
    truth, found = seen("ridges")
    wave = np.array(found.chosen[0].form.wave)
    period = truth.truth.unlisted["ridges"]["period"]
    assert 2 * np.pi / np.hypot(*wave) == pytest.approx(period, rel=0.02)


@pytest.mark.long
def test_what_a_law_lacks_stands_beside_it():
    """Residual forces along the law's variable: what is missing of a law that is half as large, little of the whole."""
    _, found = seen("ridges")
    _, problem, soil = hidden("ridges")
    first = found.chosen[0]
    law, size = law_of(first)
    extension = extension_of("force_law", law, size)
    larger = with_effect(problem, extension)
    left = {}
    for share in (0.5, 1.0):
        point = np.concatenate([soil, extension.coordinates(law | as_found(share * size))])
        rows = residual_forces(larger, point, "force_law", first)
        values = larger.parameters.robot_at(point).effects["force_law"]
        force = values["size"] * np.cos(2.0 * np.pi * rows[:, 0] / values["scale"] + values["phase"])
        assert (np.diff(rows[:, 0]) > 0.0).all() and 0.0 <= rows[0, 0] < rows[-1, 0] <= values["scale"]
        left[share] = float(rows[:, 1] @ force / (force @ force))
        assert np.median(rows[:, 2]) < 0.3 * abs(values["size"])
    assert left[0.5] == pytest.approx(1.0, abs=0.3) and abs(left[1.0]) < 0.2


@pytest.mark.long
def test_ridges_that_were_found_are_a_law_that_takes_most_away():
    """Fitted to every third window beside soil and starts; their height is that of the rover that is not the model."""
    truth, found = seen("ridges")
    _, problem, soil = hidden("ridges")
    problem = replace(problem, windows=problem.windows[::3])
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    fit = converge(problem, settled(problem, soil), loss, 1)
    laws = fitted_laws(problem, fit, found)
    assert laws is not None
    assert laws.fit.point.cost < 0.4 * fit.point.cost
    assert laws.nats == pytest.approx(0.5 * (fit.point.cost - laws.fit.point.cost))
    (law,), (part,) = laws.problem.parameters.extensions, laws.problem.parameters.places
    values = law.values(laws.fit.point.coordinates[part])
    assert values["size"] == pytest.approx(truth.truth.unlisted["ridges"]["ridge"], rel=0.1)
    assert (values["where"], values["variable"], values["form"]) == ("wheels_lateral", "place", "periodic")
    span = pytest.approx(2.0 * values["scale"], rel=0.01)  # two periods, as the regression has them
    assert laws.spans == {"force_law": (0.0, span)}


@pytest.mark.long
def test_a_coefficient_is_about_right():
    truth, found = seen("air_drag")
    best = next(c for c in found.rivals if c.force == "front surge force" and c.form.name == "quadratic")
    assert -best.coefficients[0] == pytest.approx(truth.truth.unlisted["air_drag"]["air"], rel=0.25)


@pytest.mark.long
def test_something_remains_only_where_something_is_hidden():
    _, problem, soil = hidden()
    clean = remains(problem, settled(problem, soil))
    assert not leaves_more_than_noise(clean)
    _, problem, soil = hidden("yaw_drag")
    left = remains(problem, settled(problem, soil))
    assert leaves_more_than_noise({"yaw_rate": left["yaw_rate"]})


def test_eq_23_goes_by_what_reaches_the_gear():
    """A motor that pushes less than drags at it is driven by its wheels."""
    dragged = replace(load_robot("agriq"), effects={"motor_drag": {"torque": 0.25, "motor": "back_left"}})
    motion = {f"torque_{motor}": np.full(3, 0.1) for motor in MOTORS} | {
        f"rate_{motor}": np.array([40.0, -40.0, 0.0]) for motor in MOTORS
    }
    at = MOTORS.index("back_left")
    assert through_gear(dragged, at, motion) == pytest.approx([-0.15, 0.35, 0.1])
    assert through_gear(dragged, at - 1, motion) == pytest.approx([0.1, 0.1, 0.1])
