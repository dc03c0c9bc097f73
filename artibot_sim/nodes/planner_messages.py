"""A plan as ROS messages."""

from __future__ import annotations

import math
from array import array

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from artibot_sim.model import MOTORS
from artibot_sim.planning import Plan

SECOND = 1_000_000_000


def stamp(t_ns: int) -> Time:
    """A time stamp from nanoseconds."""
    return Time(sec=t_ns // SECOND, nanosec=t_ns % SECOND)


def pose(x: float, y: float, yaw: float) -> Pose:
    """A pose in the plane (m, m, rad)."""
    turned = Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return Pose(position=Point(x=x, y=y, z=0.0), orientation=turned)


def front_velocity(plan: Plan, start_ns: int) -> JointTrajectory:
    """The front motors' profile: a point each `plan.dt`, positions from 0 and velocities, motor-side.

    Parameters
    ----------
    plan : Plan
    start_ns : int
        Absolute time of the first point, ns.
    """
    message = JointTrajectory(header=Header(stamp=stamp(start_ns)), joint_names=list(MOTORS[:2]))
    times = np.round(plan.t * SECOND).astype(np.int64).tolist()
    rows = zip(times, plan.position.tolist(), plan.velocity.tolist(), strict=True)
    message.points = [
        JointTrajectoryPoint(
            positions=array("d", position),
            velocities=array("d", velocity),
            time_from_start=Duration(sec=t // SECOND, nanosec=t % SECOND),
        )
        for t, position, velocity in rows
    ]
    return message


def path(plan: Plan, start_ns: int, interval: float, frame: str) -> Path:
    """The planned path: a pose each `interval` seconds and one at the end, each with the time it is planned for."""
    times = np.append(np.arange(0.0, plan.duration - 1e-6, interval), plan.duration)
    message = Path(header=Header(stamp=stamp(start_ns), frame_id=frame))
    stamps = (start_ns + np.round(times * SECOND).astype(np.int64)).tolist()
    message.poses = [
        PoseStamped(header=Header(stamp=stamp(t), frame_id=frame), pose=pose(*row))
        for t, row in zip(stamps, plan.at(times).pose.tolist(), strict=True)
    ]
    return message


def odometry(plan: Plan, t: float, now_ns: int, frames: tuple[str, str]) -> Odometry:
    """The planned pose and twist at `t` seconds after the start, stamped `now_ns`; `frames` are of pose and twist."""
    sample = plan.at(t)
    message = Odometry(header=Header(stamp=stamp(now_ns), frame_id=frames[0]), child_frame_id=frames[1])
    message.pose.pose = pose(*sample.pose[0].tolist())
    message.twist.twist.linear.x, message.twist.twist.angular.z = sample.twist[0].tolist()
    return message
