"""`artibot odometry` as a process: beside a simulator that slips, and fed with what no model should swallow."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from sim_probe import Probe

from ros_helpers import NodeStarter


def yaw_of(message: Odometry) -> float:
    q = message.pose.pose.orientation
    return 2.0 * math.atan2(q.z, q.w)


def test_beside_a_rover_that_slips_it_is_nearer_to_the_truth_than_wheels(
    start_node: NodeStarter, ros_context: Any
) -> None:
    node = start_node("odometry", "--robot", "husky")
    sim = start_node("sim", "--robot", "husky")
    node.wait_for("odometry from motor_torques", 60.0)
    probe, got = Probe(ros_context, ("odom", "ground_truth/odom")), []
    probe.node.create_subscription(Odometry, "odom_model", got.append, 100)
    probe.ready()
    probe.until(lambda: bool(got), "odom_model", 30.0)
    probe.repeat(lambda: probe.send_request([6.0, 2.0]), 4.0)
    truth, wheels, model = yaw_of(probe.last()), yaw_of(probe.last("odom")), yaw_of(got[-1])
    assert abs(math.remainder(truth, math.tau)) > 0.3
    assert abs(math.remainder(model - truth, math.tau)) < 0.25 * abs(math.remainder(wheels - truth, math.tau))
    last = got[-1]
    assert (last.header.frame_id, last.child_frame_id) == ("odom", "base_link")
    covariance = np.array(last.pose.covariance).reshape(6, 6)
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert covariance[5, 5] > 2.0 * np.array(got[0].pose.covariance).reshape(6, 6)[5, 5]
    assert last.twist.twist.angular.z > 0.1
    assert (node.stop(), sim.stop()) == (0, 0)


def test_it_survives_messages_of_every_kind_and_says_what_it_left_out(
    start_node: NodeStarter, ros_context: Any
) -> None:
    node = start_node(
        "odometry", "--robot", "husky", "--ros-args", "-r", "__ns:=/rover1", "-p", "frame_prefix:=rover1/"
    )
    node.wait_for("odometry from motor_torques", 60.0)
    probe, got = Probe(ros_context, ()), []
    probe.node.create_subscription(Odometry, "/rover1/odom_model", got.append, 100)
    motors = probe.node.create_publisher(JointState, "/rover1/motor_torques", 10)
    probe.until(lambda: motors.get_subscription_count() == 1 and probe.node.count_publishers("/rover1/odom_model") == 1,
                "the node's topics", 30.0)  # fmt: skip

    def send(t: float, position: list[float], velocity: list[float], names: tuple[str, ...] = ()) -> None:
        message = JointState(name=list(names or ("front_left", "front_right")))
        message.header.stamp.sec, message.header.stamp.nanosec = int(t), int((t % 1.0) * 1e9)
        message.position, message.velocity = position, velocity
        motors.publish(message)
        time.sleep(0.004)

    nan = math.nan
    for k in range(100):
        t = 100.0 + 0.02 * k
        send(t, [0.1 * k, 0.1 * k], [5.0, 5.0])
        if k == 40:
            for position, velocity in (([nan, nan], [nan, nan]), ([], []), ([math.inf], [1e300]), ([9e9, -9e9], [])):
                send(t + 0.001, position, velocity)
            send(t + 0.002, [1.0], [1.0], ("somebody",))
            send(t - 0.5, [0.0, 0.0], [0.0, 0.0])
    probe.until(lambda: len(got) > 90, "odom_model", 20.0)
    time.sleep(0.3)
    probe.until(lambda: True, "the rest", 1.0)
    last = got[-1]
    assert last.header.frame_id == "rover1/odom"
    assert np.isfinite([*last.pose.covariance, *last.twist.covariance, last.pose.pose.position.x]).all()
    assert last.pose.pose.position.x == pytest.approx(9.9 * 0.1651, rel=0.1)
    assert abs(yaw_of(last)) < 0.02
    assert "sample without a number" in node.output
    assert node.stop() == 0


@pytest.mark.parametrize(("name", "found"), [("travel_slip", 0.863), ("turn_slip", 2.16), ("side_slip", 1.29)])
def test_it_takes_what_the_command_finds_on_bad_ground(name: str, found: float) -> None:
    """On wet grass with wheels that are told once a second."""
    from artibot_sim.nodes.odometry.node import SPECS

    (spec,) = [spec for spec in SPECS if spec.name == f"odometry.{name}"]
    assert spec.check(found) == found


def test_what_cannot_be_used_is_refused_in_one_line(start_node: NodeStarter) -> None:
    for words, said in (
        (("--robot", "nobody"), "nobody"),
        (("--window", "3"), "needs a recording"),
        (("--ros-args", "-p", "longest_gap:=-1.0"), "longest_gap"),
    ):
        node = start_node("odometry", *words)
        assert node.wait() == 2
        assert said in node.output
        assert "Traceback" not in node.output
