"""ROS message types without ROS: CDR in and out, definitions and type hashes, by rosbags' Jazzy types."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

from artibot_sim.errors import ArtibotError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

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
