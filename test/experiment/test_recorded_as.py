"""Simulations as their robots' sensors record them, and recordings simulated again by such a robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from model.effects import SENSORS_1

from artibot_sim.experiment import Experiment, read_bag, write_experiment
from artibot_sim.experiment.resimulate import resimulate
from artibot_sim.model import Commands, Robot, initial_state, load_robot, rollout
from artibot_sim.model.simulate.commands import as_executed
from artibot_sim.model.simulate.sensors import low_passed

SHOWN = sorted({*SENSORS_1} - {"pose_heading_offset"})
"""What a bag of a simulation shows: a total station sees no heading, and a ground truth is true."""
ON_THE_WAY = {
    "command_delay": {"delay": 0.15},
    "speed_loop_lag": {"time_constant": 0.25},
    "deadband": {"threshold": 30.0},
}


def turn(duration: float = 5.0) -> Commands:
    """From rest into a left turn, and not quite to rest again."""
    t = np.arange(0.0, duration + 5e-3, 0.01)
    shape = 100.0 * np.sin(np.pi * np.maximum(t - 0.5, 0.0) / duration) ** 2
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, 0], velocity[:, 1] = shape, 0.6 * shape
    return Commands(0.01, velocity)


def robot_with(effects: dict) -> Robot:
    return replace(load_robot("agriq"), effects=effects)


def written(folder: Path, robot: Robot):
    result = rollout(robot, as_executed(robot, turn()), state=initial_state(robot, 3.0, -1.0, 2.0))
    return read_bag(write_experiment(folder, result, None, robot, commands=turn()))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory):
    return written(tmp_path_factory.mktemp("plain") / "run", load_robot("agriq"))


@pytest.mark.parametrize("name", sorted(SENSORS_1))
def test_a_bag_says_what_the_sensors_say(tmp_path: Path, plain, name: str) -> None:
    bag, values = written(tmp_path / "run", robot_with({name: SENSORS_1[name]})), SENSORS_1[name]
    truth, motors = bag.channels["ground_truth_odom"], bag.channels["motor_torques"]
    for axis in ("x", "y", "yaw", "yaw_rate"):
        np.testing.assert_array_equal(truth[axis], plain.channels["ground_truth_odom"][axis])
    scale = values["scale"] if name == "encoder_scale" else 1.0
    pull = values["scale"] if name == "torque_scale" else 1.0
    for quantity, factor in (("position", scale), ("velocity", scale), ("effort", pull)):
        was = plain.channels["motor_torques"][f"back_left.{quantity}"]
        if (name, quantity) == ("velocity_filter", "velocity"):
            was = low_passed(motors.t, was[:, None], values["time_constant"])[:, 0]
        np.testing.assert_allclose(motors[f"back_left.{quantity}"], factor * was, rtol=1e-12, atol=1e-9)
    wheel = "front_right_front_wheel.position"
    was = plain.channels["joint_states"][wheel]
    np.testing.assert_allclose(bag.channels["joint_states"][wheel], scale * was, rtol=1e-12)
    np.testing.assert_array_equal(
        bag.channels["motor_command"]["front_right.velocity"], plain.channels["motor_command"]["front_right.velocity"]
    )
    if name == "gyro_bias":
        np.testing.assert_allclose(bag.channels["imu"]["yaw_rate"] - truth["yaw_rate"], values["bias"], atol=1e-12)
    if name == "pose_lever_arm":
        station, c, s = bag.channels["total_station"], np.cos(truth["yaw"]), np.sin(truth["yaw"])
        np.testing.assert_allclose(station["x"] - truth["x"], c * values["x"] - s * values["y"], atol=1e-9)
        np.testing.assert_allclose(station["y"] - truth["y"], s * values["x"] + c * values["y"], atol=1e-9)
    if name == "pose_delay":
        station = bag.channels["total_station"]
        np.testing.assert_allclose(station["x"][12:], truth["x"][:-12], atol=1e-9)
        assert np.ptp(station["x"][:13]) < 1e-9


def with_speeds_alone(bag: Experiment) -> Experiment:
    """A recording whose motors' angles were not recorded."""
    motors = bag.channels["motor_torques"]
    columns = {key: value for key, value in motors.columns.items() if not key.endswith(".position")}
    return replace(bag, channels={**bag.channels, "motor_torques": replace(motors, columns=columns)})


@pytest.mark.parametrize("drive", ["rotations", "commands"])
@pytest.mark.parametrize("name", sorted(SHOWN))
def test_a_robot_with_such_sensors_gives_its_recording_back(tmp_path: Path, name: str, drive: str) -> None:
    robot = robot_with({name: SENSORS_1[name]})
    bag = written(tmp_path / "run", robot)
    if name == "velocity_filter" and drive == "rotations":
        bag = with_speeds_alone(bag)
    own = resimulate(bag, robot, drive).metrics
    other = resimulate(bag, load_robot("agriq"), drive).metrics
    rotation = "front_velocity" if drive == "commands" else "position"
    channel = {
        "encoder_scale": rotation, "velocity_filter": rotation, "torque_scale": "torque_back", "gyro_bias": "yaw_rate",
    }.get(name, "position")  # fmt: skip
    assert own[channel].median < 0.1 * other[channel].median
    assert own["position"].rmse < 2e-3


def test_headings_at_an_angle_are_given_back_at_that_angle(plain) -> None:
    truth, angle = plain.channels["ground_truth_odom"], 0.05
    turned = replace(truth, columns={**truth.columns, "yaw": truth["yaw"] + angle})
    recording = replace(plain, channels={**plain.channels, "ground_truth_odom": turned})
    robot = robot_with({"pose_heading_offset": {"angle": angle}})
    own, other = (resimulate(recording, one, "rotations").metrics for one in (robot, load_robot("agriq")))
    assert own["position"].median < 0.1 * other["position"].median
    assert own["yaw"].median < 1e-3  # of either, for a simulation starts at the measured heading


def test_the_bag_of_a_resimulation_is_of_what_was_recorded(tmp_path: Path) -> None:
    robot = robot_with({name: SENSORS_1[name] for name in SENSORS_1})
    bag = written(tmp_path / "run", robot)
    resimulate(bag, robot, "commands").write(tmp_path / "out")
    again = read_bag(tmp_path / "out" / "simulated")
    rows = np.isin(bag.channels["total_station"].t_ns, again.channels["total_station"].t_ns)
    assert rows.mean() > 0.9
    for axis in ("x", "y"):
        seen = bag.channels["total_station"][axis][rows]
        np.testing.assert_allclose(again.channels["total_station"][axis], seen, atol=5e-3)
    rows = np.isin(bag.channels["ground_truth_odom"].t_ns, again.channels["ground_truth_odom"].t_ns)
    np.testing.assert_allclose(
        again.channels["ground_truth_odom"]["x"], bag.channels["ground_truth_odom"]["x"][rows], atol=5e-3
    )


@pytest.mark.parametrize("names", [("command_delay",), ("speed_loop_lag",), ("deadband",), tuple(ON_THE_WAY)])
def test_commands_go_their_way_when_they_are_simulated_again(tmp_path: Path, names: tuple[str, ...]) -> None:
    robot = robot_with({name: ON_THE_WAY[name] for name in names})
    bag = written(tmp_path / "run", robot)
    own = resimulate(bag, robot, "commands").metrics
    other = resimulate(bag, load_robot("agriq"), "commands").metrics
    assert other["front_velocity"].rmse > 3.0
    assert own["front_velocity"].rmse < 0.05 * other["front_velocity"].rmse
    assert own["position"].rmse < 5e-3


def test_a_torque_limit_acts_on_commands(tmp_path: Path) -> None:
    robot = robot_with({"torque_limit": {"front_max": 0.2}})
    bag = written(tmp_path / "run", robot)
    assert np.abs(bag.channels["motor_torques"]["front_right.effort"]).max() <= 0.2 * (1 + 1e-9)
    again = resimulate(bag, robot, "commands")
    assert np.abs(again.tables["motor_torques"][1]["front_right.effort"]).max() <= 0.2 * (1 + 1e-9)
    assert again.metrics["front_velocity"].rmse < 0.1
