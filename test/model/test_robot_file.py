"""Robot files: what is shipped, what comes back, and what is refused with the key's path."""

from __future__ import annotations

import copy
import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from model.helpers import front_commands, ramp

from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot, rollout, save_robot
from artibot_sim.model.robot.derived import starred
from artibot_sim.model.robot.file import robot_from_dict, robot_to_dict
from artibot_sim.resources import config_names, config_path

ROBOTS = ("agriq", "epiq", "husky", "train3", "train5")


def document(name: str = "agriq") -> dict:
    return copy.deepcopy(yaml.safe_load(config_path("robots", name).read_text()))


def put(tree: dict, key: str, value: object) -> dict:
    *path, last = key.split(".")
    node = tree
    for part in path:
        node = node[part]
    node[last] = value
    return tree


def test_the_contracts_robots_are_shipped() -> None:
    assert set(ROBOTS) <= set(config_names("robots"))


@pytest.mark.parametrize("name", ROBOTS)
def test_every_number_has_a_source_and_survives_a_round_trip(name: str, tmp_path) -> None:
    robot = load_robot(name)
    save_robot(robot, tmp_path / "copy.yaml")
    again = load_robot(tmp_path / "copy.yaml")
    assert again == robot
    stated = set(robot.sources)
    defaults = {key for key, _, value in robot.quantities() if key not in stated}
    assert all(key.split(".")[-1] in {"O_z", "c_n", "torque_max", "rated_torque", "torque_constant", "A_joint"}
               or "polarity" in key or key.startswith("motor.") for key in defaults)  # fmt: skip


@pytest.mark.parametrize(
    ("module", "mass", "J_z"), [("front", 59.0, 10.508), ("back", 28.0, 5.508)]
)  # Table 2, and eq. 9 as read in the docs
def test_agriq_has_the_papers_starred_inertias(module: str, mass: float, J_z: float) -> None:
    robot = load_robot("agriq")
    m, _, _, J = starred(robot, getattr(robot, module))
    assert m == pytest.approx(mass, abs=1e-9)
    assert pytest.approx(J_z, abs=1e-3) == J


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("front.m.value", -1.0, "front.m"),
        ("front.m.value", math.nan, "front.m"),
        ("front.m.unit", "g", "front.m.unit"),
        ("front.m", 55.0, "front.m"),
        ("front.m", {"value": 55.0, "source": "stated"}, "front.m.unit"),
        ("front.m", {"value": 55.0, "unit": "kg"}, "front.m.source"),
        ("front.m.source", "hearsay", "front.m.source"),
        ("front.m.value", "heavy", "front.m.value"),
        ("front.i_x.value", -0.45, "front.i_x"),
        ("back.l.value", -0.95, "back.l"),
        ("front.colour", {"value": 1, "unit": "-", "source": "stated"}, "front.colour"),
        ("weather", {}, "weather"),
        ("contact.mu_d.value", 0.9, "contact.mu_d"),
        ("drive.front.eta_d.value", 1.2, "drive.front.eta_d"),
        ("drive.front.polarity.left.value", 0.5, "drive.front.polarity.left"),
        ("front.J_z.value", 50.0, "front.J_x, J_y, J_z"),
        ("control.kappa.value", 0.0, "control.kappa"),
        ("wheel.wheels_per_motor.value", 3, "wheel.wheels_per_motor"),
        ("readings", {"literal_eq22": "yes"}, "readings.literal_eq22"),
        ("effects", {"ghost": {}}, "effects.ghost"),
        ("effects", {"slope": {"grade": {"value": 3, "unit": "deg"}}}, "effects.slope.grade.unit"),
        ("effects", {"slope": {"angle": 0.1}}, "effects.slope.angle"),
        ("front.m.ci95", [1.0], "front.m.ci95"),
    ],
)
def test_a_bad_value_is_refused_with_its_key(key: str, value: object, says: str) -> None:
    with pytest.raises(ArtibotError) as caught:
        robot_from_dict(put(document(), key, value))
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "key", ["front", "wheel", "contact", "drive", "control", "front.m", "contact.k_t", "drive.back"]
)
def test_a_missing_key_is_named(key: str) -> None:
    tree = document()
    *path, last = key.split(".")
    node = tree
    for part in path:
        node = node[part]
    del node[last]
    with pytest.raises(ArtibotError, match=rf"^{re.escape(key)}"):
        robot_from_dict(tree)


@pytest.mark.parametrize("text", ["", "[1, 2]", "front: {m: [", "\x00\x01"])
def test_a_file_that_is_no_robot_names_itself(text: str, tmp_path) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text(text)
    with pytest.raises(ArtibotError, match=r"broken[.]yaml"):
        load_robot(path)


@pytest.mark.parametrize("name", ["agriqq", "nowhere/agriq.yaml"])
def test_an_unknown_robot_lists_those_there_are(name: str) -> None:
    with pytest.raises(ArtibotError, match="agriq, epiq, husky"):
        load_robot(name)


@given(st.lists(st.floats(0.5, 2.0), min_size=5, max_size=5))
def test_vectors_go_in_and_come_back(factors: list[float]) -> None:
    robot = load_robot("agriq")
    keys = ["contact.k_l", "contact.k_t", "contact.mu_s", "contact.mu_d", "front.m"]
    values = robot.as_vector(keys) * np.array(factors)
    values[2], values[3] = max(values[2:4]), min(values[2:4])
    changed = robot.with_vector(keys, values)
    np.testing.assert_array_equal(changed.as_vector(keys), values)
    others = [key for key, _, _ in robot.quantities() if key not in keys]
    np.testing.assert_array_equal(changed.as_vector(others), robot.as_vector(others))


def test_an_effect_at_its_neutral_value_is_bit_identical() -> None:
    robot = load_robot("agriq")
    tree = robot_to_dict(robot) | {"effects": {"slope": {"grade": 0.0, "heading": 1.0}}}
    plain, neutral = (
        rollout(r, front_commands(r, lambda t: 0.5 * ramp(t), lambda t: 0.2 * ramp(t), 3.0))
        for r in (robot, robot_from_dict(tree))
    )
    np.testing.assert_array_equal(plain.q, neutral.q)


@pytest.mark.parametrize(("name", "expected"), [("agriq", "rocker"), ("husky", "rigid"), ("train3", "rocker")])
def test_a_robots_suspension_is_in_its_file_or_follows_from_its_modules(name, expected, tmp_path) -> None:
    robot = load_robot(name)
    assert robot.suspended == expected
    save_robot(dataclasses.replace(robot, suspension="rigid"), tmp_path / "rigid.yaml")
    assert load_robot(tmp_path / "rigid.yaml").suspended == "rigid"


def test_an_unknown_suspension_is_refused() -> None:
    with pytest.raises(ArtibotError, match="suspension: found 'springs', expected one of rocker, rigid"):
        robot_from_dict(document("husky") | {"suspension": "springs"})


def test_parameters_cannot_be_changed_in_place() -> None:
    robot = load_robot("agriq")
    with pytest.raises(AttributeError):
        robot.contact.k_l = 1.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        robot.effects["slope"] = {}  # type: ignore[index]


@pytest.mark.parametrize(
    ("effects", "says"),
    [
        ({"slop": {"grade": 0.05}}, "effects.slop: unknown effect"),
        ({"slope": {"grad": 0.05}}, "effects.slope.grad: unknown key"),
        ({"slope": {"grade": 2.0}}, "effects.slope.grade: 2 rad is out of bounds"),
    ],
)
def test_effects_given_in_python_are_checked_as_those_of_a_file(effects: dict, says: str) -> None:
    with pytest.raises(ArtibotError, match=f"^{re.escape(says)}"):
        dataclasses.replace(load_robot("agriq"), effects=effects)
    assert dataclasses.replace(load_robot("agriq"), effects={"slope": {}}).effects["slope"]["grade"] == 0.0


def test_effects_are_saved_with_unit_source_and_interval(tmp_path: Path) -> None:
    robot = dataclasses.replace(
        load_robot("agriq"),
        effects={"payload": {"mass": 15.0, "module": "back"}, "slope": {"grade": 0.05, "heading": 1.0}},
        sources={"effects.slope.grade": "diagnosed: from run0"},
        intervals={"effects.slope.grade": (0.04, 0.06)},
    )
    save_robot(robot, tmp_path / "extended.yaml")
    tree = yaml.safe_load((tmp_path / "extended.yaml").read_text())["effects"]
    assert tree["slope"]["grade"] == {
        "value": 0.05, "unit": "rad", "source": "diagnosed: from run0", "ci95": [0.04, 0.06],
    }  # fmt: skip
    assert tree["payload"]["module"]["value"] == "back"
    again = load_robot(tmp_path / "extended.yaml")
    assert again == robot
    assert again.sources["effects.slope.grade"] == "diagnosed: from run0"
    assert again.intervals["effects.slope.grade"] == (0.04, 0.06)


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ({"value": 0.05, "unit": "deg"}, "effects.slope.grade.unit: found 'deg', expected 'rad'"),
        ({"value": 0.05, "source": "guess"}, "effects.slope.grade.source: found 'guess'"),
        ({"value": 0.05, "sourc": "stated"}, "effects.slope.grade.sourc: unknown key"),
        ({"value": 0.05, "ci95": [1]}, "effects.slope.grade.ci95: found"),
    ],
)
def test_a_bad_entry_of_an_effect_is_refused(entry: dict, says: str) -> None:
    tree = robot_to_dict(load_robot("agriq")) | {"effects": {"slope": {"grade": entry}}}
    with pytest.raises(ArtibotError, match=f"^{re.escape(says)}"):
        robot_from_dict(tree)


def train_without(key: str) -> dict:
    tree = document("train3")
    *path, last = key.split(".")
    node = tree
    for part in path:
        node = node[part]
    del node[last]
    return tree


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        (
            document("train3") | {"module_5": document("train3")["module_3"]},
            "module_4: missing beside module_3, module_5",
        ),
        (train_without("module_3.hitch"), "module_3.hitch: missing; add {l: {value: …, unit: m, source: …}}"),
        (train_without("module_3.hitch.l"), "module_3.hitch.l: missing"),
        (put(document("train3"), "module_3.hitch.l.unit", "mm"), "module_3.hitch.l.unit: found 'mm', expected 'm'"),
        (put(document("train3"), "module_3.m.value", -1.0), "module_3.m: -1 kg is out of bounds"),
        (put(document("train3"), "module_3.J_z.value", 99.0), "module_3.J_x, J_y, J_z: .* break the triangle"),
        (put(document("train3"), "drive.module_4", {}), "drive.module_4: unknown key"),
    ],
)
def test_a_module_behind_is_refused_with_its_key(tree: dict, said: str) -> None:
    with pytest.raises(ArtibotError, match=said.replace("{", r"\{")):
        robot_from_dict(tree)


def test_numbers_of_a_module_behind_can_be_replaced_and_fitted() -> None:
    robot = load_robot("train5")
    keys = ["module_4.m", "module_4.hitch.l", "drive.module_5.tau"]
    changed = robot.with_vector(keys, [31.0, 0.5, 0.03])
    assert changed.trailing[1].m == 31.0
    assert changed.trailing[1].hitch.l == 0.5
    assert changed.drive.trailing[2].tau == 0.03  # type: ignore[union-attr]  # module_5 is driven
    np.testing.assert_array_equal(changed.as_vector(keys), [31.0, 0.5, 0.03])
    assert changed.trailing[0] == robot.trailing[0]
