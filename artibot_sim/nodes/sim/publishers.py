"""Everything the simulation node publishes, in messages that are made once and filled in place."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState

from artibot_sim.estimation.odometry import Odometry as Believed
from artibot_sim.model import Robot
from artibot_sim.nodes.common.motor_publishers import JointStatePublisher, MotorPublishers, WheelJoints
from artibot_sim.nodes.common.prepared import PreparedMessage
from artibot_sim.nodes.common.qos import PUBLISHED, publisher
from artibot_sim.nodes.common.rotations import quaternion
from artibot_sim.nodes.common.transforms import FrameNames
from artibot_sim.nodes.sim.engine import TrueState
from artibot_sim.nodes.sim.sensors import SimulatedSensors
from artibot_sim.nodes.sim.transforms import SimulatedTransforms

LEAST_RATE, LEAST_ACCELERATION, LEAST_ANGLE = 1e-3, 1e-2, 1e-3
"""Standard deviations (rad/s, m/s², rad) that imu/data states at least: filters invert covariances."""

LONG_QOS = QoSProfile(depth=2000)
"""For recording at full speed: a reliable subscriber loses nothing while it is less than this behind."""


@dataclass(frozen=True)
class Published:
    """Which of the contract's topics this simulator publishes."""

    clock: bool
    long_queue: bool
    with_driver: bool
    tf: bool
    imu: bool
    station: bool
    frames: FrameNames
    gyro_deviation: float
    acceleration_deviation: float
    orientation: bool = False
    orientation_deviation: float = 0.0


class Publishers:
    """The node's publishers and their messages.

    Parameters
    ----------
    node : rclpy Node
    robot : Robot
    what : Published
    """

    def __init__(self, node: Node, robot: Robot, what: Published) -> None:
        self.what = what
        qos = LONG_QOS if what.long_queue else PUBLISHED
        self._clock = publisher(node, Clock, "/clock") if what.clock else None
        self._clock_message = PreparedMessage(self._clock, Clock())
        self._truth = publisher(node, Odometry, "ground_truth/odom", qos)
        truth = Odometry(child_frame_id=what.frames.base)  # no covariance: nothing is estimated
        truth.header.frame_id = what.frames.map
        self._truth_message = PreparedMessage(self._truth, truth)
        self._true_pose = self._truth_message.numbers("pose.pose.position.x", 7)
        self._true_twist = self._truth_message.numbers("twist.twist.linear.x", 6)
        self._wheels = None if what.with_driver else WheelJoints(robot, passive=True)
        wheels = self._wheels.names if self._wheels else ()
        joints = (*wheels, *robot.articulation_joints)
        self._bends = robot.articulated
        self._joints = publisher(node, JointState, "joint_states", qos) if joints else None
        self._joints_out = JointStatePublisher(self._joints, joints, ("position", "velocity")) if joints else None
        self._motors = None if what.with_driver else MotorPublishers(node, robot, qos, what.frames, what.tf)
        self._imu = publisher(node, Imu, "imu/data", qos) if what.imu else None
        self._imu_message = PreparedMessage(self._imu, _imu(what))
        self._orientation, self._rates, self._acceleration = (
            self._imu_message.numbers(f"{name}.x", count)
            for name, count in (("orientation", 4), ("angular_velocity", 3), ("linear_acceleration", 3))
        )
        self._station = publisher(node, PointStamped, "total_station/point", qos) if what.station else None
        point = PointStamped()
        point.header.frame_id = what.frames.map
        self._station_message = PreparedMessage(self._station, point)
        self._point = self._station_message.numbers("point.x", 3)
        self._tf = SimulatedTransforms(node, robot, what.frames, what.with_driver) if what.tf else None

    def clock_listeners(self) -> int:
        """How many subscribers /clock has, 0 when it is not published."""
        return self._clock.get_subscription_count() if self._clock else 0

    def wait_acknowledged(self, seconds: float) -> None:
        """Give reliable subscribers the time to take what they were sent, before the publishers vanish."""
        own = (self._clock, self._truth, self._joints, self._imu, self._station)
        until = time.monotonic() + seconds
        for each in (*filter(None, own), *(self._motors.publishers if self._motors else ())):
            each.wait_for_all_acked(Duration(seconds=max(0.0, until - time.monotonic())))

    def clock(self, t_ns: int) -> None:
        """Publish /clock, if it is published at all."""
        if self._clock:
            self._clock_message.publish(t_ns)

    def publish(
        self, t_ns: int, sample: TrueState, sensors: SimulatedSensors, believed: Believed, station_due: bool
    ) -> None:
        """Publish one instant on every topic; `believed` goes on by it, unless a driver has the odometry."""
        self.clock(t_ns)
        self._publish_truth(t_ns, sample)
        position = velocity = None  # with drives these measure the motors, and the driver publishes them
        if self._motors:
            position, velocity = (
                sensors.encoders(sample.motor_position),
                sensors.velocities(t_ns, sample.motor_velocity),
            )
            believed.update((float(position[0]), float(position[1])), (float(velocity[0]), float(velocity[1])))
            self._motors.torques(t_ns, position, velocity, sensors.torques(sample.motor_torque))
            self._motors.command(t_ns, sample.command, sample.motor_torque[2:])
            self._motors.odom(t_ns, believed)
        if self._joints:
            self._publish_joints(t_ns, sample, sensors, position, velocity)
        if self._imu:
            self._publish_imu(t_ns, sample, sensors)
        if self._station:
            tracked = sensors.follow(t_ns, sample.position, sample.attitude)
            if station_due:
                self._publish_station(t_ns, sensors.station(tracked))
        if self._tf:
            self._tf.publish(t_ns, sample, believed.pose)

    def _publish_truth(self, t_ns: int, sample: TrueState) -> None:
        pose, twist = self._true_pose, self._true_twist
        pose[:3], pose[3:] = sample.position, quaternion(*sample.rpy.tolist())
        twist[:3], twist[3:] = sample.velocity, sample.rates
        self._truth_message.publish(t_ns)

    def _publish_joints(
        self, t_ns: int, sample: TrueState, sensors: SimulatedSensors, position: Any, rate: Any
    ) -> None:
        angles, rates = [], []
        if self._wheels:
            free = (None, None) if sample.wheels is None else sample.wheels
            angles, rates = self._wheels.of(position.tolist(), free[0]), self._wheels.of(rate.tolist(), free[1])
        if self._bends:
            angles += sensors.articulation(sample.articulation[0]).tolist()
            rates += sample.articulation[1].tolist()
        self._joints_out.publish(t_ns, angles, rates)  # type: ignore[union-attr]

    def _publish_imu(self, t_ns: int, sample: TrueState, sensors: SimulatedSensors) -> None:
        self._rates[:], self._acceleration[:] = sensors.imu(sample.rates, sample.acceleration)
        if self.what.orientation:
            self._orientation[:] = quaternion(*sensors.orientation(sample.rpy).tolist())
        self._imu_message.publish(t_ns)

    def _publish_station(self, t_ns: int, point: Any) -> None:
        if point is None:
            return
        self._point[:] = point
        self._station_message.publish(t_ns)


def _imu(what: Published) -> Imu:
    message = Imu()
    message.header.frame_id = what.frames.base
    if what.orientation:
        message.orientation_covariance[[0, 4, 8]] = max(what.orientation_deviation, LEAST_ANGLE) ** 2
    else:
        message.orientation_covariance[0] = -1.0  # no orientation is measured (REP-145 way of saying so)
    message.angular_velocity_covariance[[0, 4, 8]] = max(what.gyro_deviation, LEAST_RATE) ** 2
    message.linear_acceleration_covariance[[0, 4, 8]] = max(what.acceleration_deviation, LEAST_ACCELERATION) ** 2
    return message
