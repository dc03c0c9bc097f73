"""`artibot replay` as a process: all messages in order, byte for byte; nothing that moves a rover by accident."""

from __future__ import annotations

import json
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bag_helpers import JOINTS, joint_state, write_bag

pytest.importorskip("rclpy", reason="needs ROS 2")

from replay_probe import (
    INPUTS,
    OUTPUTS,
    START_NS,
    Listener,
    counting_bag,
    recorded,
    types_of,
)

from artibot_sim.experiment import serialize, write_channels
from artibot_sim.experiment.messages import stamp_message
from artibot_sim.nodes.common.stamps import stamp_of
from ros_helpers import NodeStarter

if TYPE_CHECKING:
    from rclpy.context import Context

CLOCK = {"/clock": "rosgraph_msgs/msg/Clock"}
TWO = {"/motor_torques": "sensor_msgs/msg/JointState", "/ground_truth/odom": "nav_msgs/msg/Odometry"}


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return counting_bag(tmp_path_factory.mktemp("bags") / "counted")


def test_all_messages_in_order_byte_for_byte_at_their_times(
    start_node: NodeStarter, ros_context: Context, counted: Path, tmp_path: Path
) -> None:
    listener = Listener(ros_context, TWO | CLOCK)
    with listener.listening():
        node = start_node("replay", counted, "--wait", 1, "--stats", tmp_path / "stats.json")
        assert node.wait() == 0
    expected = recorded(counted)
    for topic in TWO:
        assert listener.bytes_of(topic) == expected[topic]
    found = json.loads((tmp_path / "stats.json").read_text())
    assert found["messages"] == 600
    assert found["topics"] == dict.fromkeys(TWO, 300)
    assert 0 <= found["late_p50_ms"] <= found["late_p99_ms"] <= found["late_max_ms"]
    times = listener.times_of("/motor_torques")
    assert times[-1] - times[0] >= 299 * 0.005 - 0.05, "faster than recorded"
    clock = [stamp_of(data) for data in listener.bytes_of("/clock")]
    assert len(clock) > 50
    assert (np.diff(clock) > 0).all()
    assert START_NS <= clock[0] <= clock[-1] <= START_NS + 1_600_000_000


def test_who_listens_already_misses_nothing(start_node: NodeStarter, ros_context: Context, counted: Path) -> None:
    """Where nobody wants the other topics, and without --wait; where somebody does, see the next test."""
    listener = Listener(ros_context, {"/motor_torques": TWO["/motor_torques"]})
    with listener.listening():
        replay = start_node("replay", counted)
        assert replay.wait() == 0
    assert "nobody listens" not in replay.output
    assert listener.bytes_of("/motor_torques") == recorded(counted)["/motor_torques"]


COUNTING = """
import sys, rclpy
from rclpy.executors import ExternalShutdownException
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

rclpy.init()
node, got = rclpy.create_node("counting"), []
for kind, topic in ((JointState, "motor_torques"), (Odometry, "ground_truth/odom")):
    node.create_subscription(kind, topic, lambda m, topic=topic: got.append(topic), 5000)
print("listening", flush=True)
try:
    while rclpy.ok():  # rclpy.spin may miss the signal where nothing else wakes it
        rclpy.spin_once(node, timeout_sec=0.1)
except (ExternalShutdownException, KeyboardInterrupt):
    pass
print("got", got.count("motor_torques"), got.count("ground_truth/odom"), flush=True)
node.destroy_node()
"""
"""A program of somebody else's that subscribes with the default quality of service."""


@pytest.mark.parametrize("wait", [(), ("--wait", 1)], ids=["default", "given"])
def test_one_that_is_found_late_misses_nothing_though_every_topic_has_a_subscriber(
    start_node: NodeStarter, ros_context: Context, counted: Path, wait: tuple[Any, ...]
) -> None:
    """As where the answer to the replay's first announcement gets lost: the other is found seconds later."""
    listener = Listener(ros_context, TWO)
    late = start_node.run([sys.executable, "-c", COUNTING], name="late")
    late.wait_for("listening")
    with listener.listening():
        late.send(signal.SIGSTOP)
        replay = start_node("replay", counted, *wait)
        replay.wait_for("finding who listens")
        time.sleep(1.5)
        late.send(signal.SIGCONT)
        assert replay.wait() == 0
    time.sleep(0.5)
    late.send(signal.SIGINT)
    late.wait_for("got 300 300")
    assert "nobody listens" not in replay.output
    expected = recorded(counted)
    for topic in TWO:
        assert listener.bytes_of(topic) == expected[topic]


def test_as_many_as_were_asked_for_are_waited_for(start_node: NodeStarter, ros_context: Context, counted: Path) -> None:
    """The second listens only once all who were there have been found."""
    listener = Listener(ros_context, TWO)
    with listener.listening():
        replay = start_node("replay", counted, "--wait", 2)
        replay.wait_for("finding who listens")
        time.sleep(5.0)
        assert "playing" not in replay.output
        second = start_node.run([sys.executable, "-c", COUNTING], name="second")
        assert replay.wait() == 0
    time.sleep(0.5)
    second.send(signal.SIGINT)
    second.wait_for("got 300 300")
    assert [len(listener.bytes_of(topic)) for topic in TWO] == [300, 300]


def test_without_waiting_nobody_is_looked_for(start_node: NodeStarter, counted: Path) -> None:
    node = start_node("replay", counted, "--wait", 0, "--end", 0.1)
    assert node.wait() == 0
    assert "finding who listens" not in node.output and "nobody listens" not in node.output


def test_rate_start_end_topics_and_remapping(start_node: NodeStarter, ros_context: Context, counted: Path) -> None:
    names = {"/recorded/torques": TWO["/motor_torques"], "/elsewhere": TWO["/ground_truth/odom"], **TWO}
    listener = Listener(ros_context, names)
    cut = ("--start", 0.5, "--end", 1.0, "--rate", 0.5, "--wait", 1)
    with listener.listening():
        one = start_node("replay", counted, *cut, "-t", "motor_*", "--remap", "/motor_torques:=/recorded/torques")
        two = start_node("replay", counted, *cut, "-x", "motor_*", "--ros-args", "-r", "ground_truth/odom:=/elsewhere")
        assert (one.wait(), two.wait()) == (0, 0)
    expected = recorded(counted)
    assert listener.bytes_of("/recorded/torques") == expected["/motor_torques"][100:201]
    assert listener.bytes_of("/elsewhere") == expected["/ground_truth/odom"][100:201]
    assert not listener.got["/motor_torques"]
    assert not listener.got["/ground_truth/odom"]
    times = listener.times_of("/recorded/torques")
    assert times[-1] - times[0] >= 1.0 - 0.05, "half a recorded second at half speed"


def test_passes_repeat_the_bytes_while_the_clock_only_increases(
    start_node: NodeStarter, ros_context: Context, counted: Path
) -> None:
    listener = Listener(ros_context, TWO | CLOCK)
    expected = recorded(counted)["/motor_torques"][:41]
    with listener.listening():
        node = start_node("replay", counted, "--end", 0.2, "--loop", "--wait", 1, "--clock", 200)
        while len(listener.got["/motor_torques"]) < 130:
            assert node.running, node.output
            time.sleep(0.01)
        node.send(signal.SIGINT)
        assert node.wait() == 0
    got = listener.bytes_of("/motor_torques")
    assert all(data == expected[i % 41] for i, data in enumerate(got))
    clock = [stamp_of(data) for data in listener.bytes_of("/clock")]
    assert (np.diff(clock) > 0).all()
    assert clock[-1] > START_NS + 400_000_000, "the time of the third pass"


def test_restamped_passes_go_on_with_the_clock(start_node: NodeStarter, ros_context: Context, counted: Path) -> None:
    listener = Listener(ros_context, TWO)
    with listener.listening():
        node = start_node("replay", counted, "--end", 0.2, "--loop", "--wait", 1, "--restamp", "--rate", 4)
        while len(listener.got["/motor_torques"]) < 130:
            assert node.running, node.output
            time.sleep(0.01)
        node.send(signal.SIGTERM)
        assert node.wait() == 0
    got = listener.bytes_of("/motor_torques")
    stamps = np.array([stamp_of(data) for data in got])
    assert set(np.diff(stamps)) == {5_000_000, 10_000_000}, "10 ms from pass to pass"
    assert all(data[12:] == got[i % 41][12:] for i, data in enumerate(got)), "nothing but the stamp changes"


def test_a_recorded_clock_sets_the_time_of_the_replay(
    start_node: NodeStarter, ros_context: Context, tmp_path: Path
) -> None:
    messages = []
    for i in range(100):  # simulated time goes twice as fast as the wall's
        log, time_ns = START_NS + i * 10_000_000, 5_000_000_000 + i * 20_000_000
        messages.append(
            (
                "/clock",
                "rosgraph_msgs/msg/Clock",
                serialize("rosgraph_msgs/msg/Clock", clock=stamp_message(time_ns)),
                log,
            )
        )
        messages.append(("/motor_torques", JOINTS, joint_state(time_ns, ["front_right"], velocity=[float(i)]), log))
    bag = write_bag(tmp_path / "simulated", messages)
    listener = Listener(ros_context, CLOCK | {"/motor_torques": JOINTS})
    with listener.listening():
        assert start_node("replay", bag, "--wait", 1).wait() == 0
    clock = [stamp_of(data) for data in listener.bytes_of("/clock")]
    assert len(listener.got["/motor_torques"]) == 100
    assert 5_000_000_000 <= clock[0] <= 5_200_000_000
    assert 6_500_000_000 <= clock[-1] <= 7_000_000_000
    assert (np.diff(clock) > 0).all()


def test_pause_and_step(start_node: NodeStarter, ros_context: Context, counted: Path) -> None:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from std_srvs.srv import SetBool, Trigger

    listener = Listener(ros_context, TWO)
    caller = Node("caller", context=ros_context)  # spun, which would empty the listener's subscriptions
    pause = caller.create_client(SetBool, "/replay/pause")
    step = caller.create_client(Trigger, "/replay/step")
    executor = SingleThreadedExecutor(context=ros_context)
    executor.add_node(caller)

    def call(client: object, request: object) -> object:
        assert client.wait_for_service(20.0)
        future = client.call_async(request)
        executor.spin_until_future_complete(future, 20.0)
        assert future.done()
        return future.result()

    node = start_node("replay", counted, "--wait", 1, "--pause", "-t", "motor_torques")
    node.wait_for("playing")
    for _ in range(3):
        assert call(step, Trigger.Request()).success
    call(pause, SetBool.Request(data=True))
    with listener.listening():
        pass
    assert len(listener.got["/motor_torques"]) == 3
    assert call(pause, SetBool.Request(data=False)).success
    assert not call(step, Trigger.Request()).success
    with listener.listening():
        assert node.wait() == 0
    assert listener.bytes_of("/motor_torques") == recorded(counted)["/motor_torques"]


def test_latched_topics_keep_their_quality_and_come_before_a_late_start(
    start_node: NodeStarter, ros_context: Context, rover: Path
) -> None:
    listener = Listener(ros_context, {"/planned/path": "nav_msgs/msg/Path", "/odom": "nav_msgs/msg/Odometry"})
    with listener.listening():
        node = start_node("replay", rover, "--start", 1.0, "--end", 1.5, "--wait", 1, "-t", "/planned/path,/odom")
        node.wait_for("playing")
        infos = {t: listener.node.get_publishers_info_by_topic(t)[0].qos_profile for t in ("/planned/path", "/odom")}
        assert node.wait() == 0
    assert infos["/planned/path"].durability.name == "TRANSIENT_LOCAL"
    assert infos["/odom"].durability.name == "VOLATILE"
    assert listener.bytes_of("/planned/path") == recorded(rover)["/planned/path"]


def test_nothing_that_moves_a_rover_is_published_without_drive(
    start_node: NodeStarter, ros_context: Context, inputs: Path
) -> None:
    types = {topic: kind for topic, kind in types_of(inputs).items() if topic != "/strange"}
    listener = Listener(ros_context, types)
    with listener.listening():
        node = start_node("replay", inputs, "--rate", 3)
        assert node.wait() == 0
    for topic in INPUTS:
        assert not listener.got[topic]
        assert topic in node.output
    for topic in (*OUTPUTS, "/planned/odom"):
        assert listener.got[topic]
    assert node.output.count("/strange is left out: message type foreign_msgs") == 1


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("-t", "/cmd_vel"), "only with --drive"),
        (("--remap", "/motor_torques:=/motor_command_request"), "--request-from"),
        (("--remap", "/odom:=/rover2/cmd_vel"), "only with --drive"),
        (("-t", "nothing_*"), "no topic is called 'nothing_*'"),
        (("--remap", "odom"), "FROM:=TO"),
        (("--start", "100"), "nothing from 100 s"),
        (("--rate", "nan"), "not a finite number"),
        (("-t", "/strange"), "foreign_msgs"),
        (("-t", "odom", "--wait", "1", "--wait-timeout", "0.3"), "fewer than 1 subscribers"),
        (("--drive", "--loop"), "does not work with --drive"),
        (("--request-from", "motor_command"), "works only with --drive"),
        (("--drive", "--request-from", "/odom", "--wait", "0"), "expected a sensor_msgs/msg/JointState"),
        (("--drive", "-x", "/planned/front_velocity,cmd_vel,base/*,arm/*"), "to drive by"),
        (("--resimulate", "rotations"), "--out"),
        (("--horizon", "3"), "works only with --resimulate"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line(
    start_node: NodeStarter, inputs: Path, args: tuple[str, ...], said: str
) -> None:
    node = start_node("replay", inputs, *args)
    assert node.wait() == 2
    assert said in node.output.splitlines()[-1]
    assert "Traceback" not in node.output


def test_ros_remapping_cannot_make_a_command_of_a_measurement(start_node: NodeStarter, rover: Path) -> None:
    node = start_node("replay", rover, "--ros-args", "-r", "motor_command:=motor_command_request")
    assert node.wait() == 2
    assert "--request-from" in node.output


def test_a_damaged_recording_is_refused(start_node: NodeStarter, counted: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(next(counted.glob("*.mcap")).read_bytes()[:-100])
    node = start_node("replay", cut)
    assert node.wait() == 2
    assert "artibot recover" in node.output


def test_signals_end_it_with_status_0(start_node: NodeStarter, counted: Path) -> None:
    nodes = [(start_node("replay", counted, "--rate", 0.01), number) for number in (signal.SIGINT, signal.SIGTERM)]
    for node, number in nodes:
        node.wait_for("playing")
        node.send(number)
        assert node.wait(10.0) == 0
        assert "Traceback" not in node.output


def test_an_empty_stretch_does_not_spin_and_nobody_is_waited_for_in_vain(
    start_node: NodeStarter, tmp_path: Path
) -> None:
    stamps = START_NS + np.array([0, 1_000_000_000])
    bag = write_channels(tmp_path / "two", {"motor_torques": (stamps, {"front_right.velocity": np.zeros(2)})})
    node = start_node("replay", bag, "--start", 0.4, "--end", 0.6, "--loop")
    assert node.wait() == 0
    assert "0 messages" in node.output and "nobody listens" in node.output
