"""A node that listens to a simulator and commands it, for the tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from geometry_msgs.msg import PointStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ros_helpers import spin_until

FRONT = ["front_right", "front_left"]
METRES = 0.2 / 47.64
"""Ground per radian of a front motor of Agri.q."""

TYPES: dict[str, Any] = {
    "odom": Odometry,
    "ground_truth/odom": Odometry,
    "joint_states": JointState,
    "motor_torques": JointState,
    "motor_command": JointState,
    "/clock": Clock,
    "imu/data": Imu,
    "total_station/point": PointStamped,
}
RECENT = 100
"""Messages of a topic that are kept where all others are forgotten."""

MEASURED = ("odom", "ground_truth/odom", "joint_states", "motor_torques", "motor_command")


def stamp_ns(message: Any) -> int:
    """Stamp of any of the messages, nanoseconds."""
    stamp = message.clock if isinstance(message, Clock) else message.header.stamp
    return stamp.sec * 10**9 + stamp.nanosec


class Probe:
    """Collects messages of chosen topics in ``got[topic]``, and sends commands.

    Parameters
    ----------
    context : rclpy Context
    topics : sequence of str
        Keys of TYPES.
    reliable : bool
        Whether to ask for reliability, with a queue for thousands of messages.
    """

    def __init__(self, context: Context, topics: Sequence[str] = ("ground_truth/odom",), reliable: bool = False):
        self.node = Node("probe", context=context)
        policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        self.got: dict[str, list[Any]] = {topic: [] for topic in topics}
        for topic in topics:
            qos = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT if topic == "/clock" else policy)
            self.node.create_subscription(TYPES[topic], topic, self.got[topic].append, qos)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.profile = self.node.create_publisher(JointTrajectory, "planned/front_velocity", latched)
        self.planned = self.node.create_publisher(Odometry, "planned/odom", 10)
        self.request = self.node.create_publisher(JointState, "motor_command_request", 10)
        self.twist = self.node.create_publisher(TwistStamped, "cmd_vel", 10)
        self.plain_twist: Any = None

    # -- waiting ------------------------------------------------------------------------------------------------

    def until(self, done: Callable[[], bool], what: str, timeout: float = 30.0) -> None:
        spin_until(self.node, done, timeout, what)

    def spin(self, seconds: float) -> None:
        """Listen for so long (wall time)."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= end, "time passing", seconds + 30.0)

    def ready(self, timeout: float = 60.0) -> None:
        """Wait until the simulator is there and hears every command."""
        mine = (self.profile, self.planned, self.request, self.twist)
        self.until(lambda: all(p.get_subscription_count() for p in mine), "the simulator to listen", timeout)
        self.until(lambda: all(self.got[t] for t in self.got if t in MEASURED), "its topics", timeout)

    def last(self, topic: str = "ground_truth/odom") -> Any:
        return self.got[topic][-1]

    def forget(self) -> None:
        """All but the newest messages: hours of them fill the memory."""
        for messages in self.got.values():
            del messages[:-RECENT]

    def clear(self) -> None:
        for messages in self.got.values():
            messages.clear()

    def speed(self) -> float:
        """Newest forward speed, m/s."""
        return self.last().twist.twist.linear.x

    def braking(self) -> NDArray[np.float64]:
        """Deceleration that was commanded between two messages (m/s², of the faster front wheel).

        By their stamps: a listener that a busy machine holds up for a quarter of a second misses some of them.
        """
        fastest = METRES * np.abs([message.velocity[:2] for message in self.got["motor_command"]]).max(axis=1)
        passed = 1e-9 * np.diff([stamp_ns(message) for message in self.got["motor_command"]])
        return -np.diff(fastest) / passed

    def now_ns(self) -> int:
        """Newest stamp of the ground truth."""
        return stamp_ns(self.last())

    # -- commands -----------------------------------------------------------------------------------------------

    def send_profile(self, start_ns: int, velocities: Sequence[Sequence[float]], names: Sequence[str] = FRONT) -> None:
        """The whole profile: motor speeds in rad/s, a point every 10 ms."""
        message = JointTrajectory(joint_names=list(names))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(start_ns, 10**9)
        for i, pair in enumerate(velocities):
            point = JointTrajectoryPoint(velocities=list(map(float, pair)))
            t = i * 10_000_000
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(t, 10**9)
            message.points.append(point)
        self.profile.publish(message)

    def send_request(self, velocity: Sequence[float], names=None, effort=()) -> None:
        names = FRONT if names is None else names
        self.request.publish(JointState(name=names, velocity=list(map(float, velocity)), effort=list(effort)))

    def send_twist(self, v: float, w: float) -> None:
        message = TwistStamped()
        message.twist.linear.x, message.twist.angular.z = v, w
        self.twist.publish(message)

    def send_plain_twist(self, v: float, w: float) -> None:
        if self.plain_twist is None:
            self.plain_twist = self.node.create_publisher(Twist, "cmd_vel", 10)
        message = Twist()
        message.linear.x, message.angular.z = v, w
        self.plain_twist.publish(message)

    def repeat(self, send: Callable[[], None], seconds: float, every: float = 0.02) -> None:
        """Send again and again while listening (wall time)."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            send()
            self.spin(every)

    def keep_alive(self, seconds: float) -> None:
        """The planner's sign of life."""
        self.repeat(lambda: self.planned.publish(Odometry()), seconds)

    # -- services -----------------------------------------------------------------------------------------------

    def call(self, kind: Any, name: str, request: Any, timeout: float = 30.0) -> Any:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"service {name}", timeout)
        future = client.call_async(request)
        self.until(future.done, f"an answer of {name}", timeout)
        self.node.destroy_client(client)
        return future.result()

    def trigger(self, name: str) -> Any:
        return self.call(Trigger, f"sim/{name}", Trigger.Request())

    def pause(self, paused: bool) -> Any:
        return self.call(SetBool, "sim/pause", SetBool.Request(data=paused))
