"""Frames of a rover, and transforms between them on ``/tf``.

Whoever publishes ``odom`` publishes ``odom`` → ``base_link``. tf2_msgs comes with a full ROS 2 only; without it nothing
is published.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from artibot_sim.model.robot.robot import module_name
from artibot_sim.nodes.common.qos import publisher
from artibot_sim.nodes.common.rotations import quaternion

Place = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Translation (m), and roll, pitch and yaw (rad)."""


@dataclass(frozen=True)
class FrameNames:
    """Names of the frames of one rover; `map` is common to all. Joints and modules behind are counted on."""

    map: str = "map"
    odom: str = "odom"
    base: str = "base_link"
    articulation: str = "articulation_link"
    back: str = "back_link"
    prefix: str = ""

    def behind(self, module: int) -> tuple[str, str]:
        """The frames of the joint ahead of a module, counted from 0, and of the module itself."""
        if module == 1:
            return self.articulation, self.back
        return f"{self.prefix}articulation_link_{module}", f"{self.prefix}{module_name(module)}_link"

    @classmethod
    def of(cls, prefix: str, map_frame: str = "map", odom: str = "odom", base: str = "base_link") -> FrameNames:
        """All but the map with a prefix, as robot_state_publisher's `frame_prefix`: ``rover1/`` gives rover1/odom."""
        return cls(map_frame, prefix + odom, prefix + base, prefix + cls.articulation, prefix + cls.back, prefix)


def has_tf(node: Node, wanted: bool) -> bool:
    """Whether ``/tf`` is wanted and can be published; says so where it cannot."""
    there = importlib.util.find_spec("tf2_msgs") is not None
    if wanted and not there:
        node.get_logger().info("no /tf: tf2_msgs cannot be imported (it comes with a full ROS 2)")
    return wanted and there


class TransformPublisher:
    """Publishes transforms between fixed pairs of frames, in one message.

    Parameters
    ----------
    node : rclpy Node
    pairs : parents and children
    """

    def __init__(self, node: Node, *pairs: tuple[str, str]) -> None:
        from tf2_msgs.msg import TFMessage

        self._publisher = publisher(node, TFMessage, "/tf", QoSProfile(depth=100))
        self._kind = TFMessage
        self._transforms = [_transform(*pair) for pair in pairs]

    def publish(self, t_ns: int, *places: Place | None) -> None:
        """Publish where each child is in its parent; None: not known."""
        known = []
        for stamped, place in zip(self._transforms, places, strict=True):
            if place is None:
                continue
            stamped.header.stamp.sec, stamped.header.stamp.nanosec = divmod(t_ns, 1_000_000_000)
            target, q = stamped.transform.translation, stamped.transform.rotation
            target.x, target.y, target.z = place[0]
            q.x, q.y, q.z, q.w = quaternion(*place[1])
            known.append(stamped)
        self._publisher.publish(self._kind(transforms=known))


def _transform(parent: str, child: str) -> TransformStamped:
    transform = TransformStamped(child_frame_id=child)
    transform.header.frame_id = parent
    return transform
