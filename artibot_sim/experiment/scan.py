"""Reading what is left of an MCAP file: record by record, trusting nothing but what is there in full.

Where bytes make no sense the scan goes on at the next place that can only be a record: a chunk, whose header says its
length twice, or in a file without chunks a message of a known channel with whole records behind it. A chunk is known by
that header even where its opcode is damaged.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path

from artibot_sim.experiment.checks import MAGIC
from artibot_sim.experiment.chunks import HEAD, LEAST_MESSAGE, MESSAGE, Record, inner_length, open_chunk

HEADER, FOOTER, SCHEMA, CHANNEL, CHUNK, MESSAGE_INDEX = 0x01, 0x02, 0x03, 0x04, 0x06, 0x07
ATTACHMENT, STATISTICS, METADATA, DATA_END = 0x09, 0x0B, 0x0C, 0x0F
_LAST_OPCODE, _FIRST_PRIVATE = 0x0F, 0x80
_EXACT = {FOOTER: 20, DATA_END: 4}
"""Records that have but one length."""
_LEAST = {
    HEADER: 8, SCHEMA: 14, CHANNEL: 16, MESSAGE: LEAST_MESSAGE, 0x08: 60, ATTACHMENT: 32, 0x0A: 42, STATISTICS: 46,
    METADATA: 8, 0x0D: 20, 0x0E: 17,
}  # fmt: skip
"""Lengths of records with everything empty in them."""
_FOOTER = struct.Struct("<QQI")
_DATA_END_HEAD = HEAD.pack(DATA_END, 4)
_TAIL = HEAD.size + _FOOTER.size + len(MAGIC)
_CHUNK_BODY = 64
# opcode and a length below 4 GB, then 28 bytes of times, size and checksum, then a compression that exists
_CHUNK_SIGN = re.compile(rb"\x06(?=.{4}\0{4}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd))", re.DOTALL)
_MESSAGE_SIGN = re.compile(rb"\x05(?=.{4}\0{4})", re.DOTALL)

Bytes = mmap.mmap | bytes


class Damage:
    """What a scan could not read, and how far it is.

    Attributes
    ----------
    at : bytes of the file that are behind it.
    ended : whether the file's own end was found, so nothing was cut off.
    missing : messages that the file's own summary counts and that were not found.
    lost_bytes : at the end of the data, of no complete record.
    gaps, gap_bytes : places in the middle where bytes belonged to no complete record, and how many did.
    garbage_bytes : after the file's own end.
    bad_chunks : whose checksum does not fit, or that cannot be decompressed in full.
    """

    def __init__(self) -> None:
        self.at = 0
        self.ended = False
        self.missing = 0
        self.lost_bytes = 0
        self.gaps = self.gap_bytes = 0
        self.garbage_bytes = 0
        self.bad_chunks = 0

    @property
    def none(self) -> bool:
        """Whether nothing was lost."""
        return self.ended and not (self.lost_bytes or self.gaps or self.bad_chunks or self.missing)


def scan(file: Path, damage: Damage, channels: Collection[int] = (), *, chunks: bool = True) -> Iterator[Record]:
    """Yield the records of the data section, chunks opened.

    Parameters
    ----------
    file : MCAP file in any state, longer than its magic bytes.
    damage : filled in while iterating.
    channels : ids known so far, may grow while iterating: a file without chunks finds its way back by them.
    chunks : False to pass over chunks, for the few records between them.
    """
    with open(file, "rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as view:
        yield from _Scan(view, damage, channels).records(chunks)


def summary(file: Path) -> Iterator[Record]:
    """Yield the records of the summary, which repeats schemas and channels, if its checksum fits."""
    with open(file, "rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as view:
        at = _summary_start(view)
        while at is not None and at < len(view) - _TAIL:
            opcode, length = HEAD.unpack_from(view, at)
            yield Record(opcode, view[at + HEAD.size : at + HEAD.size + length])
            at += HEAD.size + length


def is_mcap(file: Path) -> bool:
    """Say whether a file whose first bytes are wrong is MCAP: by its header, its summary, or a chunk anywhere."""
    with open(file, "rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as view:
        begins = len(view) > len(MAGIC) and view[len(MAGIC)] == HEADER and _is_start(view, len(MAGIC), len(view))
        return begins or _summary_start(view) is not None or _next_chunk(view, 0, len(view)) is not None


def _summary_start(view: Bytes) -> int | None:
    """Return where a summary that its checksum vouches for begins."""
    foot = len(view) - _TAIL
    if foot < len(MAGIC) or view[-len(MAGIC) :] != MAGIC or HEAD.unpack_from(view, foot) != (FOOTER, _FOOTER.size):
        return None
    start, _, crc = _FOOTER.unpack_from(view, foot + HEAD.size)
    moved = view.rfind(_DATA_END_HEAD, 0, foot) + len(_DATA_END_HEAD) + 4  # where bytes before it were lost or added
    for place in (start, moved):
        if crc and len(MAGIC) <= place <= foot and zlib.crc32(view[place : foot + HEAD.size + 16]) == crc:
            return int(place)
    return None


class _Scan:
    """One pass over a file."""

    def __init__(self, view: Bytes, damage: Damage, channels: Collection[int]) -> None:
        self.view = view
        self.damage = damage
        self.channels = channels
        found = _summary_start(view)
        self.end = len(view) if found is None else found
        self.has_end = found is not None
        self.chunked = False

    def records(self, chunks: bool) -> Iterator[Record]:
        """Yield records from the first to the file's end."""
        at = len(MAGIC) if self.view[: len(MAGIC)] == MAGIC else 0
        while at < self.end:
            self.damage.at = at
            opcode, length = self.view[at], _extent(self.view, at, self.end)
            if opcode == FOOTER and length is not None:
                self.damage.ended = True
                self.damage.garbage_bytes = max(0, len(self.view) - (at + HEAD.size + length + len(MAGIC)))
                return
            inner = _chunk_length(self.view, at)
            if inner is not None and opcode != CHUNK:
                self.damage.gaps += 1
                self.damage.gap_bytes += 1
            trusted = broken = False
            if inner is not None:
                self.chunked, length, trusted = True, inner, True
                if chunks:
                    trusted, inside = open_chunk(self.view[at + HEAD.size : min(at + HEAD.size + inner, self.end)])
                    broken = not trusted
                    self.damage.bad_chunks += broken
                    yield from inside
            behind = self.end + 1 if length is None else at + HEAD.size + length
            if broken and _next_chunk(self.view, at + 1, min(behind, self.end)) is not None:
                behind = self.end + 1  # bytes were lost: its end lies in another chunk
            following = self._following(at, behind, trusted)
            if inner is None and behind <= following:  # else its length was wrong
                yield Record(opcode, self.view[at + HEAD.size : behind])
            at = following
        self.damage.at = len(self.view)
        self.damage.ended |= self.has_end

    def _following(self, at: int, behind: int, trusted: bool) -> int:
        """Return where to go on after the record from `at` to `behind`, over what makes no sense."""
        whole = behind <= self.end
        if whole and (behind == self.end or _is_start(self.view, behind, self.end)):
            return behind
        start = behind if whole and trusted else at + 1
        found = _next_chunk(self.view, start, self.end)
        if found is None and not self.chunked:
            found = self._next_message(start)
        unread = behind if whole and (found is None or found >= behind) else at
        if found is None:
            self.damage.lost_bytes += self.end - unread
            return self.end
        if found > unread:
            self.damage.gaps += 1
            self.damage.gap_bytes += found - unread
        return found

    def _next_message(self, at: int) -> int | None:
        """Return where the next message of a known channel stands with two whole records behind it."""
        for match in _MESSAGE_SIGN.finditer(self.view, at, self.end):
            place = match.start()
            if int.from_bytes(self.view[place + HEAD.size : place + HEAD.size + 2], "little") not in self.channels:
                continue
            follows = place
            for _ in range(3):
                length = _extent(self.view, follows, self.end) if follows < self.end else 0
                if length is None:
                    break
                follows += HEAD.size + length
            else:
                return place
        return None


def _next_chunk(view: Bytes, at: int, end: int) -> int | None:
    """Return where the next chunk stands whose header says the same length twice; it may be cut off by the end."""
    for match in _CHUNK_SIGN.finditer(view, at, end):
        length = HEAD.unpack_from(view, match.start())[1]
        if inner_length(_body(view, match.start())) == length:
            return match.start()
    return None


def _is_start(view: Bytes, at: int, end: int) -> bool:
    """Say whether a record may begin at `at`: one that is there in full, or a chunk by its own header."""
    return _chunk_length(view, at) is not None or _extent(view, at, end) is not None


def _chunk_length(view: Bytes, at: int) -> int | None:
    """Return how long the chunk at `at` is by its own header, None where there is none.

    One whose opcode is another counts where the record's length agrees: no other kind of record begins so.
    """
    inner = inner_length(_body(view, at))
    if inner is None or view[at] == CHUNK:
        return inner
    return inner if HEAD.unpack_from(view, at)[1] == inner else None


def _body(view: Bytes, at: int) -> bytes:
    """Return the beginning of the content of the record at `at`, enough for a chunk's header."""
    return view[at + HEAD.size : at + HEAD.size + _CHUNK_BODY]


def _extent(view: Bytes, at: int, end: int) -> int | None:
    """Return the length of the record at `at`, None where there is none in full."""
    if at + HEAD.size > end:
        return None
    opcode, length = HEAD.unpack_from(view, at)
    if not (0 < opcode <= _LAST_OPCODE or opcode >= _FIRST_PRIVATE) or at + HEAD.size + length > end:
        return None
    body = _body(view, at)
    if opcode == CHUNK:
        fits = inner_length(body) == length
    elif opcode == MESSAGE_INDEX:
        fits = length >= 6 and int.from_bytes(body[2:6], "little") == length - 6
    else:
        fits = _EXACT.get(opcode, length) == length and length >= _LEAST.get(opcode, 0)
    return length if fits else None
