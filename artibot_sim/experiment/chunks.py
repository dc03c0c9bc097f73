"""Chunks of an MCAP file in any state: their header, and what can be trusted of what is inside."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

from artibot_sim.errors import ArtibotError

HEAD = struct.Struct("<BQ")
"""Every record's opcode and length."""
FIELDS = struct.Struct("<QQQII")
"""A chunk's first and last log time, uncompressed size, checksum, and length of the compression's name."""
_MESSAGE = struct.Struct("<HIQQ")
LEAST_MESSAGE = _MESSAGE.size
MESSAGE = 0x05
COMPRESSIONS = (b"", b"lz4", b"zstd")


class Record(NamedTuple):
    """A record's kind and content."""

    opcode: int
    content: bytes


class Message(NamedTuple):
    """A message record's fields; times in ns."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


def parse_message(content: bytes) -> Message:
    """Return a message record's fields."""
    channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(content)
    return Message(channel_id, sequence, log_ns, publish_ns, content[_MESSAGE.size :])


def inner_length(body: bytes) -> int | None:
    """Return how long a chunk is by its own header, to its compressed data's end; None where that makes no sense.

    Parameters
    ----------
    body : the beginning of the chunk's content, 60 bytes or more where there are so many.
    """
    if len(body) < FIELDS.size:
        return None
    start, end, _, _, name_length = FIELDS.unpack_from(body)
    at = FIELDS.size + name_length
    if name_length > 4 or start > end or body[FIELDS.size : at] not in COMPRESSIONS or len(body) < at + 8:
        return None
    return int(at + 8 + int.from_bytes(body[at : at + 8], "little"))


def open_chunk(content: bytes) -> tuple[bool, list[Record]]:
    """Return whether a chunk is as it was written, and its records.

    All of them if its checksum fits; of one that cannot be decompressed in full, those that can and are plausible;
    none of one whose checksum does not fit.
    """
    if inner_length(content[:64]) is None:
        return False, []
    start, end, size, crc, name_length = FIELDS.unpack_from(content)
    at = FIELDS.size + name_length
    data, whole = _decompress(content[FIELDS.size : at].decode("ascii"), content[at + 8 :], size)
    if whole and (not crc or zlib.crc32(data) == crc):
        return True, list(_records(data))
    return False, [] if whole else list(_plausible(_records(data), start, end))


def _records(data: bytes) -> Iterator[Record]:
    """Yield a chunk's records while they are complete."""
    at = 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        if not opcode or at + length > len(data):
            return
        yield Record(opcode, data[at : at + length])
        at += length


def _plausible(records: Iterator[Record], start: int, end: int) -> Iterator[Record]:
    """Yield records of a chunk that no checksum vouches for: all but the last, while their times are the chunk's.

    The last may have been completed by whatever stood behind the cut: after a power cut, often zeros.
    """
    held = None
    for record in records:
        if record.opcode == MESSAGE and not _is_timely(record.content, start, end):
            return
        if held is not None:
            yield held
        held = record


def _is_timely(content: bytes, start: int, end: int) -> bool:
    return len(content) >= LEAST_MESSAGE and start <= parse_message(content).log_ns <= end


def _decompress(name: str, data: bytes, size: int) -> tuple[bytes, bool]:
    """Return what can be decompressed of a chunk's data, and whether that is all of it."""
    if not name:
        return data[:size], len(data) >= size
    codec, errors = _codec(name)
    out = bytearray()
    for at in range(0, len(data), 4096):  # in small pieces, to keep what comes out before the first bad byte
        try:
            out += codec.decompress(data[at : at + 4096])
        except errors:
            break
        if len(out) >= size:
            break
    return bytes(out[:size]), len(out) >= size


def _codec(name: str) -> tuple[Any, tuple[type[Exception], ...]]:
    """Return a decompressor and what it raises on bad bytes."""
    try:
        if name == "zstd":
            import zstandard

            return zstandard.ZstdDecompressor().decompressobj(), (zstandard.ZstdError,)
        import lz4.frame  # type: ignore[import-untyped]

        return lz4.frame.LZ4FrameDecompressor(), (RuntimeError, EOFError)
    except ImportError as error:
        raise ArtibotError(f"a chunk is compressed with {name}: `pip install {error.name}` to recover it") from error
