"""`artibot record` with real processes: what is published is what is recorded, whatever ends the node."""

from __future__ import annotations

import os
import random
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from bag_helpers import mcap_file
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from artibot_sim.experiment import bag_info, iter_messages, read_bag, recover
from artibot_sim.experiment.topics import parse_qos
from ros_helpers import NodeProcess, NodeStarter

if TYPE_CHECKING:
    from rclpy.context import Context

pytest.importorskip("rclpy", reason="needs ROS 2")


class Publishers:
    """Publishes in this process: topics by name, paced, counting what it sent."""

    def __init__(self, context: Context) -> None:
        from rclpy.node import Node

        self.node = Node("probe", context=context)
        self.sent: dict[str, int] = {}
        self.last_ns = 0
        self._by_topic: dict[str, tuple[Any, type]] = {}

    def add(self, topic: str, message: type, reliable: bool = True, latched: bool = False) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        qos = QoSProfile(
            depth=500,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self._by_topic[topic] = (self.node.create_publisher(message, topic, qos), message)
        self.sent[topic] = 0

    def publish(self, topic: str) -> None:
        publisher, kind = self._by_topic[topic]
        message = kind()
        now = time.time_ns()
        if hasattr(message, "header"):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        if hasattr(message, "name"):
            message.name, message.velocity = ["front_right"], [float(self.sent[topic])]
        publisher.publish(message)
        self.sent[topic] += 1
        self.last_ns = now

    def round(self, count: int, rate: float = 100.0) -> None:
        """Publish `count` messages on every topic at `rate` Hz."""
        begin = time.monotonic()
        for i in range(count):
            for topic in self._by_topic:
                self.publish(topic)
            time.sleep(max(0.0, begin + (i + 1) / rate - time.monotonic()))

    @contextmanager
    def running(self, rate: float = 100.0) -> Iterator[None]:
        """Publish from a thread."""
        stop = threading.Event()

        def work() -> None:
            while not stop.is_set():
                self.round(1, rate)

        thread = threading.Thread(target=work)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def wait_for_subscribers(self, timeout: float = 20.0) -> None:
        """Wait until every topic has one: only then nothing that is published is missed."""
        deadline = time.monotonic() + timeout
        while any(publisher.get_subscription_count() == 0 for publisher, _ in self._by_topic.values()):
            assert time.monotonic() < deadline, "the recorder did not subscribe"
            time.sleep(0.02)


@pytest.fixture
def publishers(ros_context: Context) -> Publishers:
    return Publishers(ros_context)


def joint_state() -> type:
    from sensor_msgs.msg import JointState

    return JointState


def test_what_is_published_is_recorded(publishers: Publishers, start_node: NodeStarter, tmp_path: Path) -> None:
    from nav_msgs.msg import Odometry
    from nav_msgs.msg import Path as PlannedPath
    from sensor_msgs.msg import Imu

    publishers.add("/planned/path", PlannedPath, latched=True)
    publishers.publish("/planned/path")  # before the recorder is there
    node = start_node(
        "record",
        "-o",
        tmp_path / "run",
        "--robot",
        "agriq",
        "--kappa",
        "0.8",
        "--metadata",
        "tyres=new",
        "-x",
        "/clock",
    )
    publishers.add("/motor_torques", joint_state())
    publishers.add("/odom", Odometry)
    publishers.add("/imu/data", Imu, reliable=False)
    publishers.add("/not_ours", joint_state())
    node.wait_for("recording /imu/data")
    node.wait_for("recording /planned/path")
    for topic in ("/motor_torques", "/odom", "/imu/data", "/planned/path"):
        node.wait_for(f"recording {topic} ")
    time.sleep(0.5)
    for _ in range(200):
        for topic in ("/motor_torques", "/odom", "/imu/data", "/not_ours"):
            publishers.publish(topic)
        time.sleep(0.002)
    time.sleep(0.5)
    node.send(signal.SIGINT)
    assert node.wait(20) == 0

    info = bag_info(tmp_path / "run")
    counts = {c.topic: c.message_count for c in info.channels}
    assert counts == {"/motor_torques": 200, "/odom": 200, "/imu/data": 200, "/planned/path": 1}
    assert {k: info.metadata[k] for k in ("robot", "kappa", "tyres")} == {
        "robot": "agriq",
        "kappa": "0.8",
        "tyres": "new",
    }
    qos = {c.topic: parse_qos(c.qos) for c in info.channels}
    assert qos["/imu/data"].reliability == "best_effort"
    assert (qos["/odom"].reliability, qos["/odom"].durability) == ("reliable", "volatile")
    assert qos["/planned/path"].durability == "transient_local"
    with Reader(tmp_path / "run") as bag:
        assert sum(1 for _ in bag.messages()) == 601
    experiment = read_bag(tmp_path / "run")
    motors = experiment.channels["motor_torques"]
    assert motors["front_right.velocity"].tolist() == [float(i) for i in range(200)]
    delay = motors.received_ns - motors.t_ns
    assert (delay > 0).all()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly(
    publishers: Publishers, start_node: NodeStarter, tmp_path: Path, number: signal.Signals
) -> None:
    publishers.add("/motor_torques", joint_state())
    node = start_node("record", "-o", tmp_path / "run")
    publishers.wait_for_subscribers()
    with publishers.running():
        time.sleep(1.0)
        node.send(number)
        assert node.wait(20) == 0
    with open(mcap_file(tmp_path / "run"), "rb") as stream:
        statistics = make_reader(stream).get_summary().statistics
    assert statistics.message_count > 50
    assert recover(tmp_path / "run").complete


def test_topics_by_pattern_and_duration(publishers: Publishers, start_node: NodeStarter, tmp_path: Path) -> None:
    for topic in ("/a/one", "/a/two", "/b/one", "/b/two"):
        publishers.add(topic, joint_state())
    node = start_node(
        "record", "-o", tmp_path / "run", "-t", "/a/*,b/one", "-x", "/a/two", "--duration", "4", "--compression", "none"
    )
    with publishers.running():
        assert node.wait(30) == 0
    assert {c.topic for c in bag_info(tmp_path / "run").channels} == {"/a/one", "/b/one"}


def test_relative_names_are_resolved_in_the_node_s_namespace_and_global_ones_stay(
    publishers: Publishers, start_node: NodeStarter, tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import String

    publishers.add("/rover1/odom", joint_state())
    publishers.add("/odom", joint_state())
    publishers.add("/clock", Clock)
    publishers.add("/diagnostics", DiagnosticArray)
    publishers.add("/rover1/robot_description", String, latched=True)
    node = start_node("record", "-o", tmp_path / "run", "--duration", "3", "--ros-args", "-r", "__ns:=/rover1")
    with publishers.running():
        assert node.wait(30) == 0
    found = {c.topic: c.message_count for c in bag_info(tmp_path / "run").channels}
    assert set(found) == {"/rover1/odom", "/clock", "/diagnostics", "/rover1/robot_description"}
    assert all(found.values())


def test_what_was_asked_for_and_never_came_is_said(
    publishers: Publishers, start_node: NodeStarter, tmp_path: Path
) -> None:
    """A misspelt name, one that a namespace moved, and a pattern of nothing; relative patterns are found there, too."""
    publishers.add("/rover1/odom", joint_state())
    publishers.add("/rover1/planned/odom", joint_state())
    topics = "odom,planned/*,clock,/clok,arm/*"
    node = start_node(
        "record", "-o", tmp_path / "run", "--duration", "3", "-t", topics, "--ros-args", "-r", "__ns:=/rover1"
    )
    with publishers.running():
        assert node.wait(30) == 0
    assert {c.topic for c in bag_info(tmp_path / "run").channels} == {"/rover1/odom", "/rover1/planned/odom"}
    assert "no message came on /rover1/clock, /clok, /rover1/arm/*: are" in node.output


def test_a_publisher_that_offers_less_joins(publishers: Publishers, start_node: NodeStarter, tmp_path: Path) -> None:
    publishers.add("/motor_torques", joint_state(), reliable=True)
    node = start_node("record", "-o", tmp_path / "run")
    node.wait_for("recording /motor_torques [sensor_msgs/msg/JointState], reliable")
    publishers.add("/motor_torques", joint_state(), reliable=False)
    node.wait_for("recording /motor_torques [sensor_msgs/msg/JointState], best effort")
    time.sleep(0.5)
    publishers.round(50)
    time.sleep(0.3)
    assert node.stop() == 0
    assert bag_info(tmp_path / "run").message_count == 50


def test_latched_messages_are_recorded_once_whoever_joins(
    publishers: Publishers, start_node: NodeStarter, tmp_path: Path
) -> None:
    from nav_msgs.msg import Path as PlannedPath

    publishers.add("/planned/path", PlannedPath, latched=True)
    for _ in range(3):
        publishers.publish("/planned/path")
    node = start_node("record", "-o", tmp_path / "run")
    node.wait_for("recording /planned/path [nav_msgs/msg/Path], reliable, latched")
    time.sleep(0.5)
    publishers.add("/planned/path", PlannedPath, reliable=False, latched=True)
    node.wait_for("recording /planned/path [nav_msgs/msg/Path], best effort\n")
    time.sleep(0.5)
    publishers.round(2)
    time.sleep(0.3)
    assert node.stop() == 0
    assert bag_info(tmp_path / "run").message_count == 5
    assert "5 messages of 1 topics" in node.output


def test_who_subscribes_with_another_type_does_not_keep_a_topic_from_being_recorded(
    publishers: Publishers, start_node: NodeStarter, tmp_path: Path
) -> None:
    """A plain Twist beside a node that takes TwistStamped: what is published is one type."""
    from geometry_msgs.msg import Twist

    driven = start_node("sim")
    driven.wait_for("is ready")
    recorder = start_node("record", "-o", tmp_path / "run")
    recorder.wait_for("recording /joint_states")
    publishers.add("/cmd_vel", Twist)
    recorder.wait_for("recording /cmd_vel [geometry_msgs/msg/Twist]")
    assert recorder.stop() == 0
    assert "several types" not in recorder.output


def test_nothing_is_overwritten(start_node: NodeStarter, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine").write_text("keep")
    node = start_node("record", "-o", tmp_path / "run")
    assert node.wait(20) == 2
    assert "exists already" in node.output
    assert node.output.count("\n") == 1
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["mine"]


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--metadata", "tyres"], "KEY=VALUE"),
        (["--kappa", "1.5"], "kappa"),
        (["--kappa", "nan"], "not a finite number"),
        (["--all", "-t", "/odom"], "one of the two"),
    ],
)
def test_bad_options_are_refused(start_node: NodeStarter, tmp_path: Path, args: list[str], said: str) -> None:
    node = start_node("record", "-o", tmp_path / "run", *args)
    assert node.wait(20) == 2
    assert said in node.output
    assert not (tmp_path / "run").exists()


def test_a_full_disk_ends_it_with_one_clear_line(
    publishers: Publishers, start_node: NodeStarter, tmp_path: Path
) -> None:
    from nav_msgs.msg import Odometry

    for i in range(4):
        publishers.add(f"/odom{i}", Odometry)
    # bash counts in KiB; a file that may not grow is a full disk that needs no root
    command = (
        f"ulimit -f 300; exec {sys.executable} -m artibot_sim.cli record -o {tmp_path / 'run'} --all --compression none"
    )
    node = start_node.run(["bash", "-c", command], "record")
    publishers.wait_for_subscribers()
    with publishers.running(30.0):  # slow enough for several chunks before the end, on a machine that stalls too
        status = node.wait(60)
    assert status == 2
    assert "writing failed: File too large" in node.output
    assert "are kept" in node.output
    report = recover(tmp_path / "run")
    assert report.messages > 100
    assert f"the {report.messages} messages" in node.output


def kill_during_recording(
    publishers: Publishers, start_node: NodeStarter, folder: Path, after: float
) -> tuple[int, int]:
    """Record, kill the node; return the stamps of the last message published before, and of the last one saved."""
    node: NodeProcess = start_node("record", "-o", folder)
    publishers.wait_for_subscribers()
    time.sleep(0.2)
    with publishers.running():
        time.sleep(after)
        last = publishers.last_ns
        node.send(signal.SIGKILL)
        node.wait(10)
    saved = list(iter_messages(recover(folder).out))
    with Reader(folder.with_name(f"{folder.name}_recovered")) as bag:
        assert sum(1 for _ in bag.messages()) == len(saved)
    return last, max((m.publish_ns for m in saved), default=last - int(after * 1e9))


def test_a_killed_node_loses_at_most_a_second(ros_context: Context, start_node: NodeStarter, tmp_path: Path) -> None:
    seed = int(os.environ.get("ARTIBOT_KILL_SEED", time.time_ns() % 1_000_000))
    print(f"seed {seed}; ARTIBOT_KILL_SEED={seed} repeats these instants")
    rng = random.Random(seed)
    for k in range(5):
        publishers = Publishers(ros_context)
        for topic in ("/odom", "/motor_torques", "/joint_states", "/imu/data"):
            publishers.add(topic, joint_state())
        after = rng.uniform(0.3, 2.5)
        last, saved = kill_during_recording(publishers, start_node, tmp_path / f"run{k}", after)
        publishers.node.destroy_node()
        assert last - saved <= 1_000_000_000, (
            f"seed {seed}, kill {k} after {after:.3f} s: {(last - saved) / 1e9:.3f} s lost"
        )
        print(f"killed after {after:.3f} s: {(last - saved) / 1e9:.3f} s lost")


def test_definitions_from_message_classes_are_those_of_the_types() -> None:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from artibot_sim.nodes.common.message_types import definition_of, describe, import_message

    store = get_typestore(Stores.ROS2_JAZZY)
    for ros_type in (
        "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "trajectory_msgs/msg/JointTrajectory",
        "diagnostic_msgs/msg/DiagnosticArray", "sensor_msgs/msg/PointCloud2", "shape_msgs/msg/SolidPrimitive",
        "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/NavSatFix", "std_msgs/msg/Byte",
    ):  # fmt: skip
        found = get_types_from_msg(definition_of(import_message(ros_type)), ros_type)
        for name, (_, fields) in found.items():
            assert fields == store.fielddefs[name][1], name
        assert describe(ros_type, "")[1] == store.hash_rihs01(ros_type)


def test_hidden_topics_are_not_everything() -> None:
    from artibot_sim.nodes.record.recorder import RecordSelection

    same: Callable[[str], str] = lambda name: "/" + name.lstrip("/")  # noqa: E731
    everything = RecordSelection(None, ["/camera/*"], True, same)
    assert "/odom" in everything
    assert "/_hidden" not in everything
    assert "/a/_action/status" not in everything
    assert "/camera/image" not in everything
    contract = RecordSelection(None, [], False, same)
    assert "/planned/odom" in contract
    assert "/rosout" not in contract


def test_nothing_is_lost_at_thousands_of_messages_a_second(
    publishers: Publishers, start_node: NodeStarter, tmp_path: Path
) -> None:
    topics = [f"/fast{i}" for i in range(10)]
    for topic in topics:
        publishers.add(topic, joint_state())
    node = start_node("record", "-o", tmp_path / "run", "-t", "/fast*")
    publishers.wait_for_subscribers()
    time.sleep(0.3)
    begin = time.monotonic()
    publishers.round(1500, rate=500.0)
    print(f"{10 * 1500 / (time.monotonic() - begin):.0f} messages/s were published")
    time.sleep(1.0)
    assert node.stop(20) == 0
    counts = {c.topic: c.message_count for c in bag_info(tmp_path / "run").channels}
    assert counts == dict.fromkeys(topics, 1500)
    order = [m.sequence for m in iter_messages(tmp_path / "run", ["/fast3"])]
    assert order == list(range(order[0], order[0] + 1500))
