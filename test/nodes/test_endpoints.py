"""What other programs meet at the nodes' topics and parameters: quality of service, types, numbers."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from bag_helpers import small_bag
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from sim_probe import TYPES, Probe
from std_msgs.msg import String

from artibot_driver.loopback import loopback_bus
from artibot_sim.cli import main
from artibot_sim.nodes.common.qos import LATCHED
from artibot_sim.resources import config_path
from ros_helpers import spin_until

SENSORS = ("joint_states", "motor_torques", "imu/data", "total_station/point")


def test_subscribers_with_the_usual_quality_of_service_get_everything(start_node: Any, ros_context: Any) -> None:
    """A depth of 10 alone asks for reliability: what `create_subscription(…, 10)` and most viewers do."""
    start_node("sim", "--params", "sim_noisy")
    probe = Probe(ros_context, ())
    got: dict[str, list[Any]] = {topic: [] for topic in (*SENSORS, "odom", "ground_truth/odom", "motor_command")}
    for topic, messages in got.items():
        probe.node.create_subscription(TYPES[topic], topic, messages.append, 10)
    probe.until(lambda: all(got.values()), "every topic", 60.0)
    offered = [info for topic in got for info in probe.node.get_publishers_info_by_topic(f"/{topic}")]
    assert len(offered) == len(got)
    assert {info.qos_profile.reliability for info in offered} == {ReliabilityPolicy.RELIABLE}


def test_quality_of_service_is_overridden_by_parameters(start_node: Any, ros_context: Any) -> None:
    given = (
        "qos_overrides./joint_states.publisher.reliability:=best_effort",
        "qos_overrides./odom.publisher.depth:=77",
        "qos_overrides./cmd_vel.subscription.reliability:=reliable",
        "qos_overrides./nothing.publisher.depth:=3",
    )
    node = start_node("sim", "--ros-args", *(word for each in given for word in ("-p", each)))
    probe = Probe(ros_context, ("joint_states", "motor_torques"))
    probe.until(lambda: probe.got["joint_states"] and probe.got["motor_torques"], "the simulator", 60.0)

    def reliability(infos: Any) -> list[ReliabilityPolicy]:
        return [info.qos_profile.reliability for info in infos]

    assert reliability(probe.node.get_publishers_info_by_topic("/joint_states")) == [ReliabilityPolicy.BEST_EFFORT]
    assert reliability(probe.node.get_publishers_info_by_topic("/motor_torques")) == [ReliabilityPolicy.RELIABLE]
    assert reliability(probe.node.get_subscriptions_info_by_topic("/cmd_vel")) == [ReliabilityPolicy.RELIABLE]
    names = ["qos_overrides./odom.publisher.depth", "qos_overrides./motor_torques.publisher.depth"]
    found = probe.call(GetParameters, "sim/get_parameters", GetParameters.Request(names=names)).values
    assert [value.integer_value for value in found] == [77, 10], "one topic's override is no other's"
    assert "qos_overrides./nothing.publisher.depth is unknown" in node.wait_for("unknown and ignored")
    assert node.output.count("unknown and ignored") == 1


def test_a_replay_and_a_recorder_heed_overrides_and_name_those_of_other_topics(
    start_node: Any, ros_context: Any, tmp_path: Path
) -> None:
    bag = small_bag(tmp_path / "run", 400)
    node = Node("probe", context=ros_context)
    other = ("-p", "qos_overrides./nothing.publisher.depth:=3")
    given = ("-p", "qos_overrides./motor_torques.publisher.reliability:=best_effort", *other)
    played = start_node("replay", bag, "--loop", "--wait", 0, "--ros-args", *given)
    given = ("-p", "qos_overrides./motor_torques.subscription.reliability:=best_effort", *other)
    taken = start_node("record", "-o", tmp_path / "again", "--ros-args", *given)
    spin_until(node, lambda: all((publishers(node), subscriptions(node))), 60.0, "replay and recorder")
    assert publishers(node) == subscriptions(node) == [ReliabilityPolicy.BEST_EFFORT]
    for each in (taken, played):
        assert each.stop() == 0, each.output
        assert each.output.count("unknown and ignored") == 1
        assert "qos_overrides./nothing.publisher.depth is unknown and ignored" in each.output


def publishers(node: Any) -> list[ReliabilityPolicy]:
    return [info.qos_profile.reliability for info in node.get_publishers_info_by_topic("/motor_torques")]


def subscriptions(node: Any) -> list[ReliabilityPolicy]:
    return [info.qos_profile.reliability for info in node.get_subscriptions_info_by_topic("/motor_torques")]


@pytest.mark.parametrize(
    "given", ["qos_overrides./odom.publisher.reliability:=perhaps", "qos_overrides./odom.publisher.depth:=many"]
)
def test_an_override_that_is_none_is_refused_in_one_line(start_node: Any, given: str) -> None:
    node = start_node("sim", "--ros-args", "-p", given)
    assert node.wait(60) == 2
    assert "qos_overrides of odom" in node.output and "expected history" in node.output
    assert "Traceback" not in node.output


@pytest.mark.parametrize("stamped", [True, False])
def test_a_command_of_the_other_type_is_named_once_with_the_mend(
    start_node: Any, ros_context: Any, stamped: bool
) -> None:
    node = start_node("sim", "--ros-args", "-p", f"cmd_vel_stamped:={str(stamped).lower()}")
    probe = Probe(ros_context)
    probe.until(lambda: probe.got["ground_truth/odom"], "the simulator", 60.0)
    if stamped:
        probe.node.destroy_publisher(probe.twist)
        probe.repeat(lambda: probe.send_plain_twist(0.3, 0.0), 3.0)
    else:
        probe.repeat(lambda: probe.send_twist(0.3, 0.0), 3.0)
    sent, taken = ("Twist", "TwistStamped") if stamped else ("TwistStamped", "Twist")
    said = f"/cmd_vel comes from /probe as geometry_msgs/msg/{sent} and is not taken: publish geometry_msgs/msg/{taken}"
    assert said in node.wait_for("is not taken")
    assert f"cmd_vel_stamped of sim to {str(not stamped).lower()}" in node.output
    assert node.output.count("is not taken") == 1
    assert abs(probe.last().twist.twist.linear.x) < 1e-3


def integer(name: str, value: int) -> Parameter:
    return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value))


def test_an_integer_sets_a_number_and_leaves_its_type(start_node: Any, ros_context: Any) -> None:
    """What `ros2 param set /sim kappa 1` sends."""
    node = start_node(
        "sim", "--kappa", 0.8, "--ros-args", "-p", "publish_rate:=50", "-p", "total_station.prism:=[0, 0, 1]"
    )
    probe = Probe(ros_context)
    probe.until(lambda: probe.got["ground_truth/odom"], "the simulator", 60.0)
    request = SetParameters.Request(parameters=[integer("kappa", 1), integer("seed", 3), integer("kappa", 2)])
    kappa, seed, beyond = probe.call(SetParameters, "sim/set_parameters", request).results
    assert kappa.successful, kappa.reason
    assert not seed.successful and "read-only" in seed.reason
    assert not beyond.successful
    names = ["kappa", "publish_rate", "total_station.prism", "seed"]
    found = probe.call(GetParameters, "sim/get_parameters", GetParameters.Request(names=names)).values
    double, doubles = ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_DOUBLE_ARRAY
    assert [value.type for value in found] == [double, double, doubles, ParameterType.PARAMETER_INTEGER]
    assert (found[0].double_value, found[1].double_value, list(found[2].double_array_value)) == (1.0, 50.0, [0, 0, 1])
    assert node.running


def test_a_driver_that_starts_after_a_planner_finds_no_fault_with_its_stamps(start_node: Any, ros_context: Any) -> None:
    probe = Probe(ros_context, ())

    def planned() -> None:
        message = Odometry()
        message.header.stamp = probe.node.get_clock().now().to_msg()
        probe.planned.publish(message)

    with loopback_bus() as channel:
        driver = start_node("driver", "--channel", channel)
        deadline = time.monotonic() + 60.0
        while "driver on" not in driver.output and time.monotonic() < deadline:
            probe.repeat(planned, 0.1)
        probe.repeat(planned, 1.5)
        assert probe.planned.get_subscription_count() == 1
        assert "from now" not in driver.output
        assert driver.stop() == 0


def test_the_driver_s_measurements_reach_reliable_subscribers(start_node: Any, ros_context: Any) -> None:
    probe = Probe(ros_context, ())
    with loopback_bus() as channel:
        driver = start_node("driver", "--channel", channel)
        driver.wait_for("driver on", 60.0)
        topics = ("/joint_states", "/motor_torques", "/motor_command", "/odom", "/diagnostics")
        probe.until(lambda: all(map(probe.node.count_publishers, topics)), "the driver's topics", 20.0)
        for topic in topics:
            (info,) = probe.node.get_publishers_info_by_topic(topic)
            assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE, topic


def test_filters_find_frames_and_covariances_that_they_can_use(start_node: Any, ros_context: Any) -> None:
    """robot_localization takes zeros for absolute trust; a prefix keeps two rovers' frames apart."""
    start_node("sim", "--params", "sim_noisy", "--ros-args", "-p", "frame_prefix:=rover1/", "-p", "map_frame:=field")
    probe = Probe(ros_context, ("odom", "ground_truth/odom", "imu/data", "total_station/point"))
    probe.ready()
    probe.repeat(lambda: probe.send_request([60.0, 40.0]), 1.0)
    first, last, imu = probe.got["odom"][0], probe.last("odom"), probe.last("imu/data")
    assert (last.header.frame_id, last.child_frame_id, imu.header.frame_id) == (
        "rover1/odom", "rover1/base_link", "rover1/base_link",
    )  # fmt: skip
    assert (probe.last().header.frame_id, probe.last().child_frame_id) == ("field", "rover1/base_link")
    assert probe.last("total_station/point").header.frame_id == "field"
    before, after = (np.array(m.pose.covariance).reshape(6, 6) for m in (first, last))
    for covariance in (before, after, np.array(last.twist.covariance).reshape(6, 6)):
        assert np.linalg.eigvalsh(covariance).min() > 0
        assert (np.diag(covariance)[2:5] >= 1e6).all(), "height, roll and pitch are not measured"
    assert (np.diag(after)[[0, 1, 5]] > 4 * np.diag(before)[[0, 1, 5]]).all()
    rate, acceleration = (np.array(c).reshape(3, 3) for c in (imu.angular_velocity_covariance,
                                                              imu.linear_acceleration_covariance))  # fmt: skip
    names = ["imu.gyro_noise", "imu.gyro_bias", "imu.acceleration_noise"]
    found = probe.call(GetParameters, "sim/get_parameters", GetParameters.Request(names=names)).values
    noise, bias, shake = (value.double_value for value in found)
    assert noise > 0 and shake > 0
    assert rate[2, 2] == pytest.approx(noise**2 + bias**2)
    assert np.diag(acceleration) == pytest.approx([shake**2] * 3)
    assert imu.orientation_covariance[0] == -1.0


@pytest.mark.parametrize("word", ["sim", "driver"])
def test_who_publishes_odom_publishes_the_robot_s_description_for_late_subscribers(
    start_node: Any, ros_context: Any, word: str
) -> None:
    with loopback_bus() as channel:
        node = start_node(word, "--robot", "agriq", *(("--channel", channel) if word == "driver" else ()))
        node.wait_for("driver on" if word == "driver" else "is ready", 60.0)
        probe, got = Probe(ros_context, ()), []
        probe.node.create_subscription(String, "robot_description", got.append, LATCHED)
        probe.until(lambda: bool(got), "the description", 30.0)
        (found,) = got
        assert found.data == config_path("urdf", "agriq").read_text(encoding="utf-8")
        assert node.stop() == 0


def test_the_urdf_command_prints_or_writes_what_is_published(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["urdf", "husky"]) == 0
    expected = config_path("urdf", "husky").read_text(encoding="utf-8")
    assert capfd.readouterr().out == expected
    assert main(["urdf", str(config_path("robots", "husky")), "--out", str(tmp_path / "h.urdf")]) == 0
    assert (tmp_path / "h.urdf").read_text(encoding="utf-8") == expected
    assert main(["urdf", "nobody"]) == 2
    assert "expected one of" in capfd.readouterr().err
    assert main(["urdf", "husky", "--out", str(tmp_path / "no" / "h.urdf")]) == 2
    assert "make it first" in capfd.readouterr().err
