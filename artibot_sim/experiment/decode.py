"""From messages to rows: which columns each message type gives, and how rows become a `Channel`."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import repeat
from typing import Any

import numpy as np

from artibot_sim.experiment.columns import Channel, Floats

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


def _twist(twist: Any) -> dict[str, float]:
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


def _imu(message: Any) -> dict[str, float]:
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


def _diagnostics(message: Any) -> dict[str, float]:
    return {f"{s.name}.level": float(s.level if isinstance(s.level, int) else s.level[0]) for s in message.status}


ONE_ROW: dict[str, Callable[[Any], dict[str, float]]] = {
    "sensor_msgs/msg/JointState": _joints,
    "nav_msgs/msg/Odometry": lambda m: {**_pose(m.pose.pose), **_twist(m.twist.twist)},
    "geometry_msgs/msg/PoseStamped": lambda m: _pose(m.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _pose(m.pose.pose),
    "geometry_msgs/msg/PointStamped": lambda m: _position(m.point),
    "geometry_msgs/msg/TwistStamped": lambda m: _twist(m.twist),
    "geometry_msgs/msg/Twist": _twist,
    "sensor_msgs/msg/Imu": _imu,
    "rosgraph_msgs/msg/Clock": lambda m: {"clock": time_ns(m.clock) / 1e9},
    "diagnostic_msgs/msg/DiagnosticArray": _diagnostics,
}
MANY_ROWS: dict[str, Callable[[Any], list[Row]]] = {
    "trajectory_msgs/msg/JointTrajectory": _trajectory,
    "nav_msgs/msg/Path": _path,
}
READABLE = frozenset(ONE_ROW) | frozenset(MANY_ROWS)


@dataclass
class Rows:
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
        else:
            row = ONE_ROW[ros_type](message)
            header = getattr(message, "header", None)
            stamp = time_ns(message.clock) if ros_type.endswith("Clock") else time_ns(header.stamp) if header else 0
            self.unstamped += header is not None and stamp == 0
            self.mismatched += ros_type.endswith("JointState") and _mismatched(message)
            self._append(stamp or log_ns, log_ns, row)
        self.messages += 1

    def _append(self, stamp: int, log_ns: int, row: dict[str, float]) -> None:
        self.stamps.append(stamp)
        self.received.append(log_ns)
        for name, value in row.items():
            column = self.values.get(name)
            if column is None:
                column = self.values[name] = array("d")
            if len(column) < len(self.stamps) - 1:
                self._fill(column, len(self.stamps) - 1)
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
        clashes |= np.bincount(group[finite], minlength=len(clashes)) > 1
        merged[name] = out
    if clashes.any():
        remarks.append(f"{topic}: {int(clashes.sum())} stamps occur twice with the same quantities; the later rules")
    return stamps[fresh], received[fresh], merged
