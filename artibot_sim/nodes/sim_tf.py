"""Transforms ``map`` → ``odom`` → ``base_link`` → ``articulation_link`` → ``back_link``; needs tf2_msgs."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage

from artibot_sim.model import Robot
from artibot_sim.nodes.qos import publisher
from artibot_sim.nodes.sim_engine import Sample, quaternion

FRAMES = ("map", "odom", "base_link", "articulation_link", "back_link")
"""Parents and children in one chain. The last two are as the URDF has them, so that a robot_state_publisher may run
beside and says the same."""


class Transforms:
    """The /tf publisher with its message.

    Parameters
    ----------
    node : rclpy Node
    robot : Robot
    """

    def __init__(self, node: Node, robot: Robot) -> None:
        self._publisher = publisher(node, TFMessage, "/tf", QoSProfile(depth=100))
        frames = FRAMES if robot.articulated else FRAMES[:3]
        self._transforms = [_transform(a, b) for a, b in pairwise(frames)]
        self._front, self._back = robot.front, robot.back

    def publish(self, stamp: tuple[int, int], sample: Sample, believed: tuple[float, float, float]) -> None:
        """Publish all transforms at one instant; `believed` is the odometry's pose (m, rad)."""
        for transform in self._transforms:
            transform.header.stamp.sec, transform.header.stamp.nanosec = stamp
        x, y, z = sample.position.tolist()
        roll, pitch, yaw = sample.rpy.tolist()
        turn = yaw - believed[2]
        c, s = math.cos(turn), math.sin(turn)
        corrected = (x - c * believed[0] + s * believed[1], y - s * believed[0] - c * believed[1], 0.0)
        _fill(self._transforms[0], corrected, (0.0, 0.0, turn))
        _fill(self._transforms[1], (believed[0], believed[1], z), (roll, pitch, believed[2]))
        if self._back:
            bend, twist = sample.articulation[0].tolist()
            _fill(self._transforms[2], (-self._front.l, 0.0, self._front.O_z), (0.0, 0.0, bend))
            hang = (-self._back.l, self._back.O_z * math.sin(twist), -self._back.O_z * math.cos(twist))
            _fill(self._transforms[3], hang, (twist, 0.0, 0.0))
        self._publisher.publish(TFMessage(transforms=self._transforms))


def _transform(parent: str, child: str) -> TransformStamped:
    transform = TransformStamped(child_frame_id=child)
    transform.header.frame_id = parent
    return transform


def _fill(stamped: Any, translation: tuple[float, float, float], rpy: tuple[float, float, float]) -> None:
    target = stamped.transform.translation
    target.x, target.y, target.z = translation
    q = stamped.transform.rotation
    q.x, q.y, q.z, q.w = quaternion(*rpy)
