"""What tests of the replay share: a rover's recording with every kind of input, and a listener that keeps all bytes."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bag_helpers import JOINTS, joint_state

from artibot_sim.experiment import iter_messages, read_bag, serialize, write_channels, write_experiment
from artibot_sim.experiment.messages import header, message_class, vector
from artibot_sim.experiment.topics import LATCHED
from artibot_sim.experiment.writer import BagWriter
from artibot_sim.model import load_robot, rollout
from artibot_sim.nodes.common.message_types import import_message
from artibot_sim.planning import load_manoeuvre, plan

if TYPE_CHECKING:
    from rclpy.context import Context

MANOEUVRE = """
description: forward, and to the left
a_max_m_s2: 1.0
segments:
  - straight: {length_m: 0.6, speed_m_s: 0.6}
  - arc: {radius_m: 2.0, angle_deg: 15.0, speed_m_s: 0.6, end_speed_m_s: 0.0}
"""
INPUTS = ("/planned/front_velocity", "/cmd_vel", "/motor_command_request", "/arm/joint_trajectory", "/base/cmd_vel_raw")
OUTPUTS = ("/ground_truth/odom", "/joint_states", "/motor_command", "/motor_torques", "/odom")
START_NS = 1_700_000_000_000_000_000


def rover_bag(folder: Path) -> Path:
    """A simulated run of some 3 s, as the simulator and the planner would leave it."""
    (folder.parent / "short.yaml").write_text(MANOEUVRE)
    robot = load_robot("agriq")
    planned = plan(load_manoeuvre(str(folder.parent / "short.yaml")), robot, dt=0.01)
    return write_experiment(folder, rollout(robot, planned.commands()), planned, robot, start_ns=START_NS)


def input_bag(folder: Path, plain: Path) -> Path:
    """The recording `plain` with every kind of input beside, and one topic of a type that nobody has installed."""
    twist = message_class("geometry_msgs/msg/Twist")
    with BagWriter(folder, {"robot": "agriq"}, live=False) as bag:
        for channel in {m.channel.topic: m.channel for m in iter_messages(plain)}.values():
            latched = channel.topic.startswith("/planned/") and channel.topic != "/planned/odom"
            bag.register(channel.topic, channel.ros_type, LATCHED if latched else None)
        for topic, kind in (
            ("/cmd_vel", "geometry_msgs/msg/TwistStamped"),
            ("/motor_command_request", JOINTS),
            ("/arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
            ("/base/cmd_vel_raw", "geometry_msgs/msg/Twist"),
        ):
            bag.register(topic, kind)
        bag.register("/strange", "foreign_msgs/msg/Thing", definition="int32 x\n", type_hash="RIHS01_" + "0" * 64)
        for i, message in enumerate(iter_messages(plain)):
            t = message.log_ns
            bag.write(message.channel.topic, message.data, t, t)
            if i % 50 == 0:
                fast = twist(linear=vector(0.3, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0))
                stamped = serialize("geometry_msgs/msg/TwistStamped", header=header(t, "base_link"), twist=fast)
                bag.write("/cmd_vel", stamped, t, t)
                bag.write(
                    "/base/cmd_vel_raw",
                    serialize("geometry_msgs/msg/Twist", linear=fast.linear, angular=fast.angular),
                    t,
                    t,
                )
                bag.write(
                    "/motor_command_request", joint_state(t, ["front_right", "front_left"], velocity=[9.0, 9.0]), t, t
                )
                empty = serialize("trajectory_msgs/msg/JointTrajectory", header=header(t), joint_names=[], points=[])
                bag.write("/arm/joint_trajectory", empty, t, t)
                bag.write("/strange", b"\x00\x01\x00\x00\x07\x00\x00\x00", t, t)
    return folder


def counting_bag(folder: Path, count: int = 300, step_ns: int = 5_000_000) -> Path:
    """`count` messages on each of two topics, one every `step_ns`; the number is in the message."""
    stamps = START_NS + step_ns * np.arange(count)
    columns = {"front_right.velocity": np.arange(count, dtype=float)}
    places = {"x": np.arange(count, dtype=float), "y": np.zeros(count), "yaw": np.zeros(count)}
    return write_channels(folder, {"motor_torques": (stamps, columns), "ground_truth_odom": (stamps, places)})


def recorded(bag: Path) -> dict[str, list[bytes]]:
    """All messages of a recording, by topic."""
    found: dict[str, list[bytes]] = {}
    for message in iter_messages(bag):
        found.setdefault(message.channel.topic, []).append(bytes(message.data))
    return found


class Listener:
    """Takes the bytes of every message on some topics.

    Attributes
    ----------
    got : topic → (bytes, time of publication in ns) in order of arrival.
    """

    def __init__(self, context: Context, topics: dict[str, str], depth: int = 5000) -> None:
        from rclpy.node import Node
        from rclpy.qos import QoSProfile

        self.node = Node("probe", context=context)
        self.got: dict[str, list[tuple[bytes, int]]] = {topic: [] for topic in topics}
        self._subscriptions = {
            topic: self.node.create_subscription(
                import_message(kind), topic, lambda _: None, QoSProfile(depth=depth), raw=True
            )
            for topic, kind in topics.items()
        }

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Take what comes, in a thread; at the end what is still there."""
        stop = threading.Event()

        def work() -> None:
            while not stop.is_set():
                self.take()
                time.sleep(0.002)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        try:
            yield
        finally:
            time.sleep(0.3)
            stop.set()
            thread.join()
            self.take()

    def take(self) -> None:
        """Take all that has arrived."""
        for topic, subscription in self._subscriptions.items():
            while True:
                taken: Any = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                self.got[topic].append((bytes(taken[0]), int(taken[1]["source_timestamp"])))

    def bytes_of(self, topic: str) -> list[bytes]:
        """The messages of a topic."""
        return [data for data, _ in self.got[topic]]

    def times_of(self, topic: str) -> np.ndarray:
        """When the messages of a topic were published, s."""
        return np.array([when for _, when in self.got[topic]]) / 1e9


def types_of(bag: Path) -> dict[str, str]:
    """Topic → type of a recording."""
    return dict(read_bag(bag).topics)
