"""Parts of robots of any number of modules by the names that effects have for them."""

from __future__ import annotations

import pytest

from artibot_sim.diagnose.candidates.hypotheses import _names, why_unseen
from artibot_sim.model import MOTORS, WHEELS, load_robot
from artibot_sim.model.effects import EFFECTS, in_pair
from artibot_sim.model.effects.files import effect_of
from artibot_sim.model.effects.force_law import PLACES, VARIABLES, place_words, variable_words
from artibot_sim.model.effects.parts import in_robot, names_of, of_pair
from artibot_sim.model.robot.robot import sides_of, wheels_of


@pytest.mark.parametrize("modules", [2, 3, 12])
def test_names_are_the_robots_own_and_lead_back(modules):
    assert names_of(MOTORS, modules) == sides_of(modules)
    assert names_of(WHEELS, modules) == wheels_of(modules)
    for name in (*names_of(tuple(PLACES), modules), *names_of(tuple(VARIABLES), modules)):
        own, behind = of_pair(name)
        assert own in PLACES or own in VARIABLES
        assert behind < modules and (not behind or in_robot(own, behind) == name)
    words = [place_words(name) for name in names_of(tuple(PLACES), modules)]
    words += [variable_words(name)[0] for name in names_of(tuple(VARIABLES), modules)]
    assert len(set(words)) == len(words)


def test_an_effect_that_names_a_part_acts_in_its_pair_alone():
    effects = {
        "payload": {"mass": 5.0, "module": "module_3"}, "joint_damping": {"coefficient": 30.0},
        "motor_drag": {"torque": 0.0, "motor": "back_left"},
        "residual_force": {"back_turn": 1.0, "module_3_turn": 0.0, "module_4_turn": 2.0, "since": 0.5},
    }  # fmt: skip
    first, second, third = (in_pair(effects, i) for i in (1, 2, 3))
    assert list(first) == ["joint_damping", "residual_force"]
    assert second["payload"][1] == {"mass": 5.0, "module": "back"} and "residual_force" not in second
    assert third["residual_force"][1] == {"back_turn": 2.0, "since": 0.5}


def test_a_law_with_a_name_is_of_robots_that_have_its_part():
    law = {"where": "module_3_yaw", "variable": "speed", "form": "linear"}
    size = {"unit": "N m", "low": -50.0, "high": 50.0, "typical": 5.0}
    document = {"id": "hose", "description": "A hose pulls.", "law": law, "parameters": {"size": size}}
    effect = effect_of(document, "hose.yaml")
    assert not why_unseen(effect, load_robot("train3"), [])
    assert why_unseen(effect, load_robot("agriq"), []) == "the robot has 2 modules"


def test_a_diagnosis_tries_every_module_and_every_motor():
    """A passive module has none, and how its wheels turned is not measured."""
    robot = load_robot("train5")
    assert _names(EFFECTS["payload"], "module", robot) == ["front", "back", "module_3", "module_4", "module_5"]
    assert set(_names(EFFECTS["motor_drag"], "motor", robot)) == set(robot.motors) != set(sides_of(5))
    assert len(_names(EFFECTS["wheel_runout"], "wheel", robot)) == 2 * len(robot.motors)
    assert _names(EFFECTS["payload"], "module", load_robot("husky")) == ["front"]
