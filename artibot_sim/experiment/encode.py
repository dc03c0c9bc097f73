"""From columns to messages: the inverse of `decode`, for bags that are written without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.contract import Topic
from artibot_sim.experiment.messages import message_class, serialize

Columns = Mapping[str, Floats]
_FRAMES = {  # frame_id and child_frame_id
    "odom": ("odom", "base_link"),
    "ground_truth_odom": ("map", "base_link"),
    "planned_odom": ("map", "base_link"),
    "planned_path": ("map", ""),
    "total_station": ("map", ""),
    "imu": ("base_link", ""),
    "cmd_vel": ("base_link", ""),
}


def encoder(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
    """Return a function (row, stamp in ns) → CDR bytes of `topic`'s message.

    Parameters
    ----------
    topic : of a type with one row a message.
    columns : name → (n,) array; what a message has and the columns lack is NaN (JointState: left empty).

    Raises
    ------
    ArtibotError
        If artibot has no writer for the topic's type.
    """
    try:
        make = _ENCODERS[topic.ros_type]
    except KeyError:
        raise ArtibotError(f"topic {topic.name}: no writer for type {topic.ros_type}") from None
    return make(topic, columns)


@cache
def _classes(*names: str) -> tuple[type, ...]:
    return tuple(message_class(name) for name in names)


def stamp_message(stamp_ns: int) -> Any:
    """Return a builtin_interfaces Time."""
    (time,) = _classes("builtin_interfaces/msg/Time")
    return time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def header(stamp_ns: int, frame: str = "") -> Any:
    """Return a std_msgs Header."""
    (make,) = _classes("std_msgs/msg/Header")
    return make(stamp=stamp_message(stamp_ns), frame_id=frame)


def pose(x: float, y: float, z: float, roll: float, pitch: float, yaw: float) -> Any:
    """Return a geometry_msgs Pose from metres and radians; NaN angles count as 0."""
    make, point, quaternion = _classes(
        "geometry_msgs/msg/Pose", "geometry_msgs/msg/Point", "geometry_msgs/msg/Quaternion"
    )
    r, p, w = ((angle if math.isfinite(angle) else 0.0) / 2.0 for angle in (roll, pitch, yaw))
    cr, sr, cp, sp, cw, sw = math.cos(r), math.sin(r), math.cos(p), math.sin(p), math.cos(w), math.sin(w)
    turn = quaternion(
        x=sr * cp * cw - cr * sp * sw,
        y=cr * sp * cw + sr * cp * sw,
        z=cr * cp * sw - sr * sp * cw,
        w=cr * cp * cw + sr * sp * sw,
    )
    return make(position=point(x=x, y=y, z=z), orientation=turn)


def vector(x: float, y: float, z: float) -> Any:
    """Return a geometry_msgs Vector3."""
    (make,) = _classes("geometry_msgs/msg/Vector3")
    return make(x=x, y=y, z=z)


def _picker(columns: Columns, names: tuple[str, ...], absent: float) -> Callable[[int], list[float]]:
    """Return row → the values of `names`, `absent` for those without a column."""
    found = [columns.get(name) for name in names]
    return lambda row: [absent if values is None else float(values[row]) for values in found]


_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_TWIST = ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")


def _odometry(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
    with_pose, with_twist, twist = _classes(
        "geometry_msgs/msg/PoseWithCovariance", "geometry_msgs/msg/TwistWithCovariance", "geometry_msgs/msg/Twist"
    )
    frame, child = _FRAMES[topic.key]
    where, moving = _picker(columns, _POSE, 0.0), _picker(columns, _TWIST, 0.0)
    unknown = np.zeros(36)

    def encode(row: int, stamp_ns: int) -> bytes:
        rates = moving(row)
        return serialize(
            topic.ros_type,
            header=header(stamp_ns, frame),
            child_frame_id=child,
            pose=with_pose(pose=pose(*where(row)), covariance=unknown),
            twist=with_twist(twist=twist(linear=vector(*rates[:3]), angular=vector(*rates[3:])), covariance=unknown),
        )

    return encode


def _joint_state(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
    """Write the joints named in the columns; NaN where one lacks a quantity that others have."""
    joints = list(dict.fromkeys(name.rpartition(".")[0] for name in columns))
    tables = {}
    for quantity in ("position", "velocity", "effort"):
        found = [columns.get(f"{joint}.{quantity}") for joint in joints]
        size = len(next(iter(columns.values()), ()))
        blank = np.full(size, np.nan)
        present = any(values is not None for values in found)
        stacked = np.column_stack([blank if values is None else values for values in found]) if present else None
        tables[quantity] = np.empty((size, 0)) if stacked is None else stacked

    def encode(row: int, stamp_ns: int) -> bytes:
        return serialize(
            topic.ros_type, header=header(stamp_ns), name=joints, **{key: table[row] for key, table in tables.items()}
        )

    return encode


def _imu(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
    (quaternion,) = _classes("geometry_msgs/msg/Quaternion")
    rates = _picker(columns, _TWIST[3:], 0.0)
    accelerations = _picker(columns, ("ax", "ay", "az"), 0.0)
    unknown = np.zeros(9)
    none = np.array([-1.0] + [0.0] * 8)  # -1: this sensor gives no orientation

    def encode(row: int, stamp_ns: int) -> bytes:
        return serialize(
            topic.ros_type, header=header(stamp_ns, "base_link"),
            orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0), orientation_covariance=none,
            angular_velocity=vector(*rates(row)), angular_velocity_covariance=unknown,
            linear_acceleration=vector(*accelerations(row)), linear_acceleration_covariance=unknown,
        )  # fmt: skip

    return encode


def _point(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
    (point,) = _classes("geometry_msgs/msg/Point")
    where = _picker(columns, _POSE[:3], 0.0)

    def encode(row: int, stamp_ns: int) -> bytes:
        x, y, z = where(row)
        return serialize(topic.ros_type, header=header(stamp_ns, "map"), point=point(x=x, y=y, z=z))

    return encode


def _twist(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
    (twist,) = _classes("geometry_msgs/msg/Twist")
    moving = _picker(columns, _TWIST, 0.0)

    def encode(row: int, stamp_ns: int) -> bytes:
        rates = moving(row)
        made = twist(linear=vector(*rates[:3]), angular=vector(*rates[3:]))
        return serialize(topic.ros_type, header=header(stamp_ns, "base_link"), twist=made)

    return encode


_ENCODERS = {
    "nav_msgs/msg/Odometry": _odometry,
    "sensor_msgs/msg/JointState": _joint_state,
    "sensor_msgs/msg/Imu": _imu,
    "geometry_msgs/msg/PointStamped": _point,
    "geometry_msgs/msg/TwistStamped": _twist,
}


def path_message(stamp_ns: int, stamps: list[int], poses: Floats) -> bytes:
    """Return a nav_msgs Path: poses (n, 3) of x, y (m), yaw (rad) in `map`, with their stamps in ns."""
    (stamped,) = _classes("geometry_msgs/msg/PoseStamped")
    made = [
        stamped(header=header(stamp, "map"), pose=pose(x, y, 0.0, 0.0, 0.0, yaw))
        for stamp, (x, y, yaw) in zip(stamps, poses.tolist(), strict=True)
    ]
    return serialize("nav_msgs/msg/Path", header=header(stamp_ns, "map"), poses=made)


def trajectory_message(
    start_ns: int, joints: list[str], after_ns: list[int], position: Floats, velocity: Floats
) -> bytes:
    """Return a JointTrajectory: its absolute start, times since then in ns, (n, joints) rad and rad/s."""
    point, duration = _classes("trajectory_msgs/msg/JointTrajectoryPoint", "builtin_interfaces/msg/Duration")
    empty = np.empty(0)
    points = [
        point(
            positions=position[row], velocities=velocity[row], accelerations=empty, effort=empty,
            time_from_start=duration(sec=after // 1_000_000_000, nanosec=after % 1_000_000_000),
        )
        for row, after in enumerate(after_ns)
    ]  # fmt: skip
    return serialize("trajectory_msgs/msg/JointTrajectory", header=header(start_ns), joint_names=joints, points=points)
