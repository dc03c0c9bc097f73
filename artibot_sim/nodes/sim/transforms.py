"""Transforms that only the simulator knows.

They are ``map`` → ``odom``, so that the chain ends where the rover really is, and ``base_link`` →
``articulation_link`` → ``back_link`` as the URDF has them, so that a robot_state_publisher may run beside and says the
same.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from artibot_sim.model import Robot
from artibot_sim.nodes.common.qos import Polled, subscription
from artibot_sim.nodes.common.rotations import rotation
from artibot_sim.nodes.common.transforms import FrameNames, Place, TransformPublisher
from artibot_sim.nodes.sim.engine import TrueState

Array = NDArray[np.float64]

KEPT = 200
"""True poses that are kept for an odometry that comes later, 2 s at 100 Hz."""


class SimulatedTransforms:
    """The simulator's: ``map`` → ``odom`` and the articulation.

    Parameters
    ----------
    node : rclpy Node
    robot : Robot
    frames : FrameNames
    with_driver : bool
        Whether a driver publishes the odometry; then the simulator subscribes to it.
    """

    def __init__(self, node: Node, robot: Robot, frames: FrameNames, with_driver: bool) -> None:
        pairs = [(frames.map, frames.odom)]
        ahead = frames.base
        for i in range(1, len(robot.modules)):
            joint, module = frames.behind(i)
            pairs += [(ahead, joint), (joint, module)]
            ahead = module
        self._publisher = TransformPublisher(node, *pairs)
        self._joints = list(zip(robot.hitches, robot.modules[1:], strict=True))
        self._odometry = DriverOdometry(node) if with_driver else None

    def publish(self, t_ns: int, sample: TrueState, believed: tuple[float, float, float]) -> None:
        """Publish them at one instant; `believed` is this node's own odometry (m, rad)."""
        truth = (tuple(sample.position.tolist()), tuple(sample.rpy.tolist()))
        correction: Place | None = corrected(truth, believed)  # type: ignore[arg-type]
        if self._odometry:
            correction = self._odometry.correction(t_ns, sample)
        self._publisher.publish(t_ns, correction, *self._articulations(sample))

    def _articulations(self, sample: TrueState) -> Iterator[Place]:
        """Of each joint: the joint on the module ahead, and the module behind on the joint."""
        for (hitch, behind), (bend, twist) in zip(
            self._joints, sample.articulation[0].reshape(-1, 2).tolist(), strict=False
        ):
            yield (-hitch.l, 0.0, hitch.O_z), (0.0, 0.0, bend)
            hang = (-behind.l, behind.O_z * math.sin(twist), -behind.O_z * math.cos(twist))
            yield hang, (twist, 0.0, 0.0)


class DriverOdometry:
    """What a driver believes, held against where the rover was at that instant."""

    def __init__(self, node: Node) -> None:
        group = Polled()
        self._subscription = subscription(node, Odometry, "odom", lambda _: None, qos_profile_sensor_data, group=group)
        self._truths: deque[tuple[int, Array]] = deque(maxlen=KEPT)
        self._correction: Place | None = None

    def correction(self, t_ns: int, sample: TrueState) -> Place | None:
        """``map`` → ``odom`` by the newest odometry; None before the first."""
        self._truths.append((t_ns, np.concatenate([sample.position, sample.rpy])))
        newest = None
        while (taken := self._subscription.handle.take_message(Odometry, False)) is not None:
            newest = taken[0]
        if newest is not None:
            stamp, pose = newest.header.stamp, newest.pose.pose
            truth = self._truth_at(stamp.sec * 1_000_000_000 + stamp.nanosec).tolist()
            yaw = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
            believed = (pose.position.x, pose.position.y, yaw)
            self._correction = corrected(((truth[0], truth[1], truth[2]), (truth[3], truth[4], truth[5])), believed)
        return self._correction

    def _truth_at(self, t_ns: int) -> Array:
        """Pose (x, y, z, roll, pitch, yaw) at an instant, in proportion between those that are kept."""
        stamps = np.array([stamp - t_ns for stamp, _ in self._truths], float)
        poses = np.array([pose for _, pose in self._truths])
        return np.array([np.interp(0.0, stamps, column) for column in poses.T])


def corrected(truth: Place, believed: tuple[float, float, float]) -> Place:
    """Where ``odom`` is in ``map`` for ``base_link`` to be at `truth`, though `believed` (x, y, yaw) in ``odom``."""
    turn = rotation(*truth[1]) @ rotation(0.0, 0.0, -believed[2])
    x, y, z = (np.array(truth[0]) - turn @ np.array([believed[0], believed[1], 0.0])).tolist()
    pitch = -math.asin(max(-1.0, min(1.0, turn[2, 0])))
    return (x, y, z), (math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0]))
