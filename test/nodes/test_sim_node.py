"""The simulation node in its own process: topics, commands, silence, refusals, end."""

from __future__ import annotations

import importlib.util
import json
import math
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy, qos_profile_sensor_data
from sim_probe import FRONT, MEASURED, METRES, TYPES, Probe, stamp_ns

from artibot_sim.model import load_robot, save_robot

ALL = [*FRONT, "back_right", "back_left"]
NAN = math.nan

PATIENT = ("-p", "command_timeout:=0.5")
"""For tests that are not about the timeout's length: a busy machine holds up a test for longer than 0.1 s."""


def bump(seconds: float, top: float = 80.0, ratio: float = 1.0) -> list[tuple[float, float]]:
    """Up to `top` rad/s at the motor and back."""
    n = round(seconds * 100)
    shape = [top * math.sin(math.pi * i / n) ** 2 for i in range(n)] + [0.0]
    return [(s, s * ratio) for s in shape]


def test_topics_types_stamps_and_rest(start_node, ros_context) -> None:
    start_node("sim", "--start", 1.0, 2.0, 0.5, "--params", "sim_noisy", "--ros-args", "-p", "noise.velocity:=0.0")
    probe = Probe(ros_context, [t for t in TYPES if t != "/clock"])
    probe.ready()
    probe.clear()
    probe.until(lambda: len(probe.got["total_station/point"]) >= 5, "points of the total station")
    found = dict(probe.node.get_topic_names_and_types())
    for topic, kind in TYPES.items():
        if topic != "/clock":
            assert found[f"/{topic}"] == [f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"]
    assert "/clock" not in found or not probe.node.get_publishers_info_by_topic("/clock")
    assert ("/tf" in found) == (importlib.util.find_spec("tf2_msgs") is not None)
    for topic in MEASURED:
        info = probe.node.get_publishers_info_by_topic(f"/{topic}")
        assert [i.qos_profile.reliability for i in info] == [ReliabilityPolicy.RELIABLE]
        stamps = np.array([stamp_ns(message) for message in probe.got[topic]])
        assert np.diff(stamps).min() == np.median(np.diff(stamps)) == 10_000_000
        assert abs(stamps[-1] * 1e-9 - time.time()) < 5.0, "without /clock stamps are system time"
    truth, odom = probe.last(), probe.last("odom")
    assert (truth.header.frame_id, truth.child_frame_id, odom.header.frame_id) == ("map", "base_link", "odom")
    for message in (truth, odom):
        pose = message.pose.pose
        assert (pose.position.x, pose.position.y) == pytest.approx((1.0, 2.0), abs=1e-6)
        assert 2 * math.atan2(pose.orientation.z, pose.orientation.w) == pytest.approx(0.5, abs=1e-6)
    joints, torques, command = probe.last("joint_states"), probe.last("motor_torques"), probe.last("motor_command")
    assert joints.name == [f"{m}_{e}_wheel" for m in ALL for e in ("front", "back")] + [
        "articulation_yaw",
        "articulation_roll",
    ]
    assert len(joints.position) == len(joints.velocity) == 10
    assert torques.name == command.name == ALL
    assert list(torques.velocity) == pytest.approx([0.0] * 4, abs=1e-9) and len(torques.effort) == 4
    assert list(command.velocity[:2]) == [0.0, 0.0] and all(map(math.isnan, command.velocity[2:]))
    assert all(map(math.isnan, command.effort[:2])) and all(map(math.isfinite, command.effort[2:]))
    assert probe.last("imu/data").linear_acceleration.z == pytest.approx(9.81, abs=0.5)
    assert probe.last("total_station/point").point.x == pytest.approx(1.0, abs=0.05)


def test_a_train_publishes_all_its_modules_and_drives(start_node, ros_context) -> None:
    """Three modules, the third without motors: its wheels and its joint are there, a motor is not; all of it rolls."""
    start_node("sim", "--robot", "train3", "--ros-args", *PATIENT)
    probe = Probe(ros_context, ["joint_states", "motor_torques", "ground_truth/odom"])
    probe.ready()
    probe.repeat(lambda: probe.send_request([100.0, 140.0]), 6.0)
    joints, torques = probe.last("joint_states"), probe.last("motor_torques")
    third = [f"module_3_{side}_{end}_wheel" for side in ("right", "left") for end in ("front", "back")]
    own = [f"{m}_{e}_wheel" for m in ALL for e in ("front", "back")]
    bends = [f"articulation_{axis}{number}" for number in ("", "_2") for axis in ("yaw", "roll")]
    assert list(joints.name) == [*own, *third, *bends]
    assert torques.name == ALL, "a passive module has no motors"
    angle = dict(zip(joints.name, joints.position, strict=True))
    assert min(angle[wheel] for wheel in third) > 1.0, "the third module is pulled along"
    assert angle["articulation_yaw"] > 0.05 and angle["articulation_yaw_2"] > 0.01, (
        "it turns right, those behind follow"
    )
    tau = load_robot("train3").drive.front.tau
    assert angle["front_right_front_wheel"] == pytest.approx(torques.position[0] * tau, rel=0.1)


def test_a_rigid_robot_has_two_motors_and_no_articulation(start_node, ros_context) -> None:
    start_node("sim", "--robot", "husky", "--ros-args", "-r", "__ns:=/rover1", "-r", "odom:=believed")
    probe = Probe(ros_context, ())
    got: dict[str, list] = {"motor_torques": [], "joint_states": [], "believed": []}
    for topic, messages in got.items():
        kind = TYPES.get(topic, TYPES["odom"])
        probe.node.create_subscription(kind, f"/rover1/{topic}", messages.append, qos_profile_sensor_data)
    probe.until(lambda: all(got.values()), "topics by their remapped names", 60.0)
    torques, joints = got["motor_torques"][-1], got["joint_states"][-1]
    assert torques.name == FRONT and len(torques.position) == len(torques.velocity) == len(torques.effort) == 2
    assert joints.name == [f"{motor}_{end}_wheel" for motor in FRONT for end in ("front", "back")]
    assert len(joints.position) == len(joints.velocity) == 4


def test_profile_silence_and_stale_profiles(start_node, ros_context) -> None:
    node = start_node("sim", "--kappa", 0.8, "--ros-args", *PATIENT)
    probe = Probe(ros_context, MEASURED)
    probe.ready()
    start = probe.now_ns() + 500_000_000
    probe.send_profile(start, bump(2.0, ratio=0.8))
    probe.keep_alive(2.8)
    told = {stamp_ns(m): tuple(m.velocity[:2]) for m in probe.got["motor_command"]}
    peak = max(told.values())
    assert peak[0] == pytest.approx(80.0, rel=1e-3) and peak[1] == pytest.approx(0.8 * peak[0])
    first = min(stamp for stamp, pair in told.items() if pair[0] > 0)
    assert 0 < first - start <= 20_000_000, "absolute start"
    turned = probe.last("motor_torques").position
    assert turned[0] == pytest.approx(80.0, rel=1e-6), "the integral of the profile, to the end"
    assert probe.last().pose.pose.position.x == pytest.approx(80.0 * METRES * 0.9, rel=0.1)
    assert abs(probe.speed()) < 0.02

    probe.send_profile(probe.now_ns() + 300_000_000, bump(6.0))
    probe.keep_alive(2.5)
    assert probe.speed() > 0.2
    probe.clear()
    probe.spin(1.5)  # the planner is silent
    assert abs(probe.speed()) < 0.01
    assert probe.braking().max() <= 2.0 * (1 + 1e-6)
    node.wait_for("no sign of life")
    probe.keep_alive(1.0)
    assert abs(probe.speed()) < 0.01, "not taken up again"

    probe.send_profile(probe.now_ns() - 1_500_000_000, bump(6.0))
    probe.keep_alive(0.6)
    assert abs(probe.speed()) < 0.01
    assert "in the past" in node.wait_for("refused")


def test_live_requests_and_their_silence(start_node, ros_context) -> None:
    node = start_node("sim", "--ros-args", *PATIENT)
    probe = Probe(ros_context, MEASURED)
    probe.ready()
    effort = [NAN, NAN, 0.05, -0.05]
    probe.repeat(lambda: probe.send_request([60.0, 40.0, NAN, NAN], ALL, effort), 1.0)
    assert list(probe.last("motor_command").velocity[:2]) == [60.0, 40.0]
    assert list(probe.last("motor_torques").effort[2:]) == pytest.approx([0.05, -0.05]), "overrides eq. 30"
    probe.repeat(lambda: probe.send_request([60.0, 40.0]), 0.5)
    assert list(probe.last("motor_torques").effort[2:]) != pytest.approx([0.05, -0.05])
    assert probe.last("odom").twist.twist.linear.x == pytest.approx(50.0 * METRES, rel=1e-3)
    probe.clear()
    probe.spin(1.5)
    commands = np.array([m.velocity[:2] for m in probe.got["motor_command"]])
    moving = commands[(commands[:, 0] > 0) & (commands[:, 0] < 60.0)]
    assert len(moving) > 5
    np.testing.assert_allclose(moving[:, 1] / moving[:, 0], 2 / 3, rtol=1e-9)
    assert not commands[-1].any()
    node.wait_for("motor_command_request is silent")


@pytest.mark.parametrize("stamped", [True, False])
def test_cmd_vel_and_its_silence(start_node, ros_context, stamped: bool) -> None:
    start_node("sim", "--ros-args", "-p", f"cmd_vel_stamped:={str(stamped).lower()}", "-p", "cmd_vel_timeout:=1.0")
    probe = Probe(ros_context, MEASURED)
    send = probe.send_twist if stamped else probe.send_plain_twist
    if stamped:
        probe.ready()
    else:
        probe.node.destroy_publisher(probe.twist)
        send(0.0, 0.0)
        probe.until(lambda: probe.plain_twist.get_subscription_count() > 0, "the simulator to listen", 60.0)
    probe.repeat(lambda: send(0.4, 0.2), 1.5, every=0.1)
    twist = probe.last("odom").twist.twist
    assert (twist.linear.x, twist.angular.z) == pytest.approx((0.4, 0.2), rel=1e-3)
    probe.spin(0.25)
    assert probe.last("odom").twist.twist.linear.x == pytest.approx(0.4, rel=1e-3), "the last one holds"
    probe.spin(1.8)
    assert abs(probe.last("odom").twist.twist.linear.x) < 1e-3


def test_bad_commands_are_refused_and_do_not_move_the_rover(start_node, ros_context) -> None:
    node = start_node("sim")
    probe = Probe(ros_context, MEASURED)
    probe.ready()
    bad = [
        lambda: probe.send_request([NAN, 50.0]),
        lambda: probe.send_request([50.0, 50.0], ["front_right", "rear_left"]),
        lambda: probe.send_request([50.0]),
        lambda: probe.send_request([50.0, 50.0], effort=[1.0]),
        lambda: probe.send_request([1e9, 0.0]),
        lambda: probe.send_twist(NAN, 0.0),
        lambda: probe.send_twist(0.0, math.inf),
        lambda: probe.send_profile(probe.now_ns(), [(0.0, 0.0), (NAN, 1.0)]),
        lambda: probe.send_profile(probe.now_ns(), [(0.0, 0.0), (50.0, 50.0)], names=["front_left", "x"]),
        lambda: probe.send_profile(probe.now_ns(), [(50.0,), (50.0,)]),
        lambda: probe.send_profile(probe.now_ns(), []),
    ]
    for send in bad:
        probe.repeat(send, 0.15)
    probe.keep_alive(0.3)
    for topic in ("motor_command_request", "cmd_vel", "planned/front_velocity"):
        assert f"{topic} refused" in node.output
    assert node.output.count("motor_command_request refused") < 10, "throttled"
    assert not any(any(m.velocity[:2]) for m in probe.got["motor_command"])
    assert max(abs(m.twist.twist.linear.x) for m in probe.got["ground_truth/odom"]) < 1e-9
    probe.repeat(lambda: probe.send_request([50.0, 50.0]), 0.5)
    assert probe.speed() > 0.1, "and it still listens"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly(start_node, tmp_path: Path, number: signal.Signals) -> None:
    node = start_node("sim", "--stats", tmp_path / "stats.json")
    node.wait_for("is ready", 60.0)
    time.sleep(0.3)
    node.send(number)
    assert node.wait() == 0
    assert "Traceback" not in node.output
    found = json.loads((tmp_path / "stats.json").read_text())
    assert found["steps"] > 10 and found["late_p99_ms"] >= found["late_p50_ms"] > 0.0


def test_divergence_ends_it_with_a_reason(start_node, ros_context, tmp_path: Path) -> None:
    """A gear so slow that 4 m/s takes the motors beyond any speed the model takes for real."""
    save_robot(load_robot("agriq").replace({"drive.front.tau": 1e-5}), tmp_path / "slow_gear.yaml")
    node = start_node("sim", "--robot", tmp_path / "slow_gear.yaml")
    probe = Probe(ros_context, ["ground_truth/odom", "motor_torques"])
    probe.ready()
    probe.repeat(lambda: probe.send_request([2e6, 2e6]), 0.5)
    assert node.wait() == 1
    assert "diverged" in node.output and "Traceback" not in node.output
    for message in probe.got["motor_torques"]:
        assert np.isfinite([message.position, message.velocity, message.effort]).all()


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["--robot", "nobody"], "nobody"),
        (["--kappa", "0"], "kappa"),
        (["--ros-args", "-p", "rate:=-1.0"], "rate"),
        (["--ros-args", "-p", "dt:=0.003"], "dt"),
        (["--ros-args", "-p", "integrator:=euler"], "integrator"),
        (["--integrator", "rk4", "--dt", "0.01"], "unstable"),
        (["--command-source", "joystick"], "joystick"),
        (["--stats", "/nowhere/at_all/stats.json"], "/nowhere/at_all"),
    ],
)
def test_bad_parameters_end_it_with_one_line(start_node, args: list[str], says: str) -> None:
    node = start_node("sim", *args)
    assert node.wait() == 2
    lines = [line for line in node.output.splitlines() if not line.startswith("[INFO]")]
    assert len(lines) == 1 and says in lines[0], node.output
