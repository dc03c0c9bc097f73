"""What a bag needs to know of a topic and ROS knows: message class, definition, type hash, offered QoS."""

from __future__ import annotations

import importlib
import re
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.messages import definition, is_known

_BASIC = {
    "boolean": "bool", "octet": "byte", "char": "char", "float": "float32", "double": "float64",
    "string": "string", "wstring": "wstring",
    **{name: name for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")},
}  # fmt: skip
_SEQUENCE = re.compile(r"sequence<(?P<item>.+?)(, (?P<bound>\d+))?>$")
_ARRAY = re.compile(r"(?P<item>.+)\[(?P<size>\d+)\]$")


def import_message(ros_type: str) -> type:
    """Return the Python class of a message type.

    Raises
    ------
    ArtibotError
        If its package is not installed, or has no such message.
    """
    package, _, name = ros_type.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise ArtibotError(
            f"message type {ros_type}: cannot be imported ({error}); install or source the package '{package}'"
        ) from error


def describe(ros_type: str, type_hash: str) -> tuple[str, str]:
    """Return the definition (ros2msg) and the RIHS01 hash of a type.

    Parameters
    ----------
    ros_type : of the topic.
    type_hash : as its publisher announces it; used for types that artibot does not know itself.
    """
    if is_known(ros_type):
        return definition(ros_type)
    return definition_of(import_message(ros_type)), type_hash if type_hash.startswith("RIHS") else ""


def definition_of(message: type) -> str:
    """Return the `ros2msg` text of a message class and of all messages inside it, without constants."""
    found: dict[str, str] = {}
    text = _fields(message, found)
    parts = [f"{'=' * 80}\nMSG: {name}\n{inner}" for name, inner in found.items()]
    return "".join([text, *parts])


def _fields(message: Any, found: dict[str, str]) -> str:
    """Return a message's fields; add the messages that they name to `found`."""
    lines = [f"{_field_type(kind, found)} {name}" for name, kind in message.get_fields_and_field_types().items()]
    return "\n".join(lines) + "\n"


def _field_type(kind: str, found: dict[str, str]) -> str:
    """Turn rosidl's name of a field type into that of a .msg file: `sequence<double, 3>` into `float64[<=3]`."""
    sequence, array = _SEQUENCE.match(kind), _ARRAY.match(kind)
    if sequence:
        bound = sequence["bound"]
        return f"{_field_type(sequence['item'], found)}[{'<=' + bound if bound else ''}]"
    if array:
        return f"{_field_type(array['item'], found)}[{array['size']}]"
    base, bounded, rest = kind.partition("<")
    if base in _BASIC:
        return _BASIC[base] + (f"<={rest.rstrip('>')}" if bounded else "")
    if kind not in found:
        package, _, name = kind.partition("/")
        found[kind] = ""  # before its fields are looked at, so that the order is that of first mention
        found[kind] = _fields(import_message(f"{package}/msg/{name}"), found)
    return kind


def qos_dict(profile: Any) -> dict[str, Any]:
    """Return an rclpy QoSProfile as rosbag2 writes it into `offered_qos_profiles`."""
    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": _seconds(profile.deadline),
        "lifespan": _seconds(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": _seconds(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": bool(profile.avoid_ros_namespace_conventions),
    }


def _seconds(duration: Any) -> dict[str, int]:
    sec, nsec = divmod(int(duration.nanoseconds), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}
