"""What simulator and driver publish of the motors: odometry, torques, commands and wheel joints, filled in place."""

from __future__ import annotations

import math
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
from artibot_sim.nodes.common.prepared import PreparedMessage
from artibot_sim.nodes.common.qos import LATCHED, PUBLISHED, publisher
from artibot_sim.nodes.common.transforms import FrameNames, TransformPublisher

PLANAR = np.array([6 * i + j for i in (0, 1, 5) for j in (0, 1, 5)])
"""Of a 6 x 6 covariance: x, y and yaw with each other."""

MOTION = 7 + 36 + 6 + 36
"""Numbers of an Odometry from its position on: pose, covariance, twist, covariance."""

POSE_PLANAR, TWIST_PLANAR = 7 + PLANAR, 7 + 36 + 6 + PLANAR
"""Among these, the covariances of x, y and yaw."""

UPRIGHT = np.array([7 * i for i in (2, 3, 4)])
"""Of a 6 x 6 covariance: the variances of height, roll and pitch."""


def stamp_of_ns(message: Any, t_ns: int) -> None:
    """Set the stamp of a message's header."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(t_ns, 1_000_000_000)


def odometry_message(frame: str, child: str = "base_link") -> Odometry:
    """An empty Odometry between two frames, in which height, roll and pitch are unknown."""
    message = Odometry(child_frame_id=child)
    message.pose.covariance[UPRIGHT] = message.twist.covariance[UPRIGHT] = UNKNOWN
    message.header.frame_id = frame
    return message


class OdometryPublisher:
    """Publishes an Odometry in the plane.

    Parameters
    ----------
    publisher : rclpy Publisher
    message : Odometry
        With its frames.
    """

    def __init__(self, publisher: Any, message: Odometry) -> None:
        self._message = PreparedMessage(publisher, message)
        self._numbers = self._message.numbers("pose.pose.position.x", MOTION)

    def publish(
        self, t_ns: int, pose: Sequence[float], twist: Sequence[float], covariances: tuple[Any, Any] | None = None
    ) -> None:
        """Publish pose and twist, each with x, y and yaw, and their covariances (3, 3), where these are estimated."""
        numbers, half = self._numbers, 0.5 * pose[2]
        numbers[:2], numbers[5:7] = pose[:2], (math.sin(half), math.cos(half))
        numbers[43:45], numbers[48] = twist[:2], twist[2]
        if covariances is not None:
            numbers[POSE_PLANAR], numbers[TWIST_PLANAR] = (one.ravel() for one in covariances)
        self._message.publish(t_ns)


class JointStatePublisher:
    """Publishes states of the same joints or motors again and again.

    Parameters
    ----------
    publisher : rclpy Publisher
    names : sequence of str
    fields : sequence of str
        Which of position, velocity and effort there are; the others stay empty.
    """

    def __init__(self, publisher: Any, names: Sequence[str], fields: Sequence[str]) -> None:
        empty = dict.fromkeys(fields, [0.0] * len(names))
        self._message = PreparedMessage(publisher, JointState(name=list(names), **empty))
        self._fields = [self._message.numbers(field, len(names)) for field in fields]

    def publish(self, t_ns: int, *values: Any) -> None:
        """Publish the values of each field."""
        for field, given in zip(self._fields, values, strict=True):
            field[:] = given
        self._message.publish(t_ns)


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
        self._tau = side_gears(robot)[self._driven].tolist()
        self._passive = passive and len(self._driven) < len(sides)
        joints = robot.wheel_joints
        known = range(len(sides)) if passive else self._driven
        self.names = tuple(joint for side in known for joint in joints[2 * side : 2 * side + 2])

    def of(self, motors: Sequence[float], sides: Sequence[float] | None = None) -> list[float]:
        """Wheel-side values, in the order of `names`, from the motors' four.

        `sides` are those of the wheels on each side, of which the ones of passive modules are taken.
        """
        turned = [gear * value for gear, value in zip(self._tau, motors, strict=False)]
        if self._passive:
            assert sides is not None
            driven, turned = turned, list(sides)
            for side, value in zip(self._driven, driven, strict=True):
                turned[side] = value
        return [value for value in turned for _ in range(2)]


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
        odom, torques, command = (
            publisher(node, kind, topic, qos)
            for kind, topic in ((Odometry, "odom"), (JointState, "motor_torques"), (JointState, "motor_command"))
        )
        self._odom = OdometryPublisher(odom, odometry_message(frames.odom, frames.base))
        self._transform = TransformPublisher(node, (frames.odom, frames.base)) if tf else None
        self._torques = JointStatePublisher(torques, self.motors, ("position", "velocity", "effort"))
        self._command = JointStatePublisher(command, self.motors, ("velocity", "effort"))
        self._description = publisher(node, String, "robot_description", LATCHED)
        self._describe(node, robot)
        self.publishers = (odom, torques, command)

    def _describe(self, node: Node, robot: Robot) -> None:
        """Publish the URDF once, for viewers and recordings."""
        try:
            self._description.publish(String(data=urdf(robot)))
        except ArtibotError as error:
            node.get_logger().info(f"no robot_description: {error}")

    def odom(self, t_ns: int, believed: Believed) -> None:
        """Publish where the rover believes it is, and how sure that is."""
        (x, y, yaw), (forward, rate) = believed.pose, believed.twist
        covariances = believed.pose_covariance, believed.twist_covariance
        self._odom.publish(t_ns, (x, y, yaw), (forward, 0.0, rate), covariances)
        if self._transform:
            self._transform.publish(t_ns, ((x, y, 0.0), (0.0, 0.0, yaw)))

    def torques(self, t_ns: int, position: Any, velocity: Any, torque: Any) -> None:
        """Publish what the motors do, arrays of shape (4,): rad, rad/s, N·m, motor-side."""
        n = len(self.motors)
        self._torques.publish(t_ns, position[:n], velocity[:n], torque[:n])

    def command(self, t_ns: int, velocity: Sequence[float], torque: Sequence[float]) -> None:
        """Publish what was commanded: front velocities (rad/s) and back torques (N·m); NaN where nothing was."""
        n = len(self.motors)
        self._command.publish(t_ns, [*velocity, *(math.nan,) * n][:n], [math.nan, math.nan, *torque][:n])
