"""Reading what is left of an MCAP file: record by record, trusting nothing but what is there in full."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.checks import MAGIC

_HEADER = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # start, end, uncompressed size, crc, length of the compression's name
_MESSAGE = struct.Struct("<HIQQ")
LEAST_MESSAGE = _MESSAGE.size
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
ATTACHMENT, METADATA, DATA_END = 0x09, 0x0C, 0x0F
_LAST_OPCODE = 0x0F


class Record(NamedTuple):
    """A record's kind and content; `whole` is False for a chunk that ends with the file."""

    opcode: int
    content: bytes
    whole: bool = True


class Message(NamedTuple):
    """A message record's fields; times in ns."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class Damage:
    """What a scan could not read.

    Attributes
    ----------
    ended : True when the file's own end was reached, so nothing was cut off.
    lost_bytes : at the end of the file, of no complete record.
    garbage_bytes : after the file's own end.
    bad_chunks : whose checksum does not fit, or that cannot be decompressed in full.
    """

    def __init__(self) -> None:
        self.ended = False
        self.lost_bytes = 0
        self.garbage_bytes = 0
        self.bad_chunks = 0


def scan(file: Path, damage: Damage, *, chunks: bool = True) -> Iterator[Record]:
    """Yield the records of the data section, chunks opened, up to the first that is not there.

    Parameters
    ----------
    file : MCAP file in any state, beginning with the magic bytes.
    damage : filled in while iterating.
    chunks : False to pass over chunks, for the few records between them.
    """
    size = file.stat().st_size
    with open(file, "rb") as stream:
        stream.seek(len(MAGIC))
        for record in _records(stream, size, damage):
            if record.opcode == CHUNK and chunks:
                yield from _open_chunk(record, damage)
            elif record.opcode == FOOTER:
                damage.ended = True
                damage.garbage_bytes = max(0, size - stream.tell() - len(MAGIC))
                return
            elif record.whole:
                yield record


def _records(stream: BinaryIO, size: int, damage: Damage) -> Iterator[Record]:
    """Yield records while they are complete; a chunk also if only its beginning is there."""
    while True:
        at = stream.tell()
        head = stream.read(_HEADER.size)
        if len(head) < _HEADER.size:
            damage.lost_bytes = size - at
            return
        opcode, length = _HEADER.unpack(head)
        if not 0 < opcode <= _LAST_OPCODE and opcode < 0x80:  # from 0x80 on they are free for private use
            damage.lost_bytes = size - at
            return
        present = min(length, size - stream.tell())
        if present < length:
            damage.lost_bytes = size - at
            if opcode == CHUNK:
                yield Record(opcode, stream.read(present), whole=False)
            return
        yield Record(opcode, stream.read(length))


def _open_chunk(record: Record, damage: Damage) -> Iterator[Record]:
    """Yield the records of a chunk whose checksum fits; of a truncated one those that can still be decompressed."""
    content = record.content
    if len(content) < _CHUNK.size:
        damage.bad_chunks += 1
        return
    start, end, size, crc, name_length = _CHUNK.unpack_from(content)
    at = _CHUNK.size + name_length
    name = content[_CHUNK.size : at].decode("ascii", "replace")
    data, whole = _decompress(name, content[at + 8 :], size)
    inside = _records(BytesIO(data), len(data), Damage())
    if record.whole and whole and (not crc or zlib.crc32(data) == crc):
        yield from inside
        return
    damage.bad_chunks += 1
    if not whole:
        yield from _plausible(inside, start, end)


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
    found = _codec(name)
    if found is None:
        return b"", False
    codec, errors = found
    out = bytearray()
    for at in range(0, len(data), 4096):  # in small pieces, to keep what comes out before the first bad byte
        try:
            out += codec.decompress(data[at : at + 4096])
        except errors:
            break
        if len(out) >= size:
            break
    return bytes(out[:size]), len(out) >= size


def _codec(name: str) -> tuple[Any, tuple[type[Exception], ...]] | None:
    """Return a decompressor and what it raises on bad bytes; None for a compression that MCAP does not name."""
    try:
        if name == "zstd":
            import zstandard

            return zstandard.ZstdDecompressor().decompressobj(), (zstandard.ZstdError,)
        if name == "lz4":
            import lz4.frame  # type: ignore[import-untyped]

            return lz4.frame.LZ4FrameDecompressor(), (RuntimeError, EOFError)
    except ImportError as error:
        raise ArtibotError(f"a chunk is compressed with {name}: `pip install {error.name}` to recover it") from error
    return None


def parse_message(content: bytes) -> Message:
    """Return a message record's fields."""
    channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(content)
    return Message(channel_id, sequence, log_ns, publish_ns, content[_MESSAGE.size :])
