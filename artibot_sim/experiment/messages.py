"""ROS messages without ROS: CDR in and out by rosbags' Jazzy types, messages to columns, and columns to messages."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Channel, Floats
from artibot_sim.experiment.topics import Topic

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

# ----------------------------------------------------------------------
# ROS message types without ROS: CDR in and out, definitions and type hashes, by rosbags' Jazzy types.
# ----------------------------------------------------------------------


Decoder = Callable[[bytes], Any]

CAN_FRAME = "can_msgs/msg/Frame"
"""One frame of a CAN bus; its package is not among those that come with every ROS 2."""

_OWN = {
    CAN_FRAME: (
        "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\nuint8[8] data\n"
    )
}
"""Definitions of types beyond Jazzy's common messages that artibot writes itself."""


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy and the few of `_OWN` (shared, not to be registered into)."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _OWN.items():
        store.register(get_types_from_msg(text, name))
    return store


def is_known(ros_type: str) -> bool:
    """Say whether artibot knows `ros_type` without a recording's definition of it."""
    return ros_type in typestore().fielddefs


@cache
def definition(ros_type: str) -> tuple[str, str]:
    """Return the `ros2msg` text and the RIHS01 hash of a type.

    Raises
    ------
    ArtibotError
        If the type is not one of Jazzy's common messages.
    """
    store = typestore()
    if ros_type not in store.fielddefs:
        raise ArtibotError(
            f"message type '{ros_type}' is not one of Jazzy's common messages; pass its definition when registering it"
        )
    return store.generate_msgdef(ros_type, ros_version=2)[0], store.hash_rihs01(ros_type)


def message_class(ros_type: str) -> type:
    """Return the class of a type, e.g. `message_class("std_msgs/msg/Header")`."""
    definition(ros_type)
    return typestore().types[ros_type]


def serialize(ros_type: str, **fields: Any) -> bytes:
    """Build a message and write it as little-endian CDR.

    Parameters
    ----------
    ros_type : e.g. `sensor_msgs/msg/JointState`.
    **fields : every field of the message; arrays as numpy arrays, nested messages made by `message_class`.

    Raises
    ------
    ArtibotError
        If the type is unknown, or the fields do not fit it.
    """
    make = message_class(ros_type)
    try:
        message = make(**fields)
        return bytes(typestore().serialize_cdr(message, ros_type, little_endian=True))
    except (TypeError, ValueError, AttributeError) as error:
        raise ArtibotError(f"fields {sorted(fields)} do not make a {ros_type}: {error}") from error


def decoder(ros_type: str, text: str = "", encoding: str = "ros2msg", type_hash: str = "") -> Decoder:
    """Return a function that turns CDR bytes into message objects.

    Parameters
    ----------
    ros_type : name of the type.
    text, encoding : the definition stored in the recording (`ros2msg` or `ros2idl`), if any.
    type_hash : RIHS01 hash stored in the recording, if any.

    Returns
    -------
    callable
        Raises `rosbags.serde.SerdeError` on bytes that are not such a message.

    Notes
    -----
    The recording's own definition rules where it differs from Jazzy's, so a type changed in another
    distribution, or unknown here, decodes as it was written.

    Raises
    ------
    ArtibotError
        If the type is unknown and the recording has no readable definition of it.
    """
    store = typestore()
    known = ros_type in store.fielddefs
    if known and (not text or type_hash == definition(ros_type)[1]):
        return lambda data: store.deserialize_cdr(data, ros_type)
    own = _store_from(ros_type, text, encoding)
    if known and all(own.fielddefs[name][1] == entry[1] for name, entry in store.fielddefs.items()):
        own = store  # the same messages: the shared store's generated code is already there
    return lambda data: own.deserialize_cdr(data, ros_type)


def _store_from(ros_type: str, text: str, encoding: str) -> Typestore:
    """Make a store of the one type described by `text`, and of the types inside it."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg
    from rosbags.typesys.base import TypesysError
    from rosbags.typesys.store import Typestore

    if not text:
        raise ArtibotError(f"message type '{ros_type}' is unknown and the recording holds no definition of it")
    store = Typestore()
    try:
        types = get_types_from_idl(text) if encoding == "ros2idl" else get_types_from_msg(text, ros_type)
        missing = {name: entry for name, entry in typestore().fielddefs.items() if name not in types}
        store.register(missing | types)
    except (TypesysError, KeyError, SyntaxError) as error:
        raise ArtibotError(f"the recording's definition of '{ros_type}' is not {encoding}: {error}") from error
    if ros_type not in store.fielddefs:
        raise ArtibotError(f"the recording's definition of '{ros_type}' does not define that type")
    return store


# ----------------------------------------------------------------------
# From messages to rows: which columns each message type gives, and how rows become a `Channel`.
# ----------------------------------------------------------------------


Row = tuple[int, dict[str, float]]
"""Header stamp in ns (0: none) and the quantities of one row."""

_UNITS = {
    "x": "m", "y": "m", "z": "m", "roll": "rad", "pitch": "rad", "yaw": "rad",
    "vx": "m/s", "vy": "m/s", "vz": "m/s", "roll_rate": "rad/s", "pitch_rate": "rad/s", "yaw_rate": "rad/s",
    "ax": "m/s^2", "ay": "m/s^2", "az": "m/s^2", "clock": "s", "message": "1", "level": "1", "time_from_start": "s",
    "position": "rad", "velocity": "rad/s", "effort": "N·m", "acceleration": "rad/s^2",
}  # fmt: skip


def unit_of(column: str) -> str:
    """Return the unit of a column: that of its last word, `front_right.velocity` → rad/s."""
    return _UNITS[column.rpartition(".")[2]]


def time_ns(stamp: Any) -> int:
    """Return a builtin_interfaces Time or Duration in ns."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def euler(q: Any) -> tuple[float, float, float]:
    """Return roll, pitch, yaw (rad) of a quaternion message; NaN where it is not a rotation.

    An all-zero quaternion is how messages say "no orientation".
    """
    x, y, z, w = q.x, q.y, q.z, q.w
    norm = x * x + y * y + z * z + w * w
    if not 1e-12 < norm < math.inf:
        return math.nan, math.nan, math.nan
    roll = math.atan2(2 * (w * x + y * z), norm - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x) / norm)))
    return roll, pitch, math.atan2(2 * (w * z + x * y), norm - 2 * (y * y + z * z))


def _position(point: Any) -> dict[str, float]:
    return {"x": point.x, "y": point.y, "z": point.z}


def _pose(pose: Any) -> dict[str, float]:
    roll, pitch, yaw = euler(pose.orientation)
    return {**_position(pose.position), "roll": roll, "pitch": pitch, "yaw": yaw}


def _twist_columns(twist: Any) -> dict[str, float]:
    linear, angular = twist.linear, twist.angular
    return {"vx": linear.x, "vy": linear.y, "vz": linear.z,
            "roll_rate": angular.x, "pitch_rate": angular.y, "yaw_rate": angular.z}  # fmt: skip


def _joints(message: Any) -> dict[str, float]:
    """Return `<joint>.position`, `.velocity`, `.effort`; a field that is empty or NaN is not measured."""
    row: dict[str, float] = {}
    names = message.name
    for quantity in ("position", "velocity", "effort"):
        values = getattr(message, quantity)
        if len(values) == len(names):
            row.update(zip((f"{name}.{quantity}" for name in names), values.tolist(), strict=True))
    return row


def _imu_columns(message: Any) -> dict[str, float]:
    rate, acceleration = message.angular_velocity, message.linear_acceleration
    row = {"roll_rate": rate.x, "pitch_rate": rate.y, "yaw_rate": rate.z,
           "ax": acceleration.x, "ay": acceleration.y, "az": acceleration.z}  # fmt: skip
    if message.orientation_covariance[0] != -1.0:  # -1: the sensor gives no orientation
        row.update(zip(("roll", "pitch", "yaw"), euler(message.orientation), strict=True))
    return row


def _trajectory(message: Any) -> list[Row]:
    start = time_ns(message.header.stamp)
    rows = []
    for point in message.points:
        after = time_ns(point.time_from_start)
        row = {"time_from_start": after / 1e9}
        for quantity, values in (("position", point.positions), ("velocity", point.velocities),
                                 ("acceleration", point.accelerations), ("effort", point.effort)):  # fmt: skip
            if len(values) == len(message.joint_names):
                row.update(zip((f"{name}.{quantity}" for name in message.joint_names), values.tolist(), strict=True))
        rows.append((start + after, row))
    return rows


def _path(message: Any) -> list[Row]:
    return [(time_ns(p.header.stamp) or time_ns(message.header.stamp), _pose(p.pose)) for p in message.poses]


def _transforms(message: Any) -> list[Row]:
    """Return `<parent>><child>.x`, `.y`, `.yaw` of each transform, a row each."""
    rows = []
    for each in message.transforms:
        name = f"{each.header.frame_id.strip('/')}>{each.child_frame_id.strip('/')}"
        shift, yaw = each.transform.translation, euler(each.transform.rotation)[2]
        rows.append((time_ns(each.header.stamp), {f"{name}.x": shift.x, f"{name}.y": shift.y, f"{name}.yaw": yaw}))
    return rows


def _diagnostics(message: Any) -> dict[str, float]:
    return {f"{s.name}.level": float(s.level if isinstance(s.level, int) else s.level[0]) for s in message.status}


ONE_ROW: dict[str, Callable[[Any], dict[str, float]]] = {
    "sensor_msgs/msg/JointState": _joints,
    "nav_msgs/msg/Odometry": lambda m: {**_pose(m.pose.pose), **_twist_columns(m.twist.twist)},
    "geometry_msgs/msg/PoseStamped": lambda m: _pose(m.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _pose(m.pose.pose),
    "geometry_msgs/msg/PointStamped": lambda m: _position(m.point),
    "geometry_msgs/msg/TwistStamped": lambda m: _twist_columns(m.twist),
    "geometry_msgs/msg/Twist": _twist_columns,
    "sensor_msgs/msg/Imu": _imu_columns,
    "rosgraph_msgs/msg/Clock": lambda m: {"clock": time_ns(m.clock) / 1e9},
    "diagnostic_msgs/msg/DiagnosticArray": _diagnostics,
}
MANY_ROWS: dict[str, Callable[[Any], list[Row]]] = {
    "trajectory_msgs/msg/JointTrajectory": _trajectory,
    "nav_msgs/msg/Path": _path,
}
READABLE = frozenset(ONE_ROW) | frozenset(MANY_ROWS)
TRANSFORMS = "tf2_msgs/msg/TFMessage"
"""Type that is read where a pose is to be made of it."""
POSES = frozenset(
    {"nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"}
)
"""Types that have a heading."""
_MOTION = POSES | {"geometry_msgs/msg/PointStamped", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"}
"""Types that tell where something is, or how it moves."""


def serves_as(ros_type: str, wanted: str) -> bool:
    """Whether messages of a type tell quantities for which those of another are wanted: a PoseStamped an Odometry's."""
    return ros_type in READABLE and (ros_type == wanted or {ros_type, wanted} <= _MOTION)


@dataclass
class TopicRows:
    """Rows of one topic while a recording is being read: as columns, for two hours of it are gigabytes of mappings.

    Attributes
    ----------
    topic : name in the recording.
    ordered : whether rows are samples in time; planned paths and profiles are kept as they came.
    """

    topic: str
    ordered: bool = True
    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    values: dict[str, array[float]] = field(default_factory=dict)
    messages: int = 0
    unstamped: int = 0
    mismatched: int = 0

    def add(self, ros_type: str, message: Any, log_ns: int) -> None:
        """Append what a message says; without a header stamp the time of reception stands in."""
        if ros_type in MANY_ROWS:
            self.ordered = False
            for stamp, row in MANY_ROWS[ros_type](message):
                self._append(stamp, log_ns, {**row, "message": float(self.messages)})
        elif ros_type == TRANSFORMS:
            for stamp, row in _transforms(message):
                self._append(stamp or log_ns, log_ns, row)
        else:
            row = ONE_ROW[ros_type](message)
            header = getattr(message, "header", None)
            stamp = time_ns(message.clock) if ros_type.endswith("Clock") else time_ns(header.stamp) if header else 0
            self.unstamped += header is not None and stamp == 0
            self.mismatched += ros_type.endswith("JointState") and _mismatched(message)
            self._append(stamp or log_ns, log_ns, row)
        self.messages += 1

    def _append(self, stamp: int, log_ns: int, row: dict[str, float]) -> None:
        before, values = len(self.stamps), self.values
        self.stamps.append(stamp)
        self.received.append(log_ns)
        for name, value in row.items():
            column = values.get(name)
            if column is None:
                column = values[name] = array("d")
            if len(column) < before:
                self._fill(column, before)
            column.append(value)

    @staticmethod
    def _fill(column: array[float], length: int) -> None:
        """NaN for the rows that lacked the quantity."""
        column.extend(repeat(math.nan, length - len(column)))

    def channel(self, remarks: list[str]) -> Channel:
        """Return the rows as a channel whose `t` still counts from 1970; add what was repaired to `remarks`."""
        stamps = np.array(self.stamps, np.int64)
        received = np.array(self.received, np.int64)
        columns = self._columns()
        if self.unstamped:
            remarks.append(f"{self.topic}: {self.unstamped} messages without a header stamp; reception times are used")
        if self.mismatched:
            remarks.append(f"{self.topic}: {self.mismatched} messages with a field not as long as its names; left out")
        if self.ordered:
            stamps, received, columns = _in_order(self.topic, stamps, received, columns, remarks)
        units = {name: unit_of(name) for name in columns}
        return Channel(self.topic, stamps, stamps / 1e9, received, columns, units)

    def _columns(self) -> dict[str, Floats]:
        """Return arrays, NaN where a row lacked the name; a joint's quantity never measured is left out."""
        columns = {}
        for name in list(self.values):
            column = self.values.pop(name)
            self._fill(column, len(self.stamps))
            values = np.array(column)
            if "." not in name or np.isfinite(values).any():
                columns[name] = values
        return columns


def _mismatched(message: Any) -> bool:
    lengths = {len(message.position), len(message.velocity), len(message.effort)}
    return bool(lengths - {0, len(message.name)})


def _in_order(
    topic: str, stamps: np.ndarray, received: np.ndarray, columns: dict[str, Floats], remarks: list[str]
) -> tuple[np.ndarray, np.ndarray, dict[str, Floats]]:
    """Sort by stamp and merge rows of equal stamp; where both carry a quantity the later one rules.

    Several who publish a part each may well come in another order than their stamps; one who does so is remarked on.
    """
    if (np.diff(stamps) < 0).any():
        late = max(((np.diff(stamps[np.isfinite(each)]) < 0).sum() for each in columns.values()), default=0)
        order = np.argsort(stamps, kind="stable")
        stamps, received = stamps[order], received[order]
        columns = {name: values[order] for name, values in columns.items()}
        if late:
            remarks.append(f"{topic}: {late} messages out of order; sorted by stamp")
    fresh = np.concatenate(([True], np.diff(stamps) > 0)) if len(stamps) else np.empty(0, bool)
    if fresh.all():
        return stamps, received, columns
    group = np.cumsum(fresh) - 1
    merged, clashes = {}, np.zeros(int(fresh.sum()), bool)
    for name, values in columns.items():
        finite = np.flatnonzero(np.isfinite(values))
        out = np.full(len(clashes), np.nan)
        out[group[finite]] = values[finite]
        clashes[group[finite][values[finite] != out[group[finite]]]] = True  # repeated values are no contradiction
        merged[name] = out
    if clashes.any():
        many = int(clashes.sum())
        said = "1 stamp occurs" if many == 1 else f"{many} stamps occur"
        remarks.append(f"{topic}: {said} twice, with different values; the later one is taken")
    return stamps[fresh], received[fresh], merged


# ----------------------------------------------------------------------
# From columns to messages: the inverse of `decode`, for bags that are written without ROS.
# ----------------------------------------------------------------------


Columns = Mapping[str, Floats]
_FRAMES = {  # frame_id and child_frame_id
    "odom": ("odom", "base_link"),
    "odom_model": ("odom", "base_link"),
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


def _imu_message(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
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


def _twist_message(topic: Topic, columns: Columns) -> Callable[[int, int], bytes]:
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
    "sensor_msgs/msg/Imu": _imu_message,
    "geometry_msgs/msg/PointStamped": _point,
    "geometry_msgs/msg/TwistStamped": _twist_message,
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
