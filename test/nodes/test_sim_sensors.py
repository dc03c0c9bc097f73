"""Effects on sensors in the simulator: its topics show them, the truth does not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from model.effects import SENSORS_1
from rclpy.node import Node
from sim_probe import TYPES, Probe, stamp_ns

from artibot_driver.simulated.motion import ShaftCommand
from artibot_sim.model import load_robot, save_robot
from artibot_sim.model.robot.parameters import SensorErrors
from artibot_sim.nodes.common.rotations import rotation
from artibot_sim.nodes.common.transforms import FrameNames
from artibot_sim.nodes.drives.motors import RoverShafts
from artibot_sim.nodes.sim.engine import Periods, StartPose
from artibot_sim.nodes.sim.publishers import Published, Publishers
from artibot_sim.nodes.sim.sensors import SensorModel, SimulatedSensors

ERRORS = SensorErrors(1.02, 0.85, 0.12, -0.08, 0.12, -0.01)


def test_errors_of_the_robot_come_before_those_of_the_sensors() -> None:
    sensors = SimulatedSensors(SensorModel(encoder_counts=2048, gyro_bias=0.003), 0, ERRORS)
    angle, count = np.array([10.0, -3.0]), 2 * math.pi / 2048
    np.testing.assert_allclose(sensors.encoders(angle), np.round(1.02 * angle / count) * count)
    np.testing.assert_allclose(sensors.velocities(0, angle), 1.02 * angle)
    np.testing.assert_allclose(sensors.torques(angle), 0.85 * angle)
    assert sensors.imu(np.array([0.0, 0.0, 0.2]), np.zeros(3))[0][2] == pytest.approx(0.2 - 0.01 + 0.003)


def test_velocities_are_smoothed_as_by_a_low_pass() -> None:
    """A ramp comes out late by the time constant; a clock that is set back begins anew."""
    sensors = SimulatedSensors(SensorModel(), 0, SensorErrors(encoder_scale=1.02, velocity_filter=0.05))
    shown = [sensors.velocities(round(1e7 * k), np.array([3.0 * 0.01 * k]))[0] for k in range(200)]
    t = 0.01 * np.arange(200)
    np.testing.assert_allclose(shown, 1.02 * 3.0 * (t - 0.05 * (1.0 - np.exp(-t / 0.05))), atol=1e-12)
    assert sensors.velocities(0, np.array([7.0]))[0] == pytest.approx(1.02 * 7.0)


def test_the_prism_is_seen_late_and_off_the_origin() -> None:
    sensors = SimulatedSensors(SensorModel(prism=(0.1, 0.0, 0.5)), 0, ERRORS)

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.5 * t, 0.1 * t, 0.0]), rotation(0.0, 0.0, 0.4 * t)

    for k in range(100):
        t = 0.01 * k
        seen = sensors.follow(k * 10_000_000, *at(t))
        position, attitude = at(max(t - 0.12, 0.0))
        np.testing.assert_allclose(seen, position + attitude @ [0.22, -0.08, 0.5], atol=1e-12)


def test_a_delay_between_two_publications_is_interpolated() -> None:
    sensors = SimulatedSensors(SensorModel(), 0, SensorErrors(delay=0.025))
    for k in range(20):
        seen = sensors.follow(k * 10_000_000, np.array([0.01 * k, 0.0, 0.0]), np.eye(3))
    assert seen[0] == pytest.approx(0.19 - 0.025)


def test_drives_measure_what_encoders_turn() -> None:
    robot = replace(load_robot("agriq"), effects={"encoder_scale": {"scale": 1.02}})
    shafts = RoverShafts(robot, Periods.of(100.0, 1e-3), StartPose())
    for motor in shafts.shafts.values():
        motor.command(ShaftCommand(20.0, None, 2.0))
    shafts.advance(200)
    truth = shafts.sample()
    for i, motor in enumerate(shafts.shafts.values()):
        assert motor.state().velocity == pytest.approx(1.02 * truth.motor_velocity[i])
        assert motor.state().position == pytest.approx(1.02 * truth.motor_position[i])


def test_topics_show_what_sensors_see_and_the_truth_what_is(start_node, ros_context, tmp_path: Path) -> None:
    robot = replace(load_robot("agriq"), effects=dict(SENSORS_1))
    save_robot(robot, tmp_path / "seen.yaml")
    enabled = ("-p", "imu.enabled:=true", "-p", "total_station.enabled:=true", "-p", "command_timeout:=0.5")
    start_node("sim", "--robot", tmp_path / "seen.yaml", "--start", 1.0, 2.0, 0.5, "--ros-args", *enabled)
    probe = Probe(ros_context, [t for t in TYPES if t != "/clock"])
    probe.ready()
    probe.repeat(lambda: probe.send_request((60.0, 40.0)), 2.5)
    truth = {stamp_ns(m): m for m in probe.got["ground_truth/odom"]}
    compared = 0
    for message in probe.got["total_station/point"]:
        then = truth.get(stamp_ns(message) - 120_000_000)
        if then is None:
            continue
        q = then.pose.pose.orientation
        yaw = 2 * math.atan2(q.z, q.w)
        x = then.pose.pose.position.x + math.cos(yaw) * 0.12 + math.sin(yaw) * 0.08
        assert message.point.x == pytest.approx(x, abs=1e-4)  # the rover pitches a little
        compared += 1
    assert compared >= 5
    told = {stamp_ns(m): np.array(m.velocity[:2]) for m in probe.got["motor_command"]}
    motors = [m for m in probe.got["motor_torques"] if told.get(stamp_ns(m), np.zeros(2))[0] > 1.0]
    assert len(motors) > 150
    for message in motors[120:]:  # until what smooths them has settled
        np.testing.assert_allclose(message.velocity[:2], 1.02 * told[stamp_ns(message)], rtol=1e-3)
    efforts = {stamp_ns(m): np.array(m.effort[2:]) for m in probe.got["motor_command"]}
    both = [(np.array(m.effort[2:]), efforts[stamp_ns(m)]) for m in motors if stamp_ns(m) in efforts]
    np.testing.assert_allclose(*(np.array(column) for column in zip(*[(a, 0.85 * b) for a, b in both], strict=True)))
    rates = {stamp_ns(m): m.angular_velocity.z for m in probe.got["imu/data"]}
    off = [rates[k] - m.twist.twist.angular.z for k, m in truth.items() if k in rates]
    np.testing.assert_allclose(off, -0.01, atol=1e-12)


def test_motors_behind_drives_are_measured_by_these_alone(ros_context) -> None:
    """What smooths speeds goes on by each measurement: one for topics of which there are none would spoil it."""
    robot, node = load_robot("agriq"), Node("sim", context=ros_context)
    out = Publishers(node, robot, Published(False, False, True, False, False, False, FrameNames(), 0.0, 0.0))

    def speeds(publishes: bool) -> list[float]:
        sensors = SimulatedSensors(SensorModel(velocity=0.1), 1, SensorErrors(velocity_filter=0.05))
        shafts = RoverShafts(robot, Periods.of(100.0, 1e-3), StartPose(), sensors=sensors)
        for motor in shafts.shafts.values():
            motor.command(ShaftCommand(20.0, None, 2.0))
        for k in range(20):
            shafts.advance(5)
            if publishes:
                out.publish(10**18 + k * 10_000_000, shafts.sample(), sensors, None, False)
            found = [motor.state().velocity for motor in shafts.shafts.values()]
        return found

    try:
        assert speeds(True) == speeds(False)
    finally:
        node.destroy_node()
