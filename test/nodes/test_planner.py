"""The planner as a real process, seen through its topics."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from click.testing import CliRunner

from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot
from artibot_sim.nodes.common.process import split_ros_args
from artibot_sim.nodes.planner.command import command
from artibot_sim.parameters import Spec
from artibot_sim.planning import load_manoeuvre, manoeuvre_names, plan
from ros_helpers import NodeStarter, spin_until

if TYPE_CHECKING:
    from rclpy.context import Context

SHORT = """
a_max_m_s2: 1.0
segments:
  - straight: {length_m: 0.4, speed_m_s: 0.4, end_speed_m_s: 0.0}
  - arc: {radius_m: 0.5, angle_deg: -45.0, speed_m_s: 0.4, end_speed_m_s: 0.0}
"""


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """A manoeuvre of three seconds."""
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


class Listener:
    """What a simulator hears of a planner, and optionally a /clock for it; one that follows says what motors do."""

    def __init__(
        self, context: Context, namespace: str = "", profile: bool = True, clock: bool = False, follows: bool = True
    ) -> None:
        from nav_msgs.msg import Odometry, Path
        from rclpy.node import Node
        from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

        self.node = Node("listener", context=context, namespace=namespace)
        if follows:
            self.node.create_publisher(JointState, "motors_under_any_name", 10)
        self.profiles: list[Any] = []
        self.paths: list[Any] = []
        self.odoms: list[Any] = []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Path, "planned/path", self.paths.append, latched)
        self.node.create_subscription(Odometry, "planned/odom", self.odoms.append, qos_profile_sensor_data)
        if profile:
            self.listen_to_profile(JointTrajectory, latched)
        self.now_ns = 0
        if clock:
            self._clock = self.node.create_publisher(Clock, "/clock", 10)
            self._timer = self.node.create_timer(0.002, self._tick)

    def listen_to_profile(self, kind: Any, qos: Any) -> None:
        self.node.create_subscription(kind, "planned/front_velocity", self.profiles.append, qos)

    def _tick(self) -> None:
        """Ten milliseconds of simulated time every two of real time."""
        from rosgraph_msgs.msg import Clock

        self.now_ns += 10_000_000
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(self.now_ns, 1_000_000_000)
        self._clock.publish(message)


def seconds(stamp: Any) -> float:
    return stamp.sec + stamp.nanosec * 1e-9


def test_profile_path_and_odometry_are_those_of_the_plan(
    start_node: NodeStarter, ros_context: Context, short: Path
) -> None:
    listener = Listener(ros_context)
    node = start_node("planner", short, "--start", 1.0, 2.0, 0.5, "--tail", 0.2)
    spin_until(listener.node, lambda: not node.running, what="the planner's end")
    assert node.wait() == 0
    p = plan(load_manoeuvre(short), load_robot("agriq"), start=(1.0, 2.0, 0.5))

    (profile,) = listener.profiles
    assert profile.joint_names == ["front_right", "front_left"]
    start = seconds(profile.header.stamp)
    np.testing.assert_array_equal([list(point.velocities) for point in profile.points], p.velocity)
    np.testing.assert_array_equal([list(point.positions) for point in profile.points], p.position)
    times = [seconds(point.time_from_start) for point in profile.points]
    np.testing.assert_allclose(times, p.t, atol=1e-9)

    (path,) = listener.paths
    assert path.header.frame_id == "map"
    at = np.array([seconds(pose.header.stamp) for pose in path.poses]) - start
    expected = p.at(at).pose
    got = [(pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.z) for pose in path.poses]
    np.testing.assert_allclose(got, np.column_stack([expected[:, :2], np.sin(expected[:, 2] / 2)]), atol=1e-6)
    assert at[-1] == pytest.approx(p.duration, abs=1e-6)

    t = np.array([seconds(odom.header.stamp) for odom in listener.odoms]) - start
    assert t[0] < 0  # a sign of life before the start, and one after the end
    assert t[-1] > p.duration
    assert np.all(np.diff(t) > 0)
    planned = p.at(t)
    got = [(o.pose.pose.position.x, o.twist.twist.linear.x, o.twist.twist.angular.z) for o in listener.odoms]
    np.testing.assert_allclose(got, np.column_stack([planned.pose[:, 0], planned.twist]), atol=1e-5)
    assert {(odom.header.frame_id, odom.child_frame_id) for odom in listener.odoms} == {("map", "base_link")}
    assert np.median(np.diff(t)) <= 1 / 20


def test_a_late_subscriber_gets_path_and_profile_while_it_stays(
    start_node: NodeStarter, ros_context: Context, short: Path
) -> None:
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    node = start_node("planner", short, "--subscriber-timeout", 0, "--keep", "--start-delay", 0.1)
    node.wait_for("staying for late subscribers")
    listener = Listener(ros_context)
    spin_until(listener.node, lambda: bool(listener.profiles and listener.paths), what="profile and path")
    for topic in ("/planned/path", "/planned/front_velocity"):
        (info,) = listener.node.get_publishers_info_by_topic(topic)
        assert info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert node.stop() == 0


def test_with_simulated_time_it_follows_the_clock(start_node: NodeStarter, ros_context: Context, short: Path) -> None:
    listener = Listener(ros_context, clock=True)
    node = start_node("planner", "--manoeuvre", short, "--use-sim-time", "--start-delay", 2.0)
    spin_until(listener.node, lambda: not node.running, what="the planner's end")
    assert node.wait() == 0
    p = plan(load_manoeuvre(short), load_robot("agriq"))
    start = seconds(listener.profiles[0].header.stamp)
    assert start <= listener.now_ns * 1e-9 - p.duration - 0.5  # profile and tail lie between start and now
    t = np.array([seconds(odom.header.stamp) for odom in listener.odoms]) - start
    during = (t > 0) & (t < p.duration)
    assert np.median(np.diff(t[during])) <= 1 / 20  # of simulated time, five times as fast as real time
    got = [odom.pose.pose.position.x for odom in listener.odoms]
    np.testing.assert_allclose(got, p.at(t).pose[:, 0], atol=1e-6)


def test_it_gives_up_when_the_clock_is_gone(start_node: NodeStarter, ros_context: Context, short: Path) -> None:
    listener = Listener(ros_context, clock=True)
    node = start_node("planner", short, "--use-sim-time")
    spin_until(listener.node, lambda: bool(listener.profiles), what="a profile")
    listener.node.destroy_node()
    assert node.wait(30) == 1
    assert "/clock is gone" in node.output


def test_interrupted_before_the_end_it_says_so(start_node: NodeStarter, ros_context: Context, short: Path) -> None:
    listener = Listener(ros_context)
    node = start_node("planner", short, "--start-delay", 60)
    spin_until(listener.node, lambda: bool(listener.profiles), what="a profile")
    node.send(signal.SIGINT)
    assert node.wait(10) == 130
    assert "ended by a signal before the profile was over" in node.output


def test_namespace_and_parameters_reach_it_through_ros_args(
    start_node: NodeStarter, ros_context: Context, short: Path
) -> None:
    from rcl_interfaces.srv import DescribeParameters, SetParameters
    from rclpy.parameter import Parameter

    listener = Listener(ros_context, namespace="/rover1")
    ros = ("--ros-args", "-r", "__ns:=/rover1", "-p", f"manoeuvre:={short}", "-p", "keep:=true", "-p", "rate:=40")
    node = start_node("planner", "--start-delay", 60, *ros)
    spin_until(listener.node, lambda: bool(listener.profiles), what="a profile")
    asked = ["rate", "manoeuvre", "keep", "start.yaw"]
    describe = listener.node.create_client(DescribeParameters, "/rover1/planner/describe_parameters")
    assert describe.wait_for_service(10)
    answer = describe.call_async(DescribeParameters.Request(names=asked))
    spin_until(listener.node, answer.done, what="an answer")
    for descriptor in answer.result().descriptors:
        assert descriptor.read_only
        assert descriptor.description
    rate = answer.result().descriptors[0].floating_point_range[0]
    assert (rate.from_value, rate.to_value) == (20.0, 1000.0)
    change = listener.node.create_client(SetParameters, "/rover1/planner/set_parameters")
    request = SetParameters.Request(parameters=[Parameter("rate", value=60.0).to_parameter_msg()])
    refused = change.call_async(request)
    spin_until(listener.node, refused.done, what="an answer")
    assert not refused.result().results[0].successful
    assert node.stop() == 130


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--subscriber-timeout", "0.2"], "/planned/front_velocity: nobody listened within 0.2 s"),
        (["--use-sim-time", "--ros-args", "-p", "clock_timeout:=0.2"], "/clock: nothing came within 0.2 s"),
        (["--rate", "5"], "parameter rate: found 5.0, expected a number, at least 20, at most 1000\n"),
        (["--ros-args", "-p", "tail:=.nan"], "parameter tail: found nan, expected a number, at least 0"),
        (["--ros-args", "-p", "keep:=3"], "parameter keep: found 3, expected true or false"),
        (["--ros-args", "--rate", "5"], "--ros-args: unknown: ['--rate', '5']; expected"),
        (["--ros-args", "-r", "one"], "--ros-args: Couldn't parse remap rule: '-r one'"),
        (["--ros-args", "--params-file", "nowhere.yaml"], "--ros-args: Couldn't parse params file"),
        (["--ros-args", "-p", "dt:=fast"], "parameter dt: found 'fast', expected a number, at least 0.001"),
        (["table6_agri"], "manoeuvre 'table6_agri': unknown, did you mean 'table6_agriq'"),
        (["--robot", "agric"], "robot 'agric': unknown"),
    ],
)
def test_what_it_cannot_use_gets_one_line_and_status_2(start_node: NodeStarter, args: list[str], message: str) -> None:
    node = start_node("planner", *args)
    assert node.wait(30) == 2
    assert message in node.output
    assert "Traceback" not in node.output


def test_a_recorder_alone_does_not_start_it(start_node: NodeStarter, ros_context: Context, short: Path) -> None:
    listener = Listener(ros_context, follows=False)
    node = start_node("planner", short, "--subscriber-timeout", 2.0)
    spin_until(listener.node, lambda: not node.running, what="the planner's end")
    assert node.wait() == 2
    assert "planned/front_velocity: nobody but listener listened within 2 s" in node.output
    assert not listener.profiles
    node = start_node("planner", short, "--wait-for", "anyone")
    spin_until(listener.node, lambda: bool(listener.profiles), what="the profile")
    assert node.stop() == 130


def test_who_waits_says_for_what_and_can_be_asked_to_end(start_node: NodeStarter, short: Path) -> None:
    node = start_node("planner", short)
    node.wait_for("waiting for a simulator or driver that listens to /planned/front_velocity, 120 s at most")
    assert node.stop() == 130
    assert "listened within" not in node.output


def test_a_misspelt_parameter_is_said(start_node: NodeStarter) -> None:
    node = start_node("planner", "--ros-args", "-p", "start_dely:=2.0")
    node.wait_for("parameter start_dely is unknown and ignored; did you mean start_delay?")
    assert node.running


def test_the_list_names_every_shipped_manoeuvre() -> None:
    result = CliRunner().invoke(command, ["--list"])
    assert result.exit_code == 0
    assert [line.split()[0] for line in result.output.splitlines() if line[0] != " "] == list(manoeuvre_names())


def test_a_manoeuvre_given_twice_is_refused() -> None:
    result = CliRunner().invoke(command, ["eight", "--manoeuvre", "slalom"])
    assert result.exit_code == 2
    assert "stands twice" in result.output


@pytest.mark.parametrize(
    ("argv", "own", "ros"),
    [
        (["eight", "--keep"], ["eight", "--keep"], []),
        (["a", "--ros-args", "-p", "x:=1"], ["a"], ["--ros-args", "-p", "x:=1"]),
        (["--ros-args", "-p", "x:=1", "--", "b"], ["b"], ["--ros-args", "-p", "x:=1", "--"]),
    ],
)
def test_ros_arguments_are_told_apart(argv: list[str], own: list[str], ros: list[str]) -> None:
    assert split_ros_args(argv) == (own, ros)


@pytest.mark.parametrize(
    ("spec", "good", "bad"),
    [
        (Spec("a", 1.0, "", low=0.0, high=2.0), [0, 2.0, 1], [-0.1, 2.1, float("nan"), True, "1", None]),
        (Spec("b", 1.0, "", above=0.0, high=1.0), [1.0, 1e-9], [0.0, 1.1]),
        (Spec("c", 3, "", low=0, high=9), [0, 9], [1.0, 10, False]),
        (Spec("d", "x", "", choices=("x", "y")), ["y"], ["z", 1]),
        (Spec("e", False, ""), [True], [1, "true"]),
        (Spec("f", (0.0, 0.0), "", low=-1.0, high=1.0), [[1, -1.0], (0.5, 0.5)], [[1.0], [2.0, 0.0], 1.0, "ab"]),
    ],
)
def test_a_parameter_table_takes_what_it_says(spec: Spec, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        checked = spec.check(value)
        assert type(checked) is type(spec.default)
        assert checked == (tuple(value) if isinstance(value, list) else value)
    for value in bad:
        with pytest.raises(ArtibotError, match=f"parameter {spec.name}: found .*, expected"):
            spec.check(value)
