"""Effects as coordinates of a fit: neutral at 0, plain at 1, and back again."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.estimation.parameters import Extension, ParameterSet, Prior
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot
from artibot_sim.model.effects import EFFECTS, at_work
from artibot_sim.model.effects.base import Choice, Search

SEARCHED = [name for name, effect in EFFECTS.items() if effect.search is not None]


def extension(name: str) -> Extension:
    """With the last of all choices, and a disc somewhere."""
    effect = EFFECTS[name]
    fixed = {key: p.quantity.names[-1] for key, p in effect.parameters.items() if isinstance(p.quantity, Choice)}
    return Extension(name, fixed | dict(zip(effect.search.disc, (1.0, -2.0, 1.5), strict=False)), 0.4)


@pytest.mark.parametrize("name", SEARCHED)
def test_coordinates_and_values_are_inverse(name: str) -> None:
    e = extension(name)
    rng = np.random.default_rng(3)
    low, high = e.bounds
    for _ in range(5):
        c = np.clip(rng.uniform(-2.0, 2.0, len(e)), np.maximum(low, -2.0), high)
        assert e.coordinates(e.values(c)) == pytest.approx(c, abs=1e-9)
        assert (e.nearest(c) == c).all()


@pytest.mark.parametrize("name", SEARCHED)
def test_an_effect_is_absent_at_0(name: str) -> None:
    e = extension(name)
    if math.isinf(float(e.effect.parameters[next(iter(e.search.sizes))].neutral)):
        pytest.skip("a limit is absent where it is infinite")
    assert not at_work({name: e.values(np.zeros(len(e)))})
    assert at_work({name: e.values(np.ones(len(e)))})


@pytest.mark.parametrize("name", SEARCHED)
def test_every_probe_is_a_robot(name: str) -> None:
    """Probes and the ends of bounds are values that a robot takes."""
    robot, e = load_robot("agriq"), extension(name)
    parameters = ParameterSet(robot, parameter_set(robot).parameters, (e,))
    for own in [*e.search.probes, *e.bounds]:
        c = np.concatenate([np.zeros(len(parameters.parameters)), e.nearest(np.array(own))])
        assert name in parameters.robot_at(c).effects


def test_a_size_with_a_direction_has_no_preferred_one() -> None:
    e = Extension("slope")
    for heading in (-2.5, 0.0, 1.875, 3.0):
        values = e.values(e.coordinates({"grade": 0.05, "heading": heading}))
        assert values["grade"] == pytest.approx(0.05)
        assert values["heading"] == pytest.approx(heading)


@pytest.mark.parametrize("around", [{"scale": 1.1}, {"offset": -0.4}])
@pytest.mark.parametrize("direction", ["", "phase"])
def test_what_says_nothing_of_a_size_is_fitted_around_a_value(around: dict[str, float], direction: str) -> None:
    """A period or a place has no neutral value: a law is absent where its size is 0, and stays within its reach."""
    ((name, middle),) = around.items()
    search = Search({"size": 2.0, name: 0.3}, direction=direction, around=around)
    law = {"where": "front_yaw", "variable": "place", "form": "periodic"}
    neutral = {key: one.neutral for key, one in EFFECTS["force_law"].parameters.items()}
    fixed = {key: value for key, value in (neutral | law).items() if key not in ("size", name, direction)}
    e = Extension("force_law", fixed, own=search)
    assert len(e) == len(e.names) == len(e.bounds[0]) == (3 if direction else 2)
    absent = e.values(np.zeros(len(e)))
    assert (absent["size"], absent[name]) == (0.0, pytest.approx(middle))
    rng = np.random.default_rng(4)
    for _ in range(5):
        c = np.clip(rng.uniform(-2.0, 2.0, len(e)), *e.bounds)
        assert e.coordinates(e.values(c)) == pytest.approx(c, abs=1e-9)
    farthest = [e.values(end)[name] for end in e.bounds]
    expected = middle * np.exp([-0.3, 0.3]) if name == "scale" else [middle - 0.3, middle + 0.3]
    assert farthest == pytest.approx(list(expected))


def test_soil_and_effects_stand_side_by_side() -> None:
    """Effects' coordinates follow the soil's, and what is clipped of one leaves the other as it is."""
    robot = load_robot("agriq")
    soil = parameter_set(robot)
    both = ParameterSet(robot, soil.parameters, (Extension("joint_friction"), Extension("slope")))
    assert len(both) == len(soil) + 3
    c = np.concatenate([0.1 * np.ones(len(soil)), [-0.5, 0.3, 0.4]])
    inside = both.inside(c)
    assert inside[:5] == pytest.approx(c[:5])
    assert inside[5:] == pytest.approx([0.0, 0.3, 0.4])
    at = both.robot_at(inside)
    assert at.contact == soil.robot_at(c[:5]).contact
    assert at.effects["slope"]["grade"] == pytest.approx(0.025)
    assert not both.uniform
    assert soil.uniform


def test_differences_stay_within_bounds() -> None:
    """A parameter at its upper bound, which no robot may exceed, is moved back from it."""
    robot = load_robot("husky_driven")
    name = "effects.stribeck.early"
    robot = replace(robot, effects={"stribeck": {"velocity": 0.1, "early": 0.5}})
    parameters = parameter_set(robot, ("k_l", name), {name: Prior(0.5, 0.5)})
    at_bound = parameters.inside(parameters.coordinates([robot.contact.k_l, 5.0]))
    steps = parameters.steps(at_bound)
    assert parameters.values(at_bound)[1] == pytest.approx(1.0)
    assert steps[0] > 0.0 > steps[1]
    for step in np.diag(steps):
        assert 0.0 <= parameters.candidate(at_bound + step).effects["stribeck"]["early"] <= 1.0
