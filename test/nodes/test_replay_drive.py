"""`artibot replay --drive`: an experiment driven again, with the simulation node as the rover."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")

from bag_helpers import in_namespaces
from replay_probe import OUTPUTS, Listener, recorded, types_of

from artibot_sim.experiment import read_bag
from artibot_sim.nodes.common.stamps import stamp_of
from ros_helpers import NodeStarter

if TYPE_CHECKING:
    from rclpy.context import Context

ODOMETRY = "nav_msgs/msg/Odometry"


def decoded(data: bytes, kind: type) -> Any:
    from rclpy.serialization import deserialize_message

    return deserialize_message(data, kind)


def test_the_profile_starts_anew_and_the_sign_of_life_goes_on(
    start_node: NodeStarter, ros_context: Context, inputs: Path
) -> None:
    from trajectory_msgs.msg import JointTrajectory

    types = {topic: kind for topic, kind in types_of(inputs).items() if topic not in ("/strange", "/clock")}
    listener = Listener(ros_context, types)
    began = time.time()
    with listener.listening():
        node = start_node("replay", inputs, "--drive", "--delay", 0.8)
        node.wait_for("starts at")
        qos = listener.node.get_publishers_info_by_topic("/planned/front_velocity")[0].qos_profile
        assert node.wait() == 0
    assert qos.durability.name == "TRANSIENT_LOCAL"
    (profile,) = listener.bytes_of("/planned/front_velocity")
    published = listener.times_of("/planned/front_velocity")[0]
    start = stamp_of(profile) / 1e9
    assert began < published < start <= published + 0.8
    old, new = (decoded(data, JointTrajectory) for data in (recorded(inputs)["/planned/front_velocity"][0], profile))
    assert new.points == old.points
    assert new.joint_names == old.joint_names
    end = start + read_bag(inputs).channels["planned_front_velocity"]["time_from_start"][-1]
    signs = listener.times_of("/planned/odom")
    assert signs[0] <= published + 0.5
    assert signs[-1] >= end
    assert np.median(np.diff(signs)) <= 0.05
    assert (np.diff([stamp_of(data) for data in listener.bytes_of("/planned/odom")]) > 0).all()
    assert all(
        abs(stamp_of(data) / 1e9 - at) < 0.5 for data, at in zip(listener.bytes_of("/planned/odom"), signs, strict=True)
    )
    assert listener.got["/cmd_vel"], "a recorded input"
    assert all(stamp_of(data) / 1e9 >= published for data in listener.bytes_of("/cmd_vel"))
    assert not listener.got["/motor_command_request"], "never unless asked for by name"
    assert not any(listener.got[topic] for topic in OUTPUTS)


def test_signs_of_life_say_where_the_rover_ought_to_be(
    start_node: NodeStarter, ros_context: Context, rover: Path
) -> None:
    from nav_msgs.msg import Odometry

    listener = Listener(ros_context, {"/planned/odom": ODOMETRY})
    with listener.listening():
        node = start_node("replay", rover, "--drive", "--wait", 0)
        node.wait_for("starts at")
        assert node.wait() == 0
    start = float(node.output.split("starts at ")[1].split(",")[0])
    planned = read_bag(rover).channels["planned_odom"]
    for data in listener.bytes_of("/planned/odom"):
        message = decoded(data, Odometry)
        since = stamp_of(data) / 1e9 - start
        x = message.pose.pose.position.x
        near = planned["x"][(planned.t >= since - 0.045) & (planned.t <= since + 0.002)]
        assert x in near or (since < 0.05 and x == 0.0) or (since > planned.t[-1] and x == planned["x"][-1])


def test_outputs_and_requests_only_by_name(start_node: NodeStarter, ros_context: Context, inputs: Path) -> None:
    wanted = {"/odom": ODOMETRY, "/motor_torques": "sensor_msgs/msg/JointState"}
    listener = Listener(ros_context, wanted | {"/motor_command_request": "sensor_msgs/msg/JointState"})
    args = ("--drive", "--wait", 1, "--delay", 0.2, "-x", "cmd_vel,base/*,arm/*,planned/*")
    with listener.listening():
        node = start_node("replay", inputs, *args, "--request-from", "motor_command", "-t", "odom")
        assert node.wait() == 0
    original = recorded(inputs)
    assert listener.bytes_of("/odom") == original["/odom"]
    assert not listener.got["/motor_torques"]
    requests = listener.bytes_of("/motor_command_request")
    assert [data[12:] for data in requests] == [data[12:] for data in original["/motor_command"]]
    assert all(abs(stamp_of(data) - at) < 5e8 for data, at in listener.got["/motor_command_request"])


def test_two_rovers_get_signs_of_life_beside_their_profiles_and_requests_in_their_namespace(
    start_node: NodeStarter, ros_context: Context, tmp_path: Path, rover: Path
) -> None:
    two = in_namespaces(tmp_path / "two", rover, "/rover1", "/rover2")
    life = ["/rover1/planned/odom", "/rover2/planned/odom", "/planned/odom"]
    requests = ["/rover2/motor_command_request", "/motor_command_request"]
    listener = Listener(
        ros_context, dict.fromkeys(life, ODOMETRY) | dict.fromkeys(requests, "sensor_msgs/msg/JointState")
    )
    with listener.listening():
        node = start_node("replay", two, "--drive", "--wait", 0, "--request-from", "/rover2/motor_command")
        assert node.wait() == 0, node.output
    recorded_poses = {data[12:] for data in recorded(rover)["/planned/odom"]}
    for topic in life[:2]:
        assert len(listener.got[topic]) > 20
        assert {data[12:] for data in listener.bytes_of(topic)} <= recorded_poses, "its own, with a new stamp"
    assert [len(listener.got[topic]) > 0 for topic in requests] == [True, False]
    assert not listener.got["/planned/odom"]


@pytest.mark.parametrize("space", ["", "/rover1"])
def test_an_experiment_is_driven_again_by_the_simulation(
    start_node: NodeStarter, ros_context: Context, tmp_path: Path, rover: Path, space: str
) -> None:
    from nav_msgs.msg import Odometry

    listener = Listener(ros_context, {f"{space}/ground_truth/odom": ODOMETRY})
    # a third of the drive: signs of life that are lost show, and a machine that is held up for half a second does not
    below = ("-r", f"__ns:={space}") if space else ()
    sim = start_node("sim", "--robot", "agriq", "--ros-args", "-p", "command_timeout:=1.0", *below)
    sim.wait_for("is ready")
    with listener.listening():
        node = start_node("replay", in_namespaces(tmp_path / "bag", rover, space), "--drive")
        assert node.wait() == 0, node.output
    assert "silent" not in sim.output and "no sign of life" not in sim.output
    truth = read_bag(rover).channels["ground_truth_odom"]
    last = decoded(listener.bytes_of(f"{space}/ground_truth/odom")[-1], Odometry).pose.pose.position
    assert truth["x"][-1] > 0.8
    assert (last.x, last.y) == pytest.approx((truth["x"][-1], truth["y"][-1]), abs=2e-3)


def test_driving_follows_simulated_time(start_node: NodeStarter, ros_context: Context, rover: Path) -> None:
    from nav_msgs.msg import Odometry

    listener = Listener(ros_context, {"/ground_truth/odom": ODOMETRY})
    sim = start_node("sim", "--robot", "agriq", "--rate", 2, "--ros-args", "-p", "command_timeout:=0.5")
    sim.wait_for("is ready")
    with listener.listening():
        node = start_node("replay", rover, "--drive", "--use-sim-time")
        assert node.wait() == 0, node.output
    truth = read_bag(rover).channels["ground_truth_odom"]
    last = decoded(listener.bytes_of("/ground_truth/odom")[-1], Odometry).pose.pose.position
    assert (last.x, last.y) == pytest.approx((truth["x"][-1], truth["y"][-1]), abs=2e-3)


def test_nobody_to_drive_is_an_error(start_node: NodeStarter, rover: Path) -> None:
    node = start_node("replay", rover, "--drive", "--wait-timeout", 0.5)
    assert node.wait() == 2
    assert "fewer than 1 listeners" in node.output


def test_a_signal_ends_the_sign_of_life(start_node: NodeStarter, ros_context: Context, rover: Path) -> None:
    listener = Listener(ros_context, {"/planned/odom": ODOMETRY})
    with listener.listening():
        node = start_node("replay", rover, "--drive", "--wait", 0)
        node.wait_for("starts at")
        until = time.monotonic() + 10.0
        while not len(listener.times_of("/planned/odom")) and time.monotonic() < until:
            time.sleep(0.05)  # discovery takes a while
        node.send(signal.SIGTERM)
        asked = time.time()
        assert node.wait(10.0) == 0
    assert "standstill" in node.output
    assert listener.times_of("/planned/odom")[-1] < asked + 1.0
