"""Motors of a robot file: a line, a supply, gears and encoders are the effects of the same numbers, which stand."""

from __future__ import annotations

import numpy as np
import pytest
from model.effects import with_effects
from model.helpers import front_commands, ramp

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Mode, load_robot, rollout, save_robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.robot.file import robot_from_dict, robot_to_dict
from artibot_sim.model.robot.robot import MOTOR_EFFECTS, Motor
from artibot_sim.model.simulate.sensors import sensor_errors

OWN = {
    "motor.stall_torque": 0.9, "motor.no_load_speed": 320.0, "motor.supply": 0.9, "motor.no_load_torque": 0.05,
    "motor.velocity_filter": 0.03,
}  # fmt: skip
SAME = {
    "battery_sag": {"stall": 0.9, "no_load_speed": 320.0, "supply": 0.9}, "gear_no_load": {"torque": 0.05},
    "velocity_filter": {"time_constant": 0.03},
}  # fmt: skip


def turn(robot, speed=0.6, yaw_rate=0.3, duration=4.0, **options):
    commands = front_commands(robot, lambda t: speed * ramp(t), lambda t: yaw_rate * ramp(t - 1.5), duration)
    return rollout(robot, commands, **options)


def test_a_robot_that_says_nothing_of_its_motors_has_no_effect_of_theirs(agriq):
    assert agriq.motor == Motor() and not agriq.effects and "motor" not in robot_to_dict(agriq)


@pytest.mark.parametrize("name", ["agriq", "husky", "train3"])
def test_a_robots_own_motors_are_the_effects_of_the_same_numbers_to_the_bit(name):
    robot = load_robot(name)
    own, same = robot.replace(OWN), with_effects(robot, **SAME)
    assert own.effects == same.effects and own != same
    driven = turn(own)
    assert driven.modes[0] is Mode.DRIVEN
    np.testing.assert_array_equal(driven.row, turn(same).row)
    assert sensor_errors(own) == sensor_errors(same)


def test_an_effect_by_name_goes_before_the_robots_own_number_and_leaves_the_others(agriq):
    low = with_effects(agriq.replace(OWN), battery_sag={"supply": 0.6})
    assert low.effects["battery_sag"] == SAME["battery_sag"] | {"supply": 0.6}
    assert low.effects["gear_no_load"] == SAME["gear_no_load"] and set(low.effects_beside) == {"battery_sag"}
    assert not with_effects(agriq.replace(OWN), gear_no_load={"torque": 0.0}).effects["gear_no_load"]["torque"]
    stronger = low.replace({"motor.stall_torque": 1.2})  # what stands follows, what was said stays
    assert stronger.effects["battery_sag"] == {"stall": 1.2, "no_load_speed": 320.0, "supply": 0.6}


def test_motors_and_what_effects_change_of_them_survive_a_round_trip(agriq, tmp_path):
    robot = agriq.replace(OWN, source="datasheet: a motor").replace({"effects.battery_sag.supply": 0.7})
    save_robot(robot, tmp_path / "copy.yaml")
    document = robot_to_dict(robot)
    assert set(document["effects"]) == {"battery_sag"} and set(document["effects"]["battery_sag"]) == {"supply"}
    assert load_robot(tmp_path / "copy.yaml") == robot == robot_from_dict(document)
    assert robot.sources["motor.no_load_speed"] == "datasheet: a motor"


def test_every_number_of_a_motor_is_one_of_an_effect_and_neutral_with_it():
    for key, (effect, parameter) in MOTOR_EFFECTS.items():
        assert getattr(Motor(), key.removeprefix("motor.")) == EFFECTS[effect].parameters[parameter].neutral


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"no_load_speed": {"value": 300.0, "unit": "rad/s", "source": "stated"}}, "motor.stall_torque"),
        ({"stall_torque": {"value": 0.0, "unit": "N m", "source": "stated"}}, "motor.stall_torque"),
        ({"stall_torque": {"value": 1.0, "unit": "N", "source": "stated"}}, "motor.stall_torque.unit"),
        ({"no_load_torque": 0.1}, "motor.no_load_torque"),
        ({"stal_torque": {"value": 1.0, "unit": "N m", "source": "stated"}}, "did you mean 'stall_torque'"),
    ],
)
def test_what_cannot_be_a_motor_is_refused_with_the_keys_path(agriq, entries, says):
    with pytest.raises(ArtibotError, match=says):
        robot_from_dict(robot_to_dict(agriq) | {"motor": entries})


def test_a_line_too_steep_for_the_step_names_the_motor(agriq):
    steep = agriq.replace({"motor.stall_torque": 5.0, "motor.no_load_speed": 5.0})
    with pytest.raises(ArtibotError, match=r"torque-speed line.*with (half of motor.stall|twice motor.no_load)"):
        turn(steep, integrator="rk4", dt=1e-3)
