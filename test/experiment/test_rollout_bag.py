"""A rollout written as a bag is the rollout, and the same every time."""

from __future__ import annotations

import filecmp
from pathlib import Path

import numpy as np
import pytest
from bag_helpers import mcap_file
from hypothesis import given, settings
from hypothesis import strategies as st

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import metrics, read_bag, write_channels, write_experiment
from artibot_sim.experiment.topics import BY_KEY
from artibot_sim.model import MOTORS, WHEEL_JOINTS, Commands, load_robot, rollout
from artibot_sim.planning import load_manoeuvre, plan


@pytest.fixture(scope="module")
def driven() -> tuple:
    robot = load_robot("agriq")
    planned = plan(load_manoeuvre("table6_agriq"), robot, dt=0.01)
    return robot, planned, rollout(robot, planned.commands(), duration=12.0)


def test_every_quantity_comes_back(tmp_path: Path, driven: tuple) -> None:
    robot, planned, result = driven
    experiment = read_bag(write_experiment(tmp_path / "run", result, planned, robot, metadata={"surface": "grass"}))
    assert not experiment.remarks
    assert experiment.metadata["robot"] == "agriq"
    assert float(experiment.metadata["kappa"]) == robot.control.kappa
    assert experiment.metadata["surface"] == "grass"
    truth, motors, joints = (experiment.channels[k] for k in ("ground_truth_odom", "motor_torques", "joint_states"))
    assert np.allclose(truth.t, result.t, atol=1e-9)
    for i, name in enumerate(("x", "y", "yaw")):
        assert np.allclose(truth[name], result.pose[:, i], atol=1e-12)
    for i, name in enumerate(("vx", "vy", "yaw_rate")):
        assert np.array_equal(truth[name], result.twist[:, i])
    for i, motor in enumerate(MOTORS):
        assert np.array_equal(motors[f"{motor}.position"], result.motor_position[:, i])
        assert np.array_equal(motors[f"{motor}.velocity"], result.motor_velocity[:, i])
        assert np.array_equal(motors[f"{motor}.effort"], result.motor_torque[:, i])
    for i, wheel in enumerate(WHEEL_JOINTS):
        assert np.array_equal(joints[f"{wheel}.position"], result.wheel_position[:, i])
    assert np.array_equal(joints["articulation_yaw.position"], result.articulation_yaw)
    assert {name.partition(".")[0] for name in joints.columns} == {
        *WHEEL_JOINTS,
        "articulation_yaw",
        "articulation_roll",
    }


def test_rates_and_plans_are_the_contracts(tmp_path: Path, driven: tuple) -> None:
    robot, planned, result = driven
    experiment = read_bag(write_experiment(tmp_path / "run", result, planned, robot))
    for key in ("odom", "ground_truth_odom", "joint_states", "motor_torques", "motor_command"):
        assert np.allclose(np.diff(experiment.channels[key].t), 0.01)
    assert np.diff(experiment.channels["planned_odom"].t).max() <= 0.05
    profile = experiment.channels["planned_front_velocity"]
    assert profile.t[0] == 0.0
    assert np.array_equal(profile["front_right.velocity"], planned.velocity[:, 0])
    command = experiment.channels["motor_command"]
    assert "front_right.effort" not in command
    assert "back_right.velocity" not in command
    assert np.allclose(command["front_left.velocity"], np.interp(result.t, planned.t, planned.velocity[:, 1]))
    assert np.array_equal(command["back_left.effort"], result.motor_torque[:, 3])


def test_prescribed_wheels_believe_they_follow_the_plan(tmp_path: Path, driven: tuple) -> None:
    robot, planned, result = driven
    experiment = read_bag(write_experiment(tmp_path / "run", result, planned, robot))
    odom = experiment.channels["odom"]
    believed = planned.at(odom.t)
    assert np.hypot(odom["x"] - believed.pose[:, 0], odom["y"] - believed.pose[:, 1]).max() < 2e-3
    final = np.array([np.interp(odom.t[-1], planned.t, planned.pose[:, i]) for i in range(3)])
    assert metrics.position_error((odom["x"][-1], odom["y"][-1]), final[:2], planned.path_length) < 1e-3
    assert odom["yaw"][-1] == pytest.approx(final[2], abs=1e-3)
    truth = experiment.channels["ground_truth_odom"]
    assert np.hypot(truth["x"][-1] - odom["x"][-1], truth["y"][-1] - odom["y"][-1]) > 0.05  # the real one slips


def test_equal_rollouts_give_equal_bytes(tmp_path: Path, driven: tuple) -> None:
    robot, planned, result = driven
    folders = [write_experiment(tmp_path / place / "run", result, planned, robot) for place in "ab"]
    assert filecmp.cmp(*map(mcap_file, folders), shallow=False)
    assert filecmp.cmp(*(folder / "metadata.yaml" for folder in folders), shallow=False)


def test_a_robot_without_a_back_module_has_two_motors(tmp_path: Path) -> None:
    robot = load_robot("husky")
    speed = np.column_stack([np.full(101, 2.0), np.full(101, 2.5), *[np.full(101, np.nan)] * 2])
    commands = Commands(0.01, speed)
    folder = write_experiment(tmp_path / "run", rollout(robot, commands), None, robot, commands=commands)
    experiment = read_bag(folder)
    assert {name.partition(".")[0] for name in experiment.channels["motor_torques"].columns} == set(MOTORS[:2])
    assert {name.partition(".")[0] for name in experiment.channels["joint_states"].columns} == set(WHEEL_JOINTS[:4])
    assert "planned_odom" not in experiment.channels
    assert (experiment.channels["motor_command"]["front_left.velocity"] == 2.5).all()


def test_only_the_channels_asked_for(tmp_path: Path, driven: tuple) -> None:
    robot, planned, result = driven
    folder = write_experiment(tmp_path / "run", result, planned, robot, keys=("ground_truth_odom", "planned_path"))
    assert set(read_bag(folder).channels) == {"ground_truth_odom", "planned_path"}
    with pytest.raises(ArtibotError, match="no channel lidar"):
        write_experiment(tmp_path / "other", result, planned, robot, keys=("lidar",))


finite = st.floats(-1e6, 1e6)
COLUMNS = {
    "ground_truth_odom": ["x", "y", "z", "vx", "vy", "yaw_rate"],
    "motor_torques": ["front_right.position", "front_right.velocity", "back_left.effort"],
    "imu": ["ax", "ay", "az", "roll_rate", "pitch_rate", "yaw_rate"],
    "total_station": ["x", "y", "z"],
    "cmd_vel": ["vx", "yaw_rate"],
}


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_columns_written_are_columns_read(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    tables = {}
    for key in data.draw(st.sets(st.sampled_from(sorted(COLUMNS)), min_size=1)):
        steps = data.draw(st.lists(st.integers(1, 10**9), min_size=1, max_size=20))
        stamps = 10**18 + np.cumsum(np.array(steps, np.int64))
        rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
        tables[key] = (stamps, {name: rng.standard_normal(len(stamps)) * 10 for name in COLUMNS[key]})
    folder = write_channels(tmp_path_factory.mktemp("x") / "run", tables)
    experiment = read_bag(folder)
    assert set(experiment.channels) == set(tables)
    for key, (stamps, columns) in tables.items():
        channel = experiment.channels[key]
        assert channel.topic == BY_KEY[key].name
        assert channel.t_ns.tolist() == stamps.tolist()
        assert (np.rint(channel.t * 1e9).astype(np.int64) + experiment.start_ns).tolist() == stamps.tolist()
        for name, values in columns.items():
            assert np.array_equal(channel[name], values)
