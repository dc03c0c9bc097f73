"""What results say of each stream as numbers: what a logger did to it, with an interval, and nothing to the others."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from estimation.logger import FLAWS, drive, recorded, robot_of, trial

from artibot_sim.estimation.alignment import on_one_clock, stream_table, with_faults
from artibot_sim.estimation.model_odometry import ModelOdometry
from artibot_sim.model.robot.file import robot_from_dict, robot_to_dict


@pytest.mark.parametrize(
    ("flaw", "stream"),
    [("gyro_delay", "imu"), ("rotation_delay", "motor_torques"), ("articulation_delay", "joint_states")],
)
def test_the_late_stream_has_its_delay_and_the_others_have_none(flaw: str, stream: str) -> None:
    robot, experiment, found = trial(flaw, 11)
    (truth,) = (one.value for one in found if one.name == flaw)
    table, topic = stream_table(on_one_clock([experiment], robot)), experiment.channels[stream].topic
    assert json.loads(json.dumps(table, allow_nan=False)) == table
    delay = table[topic][experiment.name]["delay"]
    low, high = delay["ci95"]
    assert low <= delay["value"] == truth <= high and "against" not in delay
    for other, recordings in table.items():
        if other != topic:
            beside = recordings[experiment.name].get("delay", {"ci95": (0.0, 0.0), "against": ""})
            assert "against" in beside and beside["ci95"][0] <= 0.03 and beside["ci95"][1] >= -0.03


def test_a_gyroscope_upside_down_has_its_sign_and_a_held_stream_its_period() -> None:
    robot, experiment, _ = trial("gyro_flip", 3)
    table = stream_table(on_one_clock([experiment], robot))
    signs = {topic: recordings[experiment.name]["sign"] for topic, recordings in table.items()}
    assert signs.pop(experiment.channels["imu"].topic) == -1 and set(signs.values()) == {1}
    robot, experiment, found = trial("held_samples", 3)
    table = stream_table(on_one_clock([experiment], robot))
    for one in found:
        if one.name == "held_samples":
            hold = table[one.topic][experiment.name]["hold"]
            assert hold["share"] == one.value and hold["period"] > 0.0


def test_what_one_recording_tells_of_a_delay_mends_another_that_does_not_tell() -> None:
    """The file of an identified robot has it, and without a pose nothing in a recording shows that a gyro is late."""
    robot, experiment, found = trial("gyro_delay", 11)
    (truth,) = (one for one in found if one.name == "gyro_delay")
    timed = on_one_clock([experiment], robot)
    known = robot_from_dict(robot_to_dict(with_faults(robot, timed, "identified")))
    assert known.sensors.gyro_delay == pytest.approx(truth.value) and known.sensors.rotation_delay == 0.0
    assert known.intervals["sensors.gyro_delay"] == pytest.approx(truth.interval)
    assert with_faults(robot, [*timed, *on_one_clock([trial("none", 5)[1]], robot)], "identified") == robot

    alone = {key: one for key, one in experiment.channels.items() if key in ("imu", "motor_torques")}
    still = replace(alone["motor_torques"], columns={n: 0.0 * v for n, v in alone["motor_torques"].columns.items()})
    silent = replace(experiment, channels={**alone, "motor_torques": still})
    (mended,) = on_one_clock([silent], known)
    shift = mended.experiment.channels["imu"].t - silent.channels["imu"].t
    np.testing.assert_allclose(shift, -truth.value, atol=1e-6)
    assert [one.name for one in mended.mended] == ["gyro_delay"]
    (again,) = on_one_clock([experiment], known)  # it tells itself, and is shifted once
    np.testing.assert_array_equal(again.experiment.channels["imu"].t, timed[0].experiment.channels["imu"].t)


def test_a_gyroscope_that_was_upside_down_once_is_turned_where_a_recording_does_not_tell() -> None:
    robot, experiment, _ = trial("gyro_flip", 3)
    known = robot_from_dict(robot_to_dict(with_faults(robot, on_one_clock([experiment], robot), "identified")))
    assert known.sensors.gyro_flip == 1.0 and robot.sensors.gyro_flip == 0.0
    motors = experiment.channels["motor_torques"]
    still = replace(motors, columns={name: 0.0 * values for name, values in motors.columns.items()})
    silent = replace(experiment, channels={"motor_torques": still, "imu": experiment.channels["imu"]})
    (mended,) = on_one_clock([silent], known)
    np.testing.assert_array_equal(mended.experiment.channels["imu"]["yaw_rate"], -silent.channels["imu"]["yaw_rate"])
    (once,) = on_one_clock([experiment], known)  # it tells itself, and is turned once
    np.testing.assert_array_equal(once.experiment.channels["imu"]["yaw_rate"], -experiment.channels["imu"]["yaw_rate"])
    upright = replace(experiment, channels={**experiment.channels, "imu": once.experiment.channels["imu"]})
    (right,) = on_one_clock([upright], known)  # it tells that it is right
    np.testing.assert_array_equal(right.experiment.channels["imu"]["yaw_rate"], upright.channels["imu"]["yaw_rate"])


def test_a_gyroscope_s_bias_goes_into_the_robot_file_and_odometry_begins_with_it() -> None:
    """Upside down or not; with the effect fitted it is the model's matter, and in one of two recordings nobody's."""
    for name, sign in (("gyro_bias", 1.0), ("gyro_flip", -1.0)):
        logger = replace(FLAWS[name], gyro_bias=0.05)
        rng = np.random.default_rng(7)
        robot = robot_of(rng)
        timed = on_one_clock([recorded(drive(robot, rng), logger, rng)], robot)
        known = robot_from_dict(robot_to_dict(with_faults(robot, timed, "identified")))
        low, high = known.intervals["sensors.gyro_bias"]
        assert low < sign * 0.05 < high and known.sensors.gyro_bias == pytest.approx(sign * 0.05, abs=0.005)
        assert ModelOdometry(known).gyro.bias == pytest.approx(0.05, abs=0.005)
        fitted = replace(robot, effects={"gyro_bias": {"bias": 0.02}})
        assert with_faults(fitted, timed, "identified").sensors.gyro_bias == 0.0
        assert ModelOdometry(replace(fitted, sensors=known.sensors)).gyro.bias == 0.02
        clean = on_one_clock([trial("none", 5)[1]], robot)
        assert with_faults(robot, [*timed, *clean], "identified").sensors.gyro_bias == 0.0


def test_the_drift_of_a_clock_goes_into_the_robot_file_and_back() -> None:
    robot, experiment, found = trial("clock_skew", 3)
    (truth,) = (one for one in found if one.name == "clock_skew")
    timed = on_one_clock([experiment], robot)
    known = robot_from_dict(robot_to_dict(with_faults(robot, timed, "identified")))
    assert known.sensors.clock_skew == pytest.approx(truth.value)
    motors = experiment.channels["motor_torques"]
    still = replace(motors, columns={name: 0.0 * values for name, values in motors.columns.items()})
    channels = {"motor_torques": still, "ground_truth_odom": experiment.channels["ground_truth_odom"]}
    (mended,) = on_one_clock([replace(experiment, channels=channels)], known)
    before, after = channels["ground_truth_odom"].t, mended.experiment.channels["ground_truth_odom"].t
    assert np.ptp(before) / np.ptp(after) - 1.0 == pytest.approx(1e-6 * truth.value, rel=1e-2)
