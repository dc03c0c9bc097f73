"""Columns files: which column of a log is which quantity, in which unit; read for an import, written by an export."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from artibot_sim.documents import did_you_mean, load_document
from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Experiment
from artibot_sim.experiment.messages import unit_of
from artibot_sim.experiment.rollout_bag import START_NS
from artibot_sim.experiment.topics import BY_KEY, Topic, find_topic
from artibot_sim.model import MOTORS

STAMP = "stamp"
"""Column of the header stamp, ns, in tables that artibot writes."""

METADATA = ("robot", "kappa", "surface", "operator", "description")
"""Keys of a columns file that go into the recording's record."""

_TURN = 2.0 * math.pi
UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ft": 0.3048, "in": 0.0254},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turn": _TURN},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704},
    "rad/s": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.pi / 180, "rpm": _TURN / 60, "turn/s": _TURN},
    "m/s^2": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.80665},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180},
    "N·m": {"N·m": 1.0, "N m": 1.0, "Nm": 1.0, "mN·m": 1e-3, "mNm": 1e-3, "N·cm": 1e-2, "Ncm": 1e-2},
}
"""SI unit → the units that a column may have, as factors."""

_COUNTS = {"rad": "count", "rad/s": "count/s"}
"""SI unit → the unit of an encoder's counts, which needs `per_turn`."""
_TIMES = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
"""Unit of a time → ns."""
_DATES = "iso8601"
_ENTRY = ("column", "unit", "scale", "offset", "per_turn", "from")

_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_TWIST = ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")
_FIELDS = {
    "nav_msgs/msg/Odometry": (*_POSE, *_TWIST),
    "sensor_msgs/msg/Imu": ("roll_rate", "pitch_rate", "yaw_rate", "ax", "ay", "az"),
    "geometry_msgs/msg/PointStamped": ("x", "y", "z"),
    "geometry_msgs/msg/TwistStamped": _TWIST,
}
"""Type → columns that its message can carry."""
NEEDED = {
    "nav_msgs/msg/Odometry": ("x", "y", "yaw"),
    "sensor_msgs/msg/Imu": ("yaw_rate",),
    "geometry_msgs/msg/PointStamped": ("x", "y"),
    "geometry_msgs/msg/TwistStamped": ("vx", "yaw_rate"),
}
"""Type → columns without which the message would claim what nobody measured."""
SILENT = {
    "nav_msgs/msg/Odometry": _TWIST,
    "sensor_msgs/msg/Imu": ("roll_rate", "pitch_rate", "ax", "ay", "az"),
}
"""Type → columns that are written as NaN where the log has none: zero would be a measurement."""
_JOINTS = "sensor_msgs/msg/JointState"
_QUANTITIES = ("position", "velocity", "effort")
_ANY_JOINT = "joint_states"


def quantities_of(topic: Topic) -> Callable[[str], bool]:
    """Return a function that says whether a bag's `topic` can be written with a column of some name."""
    if topic.ros_type != _JOINTS:
        return lambda name: name in _FIELDS.get(topic.ros_type, ())

    def of_a_joint(name: str) -> bool:
        joint, _, quantity = name.rpartition(".")
        return quantity in _QUANTITIES and (joint in MOTORS or (topic.key == _ANY_JOINT and joint != ""))

    return of_a_joint


@dataclass(frozen=True)
class ColumnSource:
    """Where a quantity comes from.

    Attributes
    ----------
    key : path in the columns file, for messages.
    column : name in the source.
    factor, offset : SI value = factor × (column + offset).
    source : name of the file or topic; empty where the column is looked for in all.
    """

    key: str
    column: str
    factor: float
    offset: float
    source: str


@dataclass(frozen=True)
class Times:
    """The column of the time: its name, and ns per unit, 0 for dates."""

    column: str
    ns: float


@dataclass(frozen=True)
class ColumnsFile:
    """What a columns file says.

    Attributes
    ----------
    time : of all topics that name none; None where only bags are read.
    start_ns : when time 0 was, ns.
    metadata : strings of the recording's record.
    topics : topic → quantity → where it comes from.
    times : topic → its own column of the time.
    """

    time: Times | None
    start_ns: int
    metadata: Mapping[str, str]
    topics: Mapping[Topic, Mapping[str, ColumnSource]]
    times: Mapping[Topic, Times]


def load_columns(path: Path | str) -> ColumnsFile:
    """Read a columns file, by path or by the name of a shipped one.

    Raises
    ------
    ArtibotError
        Naming file and key, what was found and what was expected.
    """
    return load_document("columns", path, "columns", lambda document, _: _columns(document))


def _columns(document: Any) -> ColumnsFile:
    top = _mapping(document, "the file")
    _known(top, ("time", "start", "topics", *METADATA), "")
    if not isinstance(top.get("topics"), Mapping) or not top["topics"]:
        raise ArtibotError("topics: missing; expected topics, each with its quantities, as in config/columns")
    topics: dict[Topic, dict[str, ColumnSource]] = {}
    times: dict[Topic, Times] = {}
    for name, node in top["topics"].items():
        topic = find_topic(name)
        if topic.ros_type not in (*_FIELDS, _JOINTS):
            raise ArtibotError(f"topics.{name}: a {topic.ros_type} cannot be made from columns")
        entries = dict(_mapping(node, f"topics.{name}"))
        if "time" in entries:
            times[topic] = _times(entries.pop("time"), f"topics.{name}.time")
        source = str(entries.pop("from", ""))
        topics[topic] = {key: _entry(topic, key, each, source) for key, each in entries.items()}
        lacks = [key for key in NEEDED.get(topic.ros_type, ()) if key not in entries]
        if lacks or not entries:
            mend = "; points without a heading belong to /total_station/point" if lacks == ["yaw"] else ""
            raise ArtibotError(f"topics.{name}: {', '.join(lacks) or 'a quantity'} missing{mend}")
    time = _times(top["time"], "time") if "time" in top else None
    metadata = {key: str(top[key]) for key in METADATA if key in top}
    return ColumnsFile(time, _start(top.get("start")), metadata, topics, times)


def _entry(topic: Topic, name: str, node: Any, source: str) -> ColumnSource:
    key = f"topics.{topic.name}.{name}"
    if not quantities_of(topic)(name):
        expected = ", ".join(_FIELDS.get(topic.ros_type, (*(f"{m}.velocity" for m in MOTORS), "… .position, .effort")))
        raise ArtibotError(f"{key}: unknown quantity; expected one of {expected}")
    entry, si = _mapping(node, key), unit_of(name)
    _known(entry, _ENTRY, f"{key}.")
    for part in ("column", "unit"):
        if part not in entry:
            raise ArtibotError(f"{key}.{part}: missing; expected {{column: NAME, unit: {si}}}")
    unit, counts = str(entry["unit"]), _COUNTS.get(si)
    if unit == counts:
        per_turn = _number(entry.get("per_turn"), f"{key}.per_turn")
        if per_turn <= 0:
            raise ArtibotError(f"{key}.per_turn: found {per_turn:g}, expected the counts of one turn")
        factor = _TURN / per_turn
    elif unit in UNITS[si]:
        factor = UNITS[si][unit]
    else:
        known = (*UNITS[si], *([counts] if counts else []))
        raise ArtibotError(f"{key}.unit: found '{unit}'{did_you_mean(unit, known)}; expected one of {', '.join(known)}")
    scale, offset = (_number(entry.get(part, value), f"{key}.{part}") for part, value in (("scale", 1), ("offset", 0)))
    return ColumnSource(key, str(entry["column"]), factor * scale, offset, str(entry.get("from", source)))


def _times(node: Any, key: str) -> Times:
    entry = _mapping(node, key)
    _known(entry, ("column", "unit"), f"{key}.")
    unit = str(entry.get("unit", ""))
    if "column" not in entry or unit not in (*_TIMES, _DATES):
        raise ArtibotError(
            f"{key}: found {dict(entry)}, expected {{column: NAME, unit: {', '.join(_TIMES)} or {_DATES}}}"
        )
    return Times(str(entry["column"]), _TIMES.get(unit, 0.0))


def _start(value: Any) -> int:
    """Return ns since 1970 of a date, START_NS if there is none."""
    if value is None:
        return START_NS
    if isinstance(value, str):
        try:
            value = datetime.datetime.fromisoformat(value.replace("Z", "+00:00"))
        except ValueError as error:
            raise ArtibotError(f"start: found '{value}', expected a date such as 2026-05-04T10:00:00Z") from error
    if not isinstance(value, datetime.datetime):
        raise ArtibotError(f"start: found {value!r}, expected a date such as 2026-05-04T10:00:00Z")
    zoned = value if value.tzinfo else value.replace(tzinfo=datetime.timezone.utc)
    return round(zoned.timestamp() * 1e6) * 1000


def _mapping(node: Any, key: str) -> Mapping[str, Any]:
    if not isinstance(node, Mapping):
        raise ArtibotError(f"{key}: found {node!r}, expected a mapping of keys")
    return node


def _known(node: Mapping[str, Any], keys: Sequence[str], path: str) -> None:
    for key in node:
        if key not in keys:
            raise ArtibotError(f"{path}{key}: unknown key{did_you_mean(key, keys)}; expected one of {', '.join(keys)}")


def _number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ArtibotError(f"{key}: found {value!r}, expected a number")
    return float(value)


def columns_file(experiment: Experiment, form: str) -> str:
    """Return the columns file of an exported recording; what `artibot import` cannot write is not in it."""
    topics: dict[str, dict[str, Any]] = {}
    for key, channel in experiment.channels.items():
        can = quantities_of(BY_KEY[key])
        entries = {
            name: {"column": f"{name} [{channel.units[name]}]" if form == "csv" else name, "unit": channel.units[name]}
            for name in channel.columns
            if can(name) and np.isfinite(channel[name]).any()
        }
        if entries:
            topics[BY_KEY[key].name] = {"from": f"{key}.{form}", **entries}
    document: dict[str, Any] = {"time": {"column": f"{STAMP} [ns]" if form == "csv" else STAMP, "unit": "ns"}}
    document["start"] = "1970-01-01T00:00:00Z"  # stamps of a simulation count from there, too
    document |= {key: experiment.metadata[key] for key in METADATA if key in experiment.metadata}
    return "# artibot import FILES --columns THIS makes the recording again\n" + yaml.safe_dump(
        document | {"topics": topics}, sort_keys=False, allow_unicode=True, width=120
    )
