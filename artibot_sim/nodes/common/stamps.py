"""The time at the beginning of a serialised message, read and changed without decoding the rest."""

from __future__ import annotations

import struct

SECOND = 1_000_000_000
"""Nanoseconds."""


def stamp_of(data: bytes) -> int:
    """Return the time at the very beginning of a CDR message, ns: a Clock's, or a Header's stamp."""
    sec, nanosec = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(sec) * SECOND + int(nanosec)


def with_stamp(data: bytes, stamp_ns: int) -> bytes:
    """Return a CDR message with another time at its very beginning; all else is the same."""
    changed = bytearray(data)
    sec, nanosec = divmod(stamp_ns, SECOND)
    struct.pack_into("<iI" if data[1] & 1 else ">iI", changed, 4, sec, nanosec)
    return bytes(changed)
