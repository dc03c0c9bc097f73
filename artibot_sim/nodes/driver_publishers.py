"""What the driver publishes: the drives' feedback, what was sent to them, and how they are."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState

from artibot_driver.master import Commanded, Feedback
from artibot_sim.model import Robot
from artibot_sim.nodes.driver_diagnostics import essence
from artibot_sim.nodes.motor_publishers import MotorPublishers, WheelJoints, stamp_of_ns
from artibot_sim.nodes.odometry import Odometry, Slip, metres_per_radian
from artibot_sim.nodes.qos import PUBLISHED, publisher
from artibot_sim.nodes.transforms import Frames, has_tf

EVERY_NS = 1_000_000_000
"""Between two /diagnostics where nothing changes."""

NEWS_NS = 100_000_000
"""Between two /diagnostics at the least."""


class DriverPublishers:
    """The node's publishers.

    Parameters
    ----------
    node : rclpy Node
    robot : Robot
    settings : mapping
        The node's parameters.
    """

    def __init__(self, node: Node, robot: Robot, settings: Mapping[str, Any]) -> None:
        get = settings.__getitem__
        frames = Frames.of(get("frame_prefix"), odom=get("odom_frame"), base=get("base_frame"))
        self._motors = MotorPublishers(node, robot, PUBLISHED, frames, has_tf(node, get("publish_tf")))
        self._wheels = WheelJoints(robot)
        self._joints = publisher(node, JointState, "joint_states")
        self._joints_message = JointState(name=list(self._wheels.names))
        self._diagnostics = publisher(node, DiagnosticArray, "/diagnostics")
        self._odometry = Odometry(metres_per_radian(robot), robot.front.i_y, Slip.of(settings, robot))
        self._sampled = 0
        self._told: tuple[tuple[bytes, str, str], ...] = ()
        self._told_ns = self._looked_ns = 0
        self._state: object = None

    def feedback(self, feedback: Feedback, epoch_ns: int) -> None:
        """Publish what the drives reported with the newest SYNC, if that is new.

        Parameters
        ----------
        epoch_ns : int
            System time less steady time.
        """
        sampled = max((stamp for stamp in feedback.stamp_ns if stamp is not None), default=0)
        if sampled <= self._sampled:
            return
        self._sampled, t_ns = sampled, sampled + epoch_ns
        self._motors.torques(t_ns, feedback.position, feedback.velocity, feedback.torque)
        message = self._joints_message
        stamp_of_ns(message, t_ns)
        message.position, message.velocity = self._wheels.of(feedback.position), self._wheels.of(feedback.velocity)
        self._joints.publish(message)
        front, rates = feedback.position[:2], feedback.velocity[:2]
        if all(map(math.isfinite, (*front, *rates))):
            self._odometry.update(front, rates)
            self._motors.odom(t_ns, self._odometry)

    def commanded(self, commanded: Commanded, epoch_ns: int) -> None:
        """Publish what was sent with a SYNC."""
        t_ns = commanded.stamp_ns + epoch_ns
        self._motors.command(t_ns, commanded.front_velocity, commanded.back_effort)

    def diagnostics(self, now_ns: int, state: object, made: Callable[[], DiagnosticArray]) -> None:
        """Publish /diagnostics once a second, and ten times a second at most when it says something new.

        Parameters
        ----------
        now_ns : int
            Steady time.
        state : object
            At once there may be news where this is another one, else ten times a second: the message is long to make.
        made : callable
            Makes the message.
        """
        if now_ns - self._told_ns < NEWS_NS or (state == self._state and now_ns - self._looked_ns < NEWS_NS):
            return
        self._state, self._looked_ns = state, now_ns
        message = made()
        news = essence(message)
        if news == self._told and now_ns - self._told_ns < EVERY_NS:
            return
        self._told, self._told_ns = news, now_ns
        self._diagnostics.publish(message)
