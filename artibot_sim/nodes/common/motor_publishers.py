"""What simulator and driver publish of the motors: odometry, torques, commands and wheel joints, filled in place."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.odometry import UNKNOWN
from artibot_sim.estimation.odometry import Odometry as Believed
from artibot_sim.exchange.urdf import urdf
from artibot_sim.model import MOTORS, Robot
from artibot_sim.model.robot.robot import sides_of
from artibot_sim.model.simulate.rollout import side_gears
from artibot_sim.nodes.common.qos import LATCHED, PUBLISHED, publisher
from artibot_sim.nodes.common.transforms import FrameNames, TransformPublisher

PLANAR = np.array([6 * i + j for i in (0, 1, 5) for j in (0, 1, 5)])
"""Of a 6 x 6 covariance: x, y and yaw with each other."""

UPRIGHT = np.array([7 * i for i in (2, 3, 4)])
"""Of a 6 x 6 covariance: the variances of height, roll and pitch."""


def numbers(values: Any) -> array[float]:
    """Numbers as a message's sequence takes them without looking at each."""
    return array("d", np.ascontiguousarray(values, dtype=float).tobytes())


def stamp_of_ns(message: Any, t_ns: int) -> None:
    """Set the stamp of a message's header."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(t_ns, 1_000_000_000)


def odometry_message(frame: str, child: str = "base_link") -> Odometry:
    """An empty Odometry between two frames, in which height, roll and pitch are unknown."""
    message = Odometry(child_frame_id=child)
    message.pose.covariance[UPRIGHT] = message.twist.covariance[UPRIGHT] = UNKNOWN
    message.header.frame_id = frame
    return message


class WheelJoints:
    """Wheel angles from motor angles: both wheels of a motor turn with it.

    Parameters
    ----------
    robot : Robot
    passive : bool
        Whether the wheels of passive modules are known, too.

    Attributes
    ----------
    names : tuple of str
    """

    def __init__(self, robot: Robot, passive: bool = False) -> None:
        sides = sides_of(len(robot.modules))
        self._driven = [sides.index(motor) for motor in robot.motors if motor in sides]
        self._tau = side_gears(robot)[self._driven]
        self._passive = passive and len(self._driven) < len(sides)
        joints = robot.wheel_joints
        known = range(len(sides)) if passive else self._driven
        self.names = tuple(joint for side in known for joint in joints[2 * side : 2 * side + 2])

    def of(self, motors: Any, sides: Any = None) -> array[float]:
        """Wheel-side values, in the order of `names`, from the motors' (shape (4,)).

        `sides` are those of the wheels on each side, of which the ones of passive modules are taken.
        """
        turned = np.asarray(motors)[: len(self._driven)] * self._tau
        if self._passive:
            turned, driven = np.array(sides), turned
            turned[self._driven] = driven
        return numbers(np.repeat(turned, 2))


class MotorPublishers:
    """Publishers of ``odom``, ``motor_torques``, ``motor_command`` and ``robot_description``.

    Parameters
    ----------
    node : rclpy Node
    robot : Robot
    qos : QoSProfile
    frames : FrameNames
    tf : bool
        Whether the transform from `odom` to the front module goes with ``odom``.
    """

    def __init__(
        self,
        node: Node,
        robot: Robot,
        qos: QoSProfile = PUBLISHED,
        frames: FrameNames | None = None,
        tf: bool = False,
    ) -> None:
        frames = frames or FrameNames()
        self.motors = robot.motors if robot.articulated else MOTORS[:2]
        self._odom = publisher(node, Odometry, "odom", qos)
        self._odom_message = odometry_message(frames.odom, frames.base)
        self._transform = TransformPublisher(node, (frames.odom, frames.base)) if tf else None
        self._torques = publisher(node, JointState, "motor_torques", qos)
        self._torques_message = JointState(name=list(self.motors))
        self._command = publisher(node, JointState, "motor_command", qos)
        self._command_message = JointState(name=list(self.motors))
        self._description = publisher(node, String, "robot_description", LATCHED)
        self._describe(node, robot)
        self.publishers = (self._odom, self._torques, self._command)

    def _describe(self, node: Node, robot: Robot) -> None:
        """Publish the URDF once, for viewers and recordings."""
        try:
            self._description.publish(String(data=urdf(robot)))
        except ArtibotError as error:
            node.get_logger().info(f"no robot_description: {error}")

    def odom(self, t_ns: int, believed: Believed) -> None:
        """Publish where the rover believes it is, and how sure that is."""
        message = self._odom_message
        stamp_of_ns(message, t_ns)
        x, y, yaw = believed.pose
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        q = message.pose.pose.orientation
        q.z, q.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        message.twist.twist.linear.x, message.twist.twist.angular.z = believed.twist
        message.pose.covariance[PLANAR] = believed.pose_covariance.ravel()
        message.twist.covariance[PLANAR] = believed.twist_covariance.ravel()
        self._odom.publish(message)
        if self._transform:
            self._transform.publish(t_ns, ((x, y, 0.0), (0.0, 0.0, yaw)))

    def torques(self, t_ns: int, position: Any, velocity: Any, torque: Any) -> None:
        """Publish what the motors do, arrays of shape (4,): rad, rad/s, N·m, motor-side."""
        n, message = len(self.motors), self._torques_message
        stamp_of_ns(message, t_ns)
        message.position, message.velocity = numbers(position[:n]), numbers(velocity[:n])
        message.effort = numbers(torque[:n])
        self._torques.publish(message)

    def command(self, t_ns: int, velocity: Sequence[float], torque: Sequence[float]) -> None:
        """Publish what was commanded: front velocities (rad/s) and back torques (N·m); NaN where nothing was."""
        n, message = len(self.motors), self._command_message
        stamp_of_ns(message, t_ns)
        message.velocity = array("d", [*velocity, *(math.nan,) * n][:n])
        message.effort = array("d", [math.nan, math.nan, *torque][:n])
        self._command.publish(message)
