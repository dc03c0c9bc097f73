"""Messages that are published over and over with other numbers: serialised once, and the numbers written in place.

rclpy goes through every field of a message for every publication, a covariance's 36 numbers one by one. A message whose
names and lengths stay the same always has its numbers at the same places, and is as well published as bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message

from artibot_sim.nodes.common.stamps import SECOND

_PROBE = struct.unpack("=d", bytes(range(0x41, 0x49)))[0]
"""A number that no message has by itself."""

_WORD = 4
"""Bytes to which lengths of messages are rounded."""

_STAMP = struct.Struct("=iI")
_STAMP_AT = 4
"""Behind the header of CDR: the messages prepared here begin with a time."""


class PreparedMessage:
    """A message that begins with a time (a Clock, or any with a header), to be published with other numbers.

    Parameters
    ----------
    publisher : rclpy Publisher
    message : message
        Complete: names, frames, covariances, and sequences as long as they will be.
    """

    def __init__(self, publisher: Any, message: Any) -> None:
        self._publisher, self._message = publisher, message
        self._bytes = bytearray(_exact(message))

    def numbers(self, path: str, count: int) -> NDArray[np.float64]:
        """Return `count` doubles in a row as they stand in the message, to be written to.

        Parameters
        ----------
        path : str
            The first of them: ``pose.pose.position.x``, or a sequence's name. Where it is, the middleware itself
            shows: it serialises the message with that number changed.
        """
        *parents, name = path.split(".")
        holder = self._message
        for parent in parents:
            holder = getattr(holder, parent)
        before = getattr(holder, name)
        setattr(holder, name, _probed(before))
        changed = serialize_message(self._message)
        setattr(holder, name, before)
        at = changed.find(struct.pack("=d", _PROBE))
        assert 0 <= at <= len(self._bytes) - 8 * count
        return np.frombuffer(self._bytes, np.float64, count, at)

    def publish(self, t_ns: int) -> None:
        """Publish it as it is now, with this time."""
        _STAMP.pack_into(self._bytes, _STAMP_AT, *divmod(t_ns, SECOND))
        self._publisher.publish(bytes(self._bytes))


def _exact(message: Any) -> bytes:
    """A message as it is sent: the middleware's own bytes end with room for the numbers of sequences that are empty.

    Readers of recordings refuse a message that is longer than its fields.
    """
    whole = bytes(serialize_message(message))
    while len(whole) > _WORD and _readable(whole[:-_WORD], message):
        whole = whole[:-_WORD]
    return whole


def _readable(data: bytes, message: Any) -> bool:
    try:
        return bool(deserialize_message(data, type(message)) == message)
    except Exception:  # noqa: BLE001 - the middleware's own, whose type rclpy does not export
        return False


def _probed(value: Any) -> Any:
    if not isinstance(value, Sequence | np.ndarray) and not hasattr(value, "typecode"):
        return _PROBE
    found = value[:]
    found[0] = _PROBE
    return found
