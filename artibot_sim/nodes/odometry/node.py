"""The odometry node: measured rotations, yaw rates and the articulation in, ``odom_model`` out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState

from artibot_sim.estimation.model_odometry import ModelOdometry, StreamProperties
from artibot_sim.estimation.odometry import Slip
from artibot_sim.model import MOTORS, load_robot
from artibot_sim.nodes.common.motor_publishers import OdometryPublisher, odometry_message
from artibot_sim.nodes.common.parameters import declare, warn_of_unknown
from artibot_sim.nodes.common.qos import publisher, subscription
from artibot_sim.nodes.common.transforms import FrameNames, TransformPublisher, has_tf
from artibot_sim.parameters import Spec

SENSOR = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Takes messages of best-effort and of reliable publishers."""

SECOND = 1_000_000_000
_NAP = 0.2
"""s between two views of the signals while nothing arrives."""

_SLIP, _STREAMS = ModelOdometry.SLIP, StreamProperties()
_MOST = 10.0
"""Of what may be left open, relative: more than all, where a recording says so (`artibot odometry BAG`)."""

SPECS = (
    Spec("robot", "agriq", "Robot as identified: a name or the path of a robot file."),
    Spec("kappa", 0.0, "Front share of the torque, where back rotations are not measured; 0: the robot's.",
         low=0.0, high=1.0),
    Spec("frame_prefix", "", "Before the names of odom and base_link: rover1/ gives rover1/odom."),
    Spec("odom_frame", "odom", "Frame of the pose."),
    Spec("base_frame", "base_link", "Frame of the front module."),
    Spec("publish_tf", False, "Publish odom -> base_link, where publish_tf of simulator and driver is false."),
    Spec("use_gyro", True, "Take the turned angle from imu/data where there is one."),
    Spec("odometry.travel_slip", _SLIP.travel, "What the model leaves open of the distance, relative, 1.",
         low=0.0, high=_MOST),
    Spec("odometry.turn_slip", _SLIP.turn, "What it leaves open of the turned angle, relative, 1.",
         low=0.0, high=_MOST),
    Spec("odometry.side_slip", _SLIP.side, "Drift to the side relative to the distance, 1.", low=0.0, high=_MOST),
    Spec("rotation_delay", 0.0, "By which motor_torques is stamped late, s [robot file].", low=-1.0, high=1.0),
    Spec("gyro_delay", 0.0, "By which imu/data is stamped late, s [robot file].", low=-1.0, high=1.0),
    Spec("timing", _STREAMS.timing, "Standard deviation of stamps, s.", low=0.0, high=1.0),
    Spec("longest_hold", _STREAMS.longest_hold, "Equal samples in a row are held ones, s.", low=0.0, high=5.0),
    Spec("longest_gap", _STREAMS.longest_gap, "Without rotations for longer nothing is known of the motion, s.",
         low=0.05, high=10.0),
    Spec("gyro_bias", _STREAMS.bias, "Standard deviation of its bias before a standstill shows it, rad/s.",
         low=1e-5, high=1.0),
    Spec("gyro_noise", _STREAMS.gyro_noise, "Of yaw rates, rad/s per root Hz.", low=1e-6, high=1.0),
)  # fmt: skip


class OdometryNode(Node):
    """``odometry`` (see the module's text).

    Parameters
    ----------
    overrides : dict
        Parameters set by the command line; they win over ``--ros-args``.
    asked : list of int
        Grows when the process is asked to end.

    Raises
    ------
    ArtibotError
        When a parameter or the robot is refused.
    """

    def __init__(self, overrides: dict[str, Any], asked: list[int]) -> None:
        given = [Parameter(name, value=value) for name, value in overrides.items()]
        super().__init__("odometry", parameter_overrides=given)
        self._asked = asked
        settings: dict[str, Any] = {spec.name: declare(self, spec) for spec in SPECS}
        robot = load_robot(settings["robot"])
        streams = StreamProperties(
            rotation_delay=settings["rotation_delay"] or robot.sensors.rotation_delay,
            gyro_delay=settings["gyro_delay"] or robot.sensors.gyro_delay,
            articulation_delay=robot.sensors.articulation_delay, timing=settings["timing"],
            longest_hold=settings["longest_hold"], longest_gap=settings["longest_gap"], bias=settings["gyro_bias"],
            gyro_noise=settings["gyro_noise"],
        )  # fmt: skip
        self.odometry = ModelOdometry(robot, Slip.of(settings, robot), streams, settings["kappa"] or None)
        self._names = MOTORS if robot.articulated else MOTORS[:2]
        frames = FrameNames.of(settings["frame_prefix"], odom=settings["odom_frame"], base=settings["base_frame"])
        message = odometry_message(frames.odom, frames.base)
        self._out = OdometryPublisher(publisher(self, Odometry, "odom_model"), message)
        tf = has_tf(self, settings["publish_tf"])
        self._transform = TransformPublisher(self, (frames.odom, frames.base)) if tf else None
        self._remarked: dict[str, int] = {}
        subscription(self, JointState, "motor_torques", self._on_motors, SENSOR)
        if robot.articulated:
            subscription(self, JointState, "joint_states", self._on_joints, SENSOR)
        if settings["use_gyro"]:
            subscription(self, Imu, "imu/data", self._on_imu, SENSOR)
        warn_of_unknown(self)

    def run(self, executor: Any) -> int:
        """Serve until asked to end; return the exit status."""
        self.get_logger().info(f"{self.odometry.robot.name}: odometry from motor_torques to odom_model")
        while not self._asked:
            executor.spin_once(timeout_sec=_NAP)
        return 0

    def _on_motors(self, message: JointState) -> None:
        position, velocity = self._by_name(message, message.position), self._by_name(message, message.velocity)
        if not self.odometry.update(_seconds(message), position, velocity):
            return
        self._say()
        odometry = self.odometry
        assert odometry.t is not None
        t_ns = round(odometry.t * SECOND)
        covariances = odometry.pose_covariance, odometry.twist_covariance
        self._out.publish(t_ns, odometry.pose, odometry.twist, covariances)
        if self._transform:
            x, y, yaw = odometry.pose
            self._transform.publish(t_ns, ((x, y, 0.0), (0.0, 0.0, yaw)))

    def _by_name(self, message: JointState, values: Sequence[float]) -> list[float]:
        """Values in the order of MOTORS, NaN for motors that are not in the message."""
        found = dict(zip(message.name, values, strict=False))
        return [found.get(name, math.nan) for name in self._names]

    def _on_joints(self, message: JointState) -> None:
        if "articulation_yaw" in message.name:
            place = message.name.index("articulation_yaw")
            if place < len(message.position):
                self.odometry.take_articulation(message.position[place])

    def _on_imu(self, message: Imu) -> None:
        if np.isfinite(message.angular_velocity.z):
            self.odometry.take_gyro(_seconds(message), message.angular_velocity.z)

    def _say(self) -> None:
        """Log what was left out: each kind once, and when it has happened ten times as often."""
        for text, count in self.odometry.remarks.items():
            if text != "held sample" and count >= 10 * self._remarked.get(text, 0.1):
                self._remarked[text] = count
                self.get_logger().warning(f"{text} ({count} so far)")


def _seconds(message: Any) -> float:
    return float(message.header.stamp.sec) + 1e-9 * float(message.header.stamp.nanosec)
