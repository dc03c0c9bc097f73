"""`recover`: a valid recording from one that was cut short or damaged."""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.messages import definition, is_known
from artibot_sim.experiment.storage import MAGIC, recording_name, storage_files
from artibot_sim.experiment.topics import load_profiles
from artibot_sim.experiment.writer import BagWriter, whole_folder
from artibot_sim.progress import Report

# ----------------------------------------------------------------------
# Chunks of an MCAP file in any state: their header, and what can be trusted of what is inside.
# ----------------------------------------------------------------------


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


class MessageRecord(NamedTuple):
    """A message record's fields; times in ns."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


def parse_message(content: bytes) -> MessageRecord:
    """Return a message record's fields."""
    channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(content)
    return MessageRecord(channel_id, sequence, log_ns, publish_ns, content[_MESSAGE.size :])


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


# ----------------------------------------------------------------------
# Reading what is left of an MCAP file: record by record, trusting nothing but what is there in full.
#
# Where bytes make no sense the scan goes on at the next place that can only be a record: a chunk, whose header says
# its length twice, or in a file without chunks a message of a known channel with whole records behind it. A chunk
# is known by that header even where its opcode is damaged.
# ----------------------------------------------------------------------


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
_INDEX_ENTRY = 16
"""Bytes of a message's log time and place in its chunk."""
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
        indices = False  # whether the indices of a chunk's messages may stand here
        while at < self.end:
            self.damage.at = at
            opcode, length = self.view[at], _extent(self.view, at, self.end)
            if opcode == FOOTER and length is not None:
                self.damage.ended = True
                self.damage.garbage_bytes = max(0, len(self.view) - (at + HEAD.size + length + len(MAGIC)))
                return
            inner = _chunk_length(self.view, at)
            misnamed = indices and opcode == MESSAGE and length is not None and _is_index(self.view, at)
            if misnamed or (inner is not None and opcode != CHUNK):
                self.damage.gaps += 1
                self.damage.gap_bytes += 1
            indices = inner is not None or (indices and (misnamed or opcode == MESSAGE_INDEX))
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
            if inner is None and behind <= following and not misnamed:  # else its length was wrong
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


def _is_index(view: Bytes, at: int) -> bool:
    """Say whether the record at `at` has the form of an index of a chunk's messages, whatever its opcode says."""
    length = HEAD.unpack_from(view, at)[1]
    entries = int.from_bytes(_body(view, at)[2:6], "little")
    return bool(length - 6 == entries and entries % _INDEX_ENTRY == 0)


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
        fits = length >= 6 and _is_index(view, at)
    else:
        fits = _EXACT.get(opcode, length) == length and length >= _LEAST.get(opcode, 0)
    return length if fits else None


# ----------------------------------------------------------------------
# `recover`: a valid recording from one that was cut short.
# ----------------------------------------------------------------------


_REPORT_EVERY = 500
"""Messages between two words on the progress."""


@dataclass(frozen=True)
class RecoverReport:
    """What `recover` saved.

    Attributes
    ----------
    source, out : the damaged recording, and the new folder.
    messages : how many were saved.
    seconds : from the first to the last log time.
    topics : name → number of messages.
    lost_bytes : at the ends of the files, of no complete record.
    garbage_bytes : after a file's own end, left out.
    gaps, gap_bytes : places in the middle where bytes belonged to no complete record, and how many did.
    bad_chunks : chunks of which a part or all had to be left out.
    unknown : messages left out because nothing says any more on which topic they were.
    missing : messages that the recording's own summary counts and that were not found.
    complete : True if the recording was closed properly and nothing was left out.
    """

    source: Path
    out: Path
    messages: int
    seconds: float
    topics: dict[str, int] = field(default_factory=dict)
    lost_bytes: int = 0
    garbage_bytes: int = 0
    gaps: int = 0
    gap_bytes: int = 0
    bad_chunks: int = 0
    unknown: int = 0
    missing: int = 0
    complete: bool = False


def recover(path: Path | str, out: Path | str | None = None, *, progress: Report | None = None) -> RecoverReport:
    """Save everything that can be read of a truncated, killed or damaged MCAP recording.

    Parameters
    ----------
    path : folder (with or without metadata.yaml) or bare .mcap file; it is never changed.
    out : folder to write; `<name>_recovered` beside the recording by default.
    progress : called now and then with the share of the recording that is behind, up to 1.

    Returns
    -------
    RecoverReport
        With the folder written: whole, or not there at all.

    Raises
    ------
    ArtibotError
        If nothing can be recovered, the recording is not MCAP, or `out` exists.
    """
    source = Path(path)
    files = storage_files(source)
    for file in files:
        _check_kind(file)
    name = f"{recording_name(source)}_recovered"
    beside = source.resolve().parent
    target = Path(out) if out is not None else beside / name
    salvage = _Salvage(files, progress)
    with whole_folder(target) as folder:
        seconds = salvage.write(folder, target.resolve().name)
    counted = ("lost_bytes", "garbage_bytes", "gaps", "gap_bytes", "bad_chunks", "missing")
    return RecoverReport(
        source=source,
        out=target,
        messages=sum(salvage.counts.values()),
        seconds=seconds,
        topics=dict(salvage.counts),
        unknown=salvage.unknown,
        complete=all(damage.none for damage in salvage.damages) and not salvage.unknown,
        **{name: sum(getattr(damage, name) for damage in salvage.damages) for name in counted},
    )


def _check_kind(file: Path) -> None:
    """Refuse what the scanner could make nothing of, with a reason."""
    with open(file, "rb") as stream:
        head = stream.read(16)
    if head.startswith(b"SQLite format 3"):
        raise ArtibotError(f"{file}: a SQLite recording; `sqlite3 {file} .recover` mends those")
    if not head:
        raise ArtibotError(f"{file}: the file is empty; there is nothing to recover")
    if not head.startswith(MAGIC) and not is_mcap(file):
        raise ArtibotError(f"{file}: begins with {head[:8]!r}, expected MCAP's {MAGIC!r}; there is nothing to recover")


class _Salvage:
    """Copies records from damaged files into a new recording."""

    def __init__(self, files: tuple[Path, ...], progress: Report | None = None) -> None:
        self.files = files
        self._progress = progress
        self._until_reported = 0
        self._size = sum(file.stat().st_size for file in files)
        self.damages: list[Damage] = []
        self.counts: Counter[str] = Counter()
        self.unknown = 0
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}

    def write(self, folder: Path, name: str) -> float:
        """Write the new recording; return its length in s."""
        metadata, others = self._metadata()
        first, last = 2**63, 0
        with BagWriter(folder, metadata, live=False, name=name) as bag:
            for other, values in others:
                bag.add_metadata(other, values)
            for file in self.files:
                for stamp in self._messages(file, bag):
                    first, last = min(first, stamp), max(last, stamp)
                    self._report()
        return (last - first) / 1e9 if self.counts else 0.0

    def _report(self) -> None:
        """Say how far the work is, now and then."""
        self._until_reported -= 1
        if self._progress and self._until_reported < 0:
            self._until_reported = _REPORT_EVERY
            self._progress(min(1.0, sum(damage.at for damage in self.damages) / self._size))

    def _metadata(self) -> tuple[dict[str, str], list[tuple[str, dict[str, str]]]]:
        """Return the `artibot` record of all files together, and the other metadata records."""
        from mcap.records import Metadata

        artibot: dict[str, str] = {}
        others = []
        for file in self.files:
            for opcode, content in scan(file, Damage(), chunks=False):
                record = _parsed(Metadata, content) if opcode == METADATA else None
                if record is not None and record.name == "artibot":
                    artibot |= record.metadata
                elif record is not None:
                    others.append((record.name, record.metadata))
        return artibot, others

    def _messages(self, file: Path, bag: BagWriter) -> Iterator[int]:
        """Copy a file's messages into `bag`, yielding the log time of each."""
        from mcap.records import Attachment

        damage = Damage()
        self.damages.append(damage)
        self._schemas, self._channels = {}, {}  # ids count anew in each file
        expected = found = 0
        for record in summary(file):  # what the chunks say may be damaged
            self._learn(record, bag)
            if record.opcode == STATISTICS:
                expected = int.from_bytes(record.content[:8], "little")
        for opcode, content in scan(file, damage, self._channels):
            if opcode == MESSAGE and len(content) >= LEAST_MESSAGE:
                message = parse_message(content)
                found += 1
                if message.channel_id in self._channels:
                    yield self._copy(bag, message)
                else:
                    self.unknown += 1
            elif opcode == ATTACHMENT and (kept := _parsed(Attachment, content)):
                bag.add_attachment(kept.name, kept.media_type, kept.data, kept.log_time, kept.create_time)
            else:
                self._learn(Record(opcode, content), bag)
        damage.missing = max(0, expected - found)

    def _learn(self, record: Record, bag: BagWriter) -> None:
        """Take in what a record says of a schema or channel."""
        from mcap.records import Channel, Schema

        if record.opcode == SCHEMA and (schema := _parsed(Schema, record.content)):
            self._schemas.setdefault(schema.id, schema)
        channel = _parsed(Channel, record.content) if record.opcode == CHANNEL else None
        if channel and channel.id not in self._channels:
            self._channels[channel.id] = channel
            self._register(bag, channel)

    def _copy(self, bag: BagWriter, message: MessageRecord) -> int:
        channel = self._channels[message.channel_id]
        bag.write(channel.topic, message.data, message.publish_ns, message.log_ns, message.sequence)
        self.counts[channel.topic] += 1
        return message.log_ns

    def _register(self, bag: BagWriter, channel: Any) -> None:
        schema = self._schemas.get(channel.schema_id)
        ros_type = schema.name if schema else ""
        text = schema.data.decode("utf-8", "replace") if schema else ""
        type_hash = channel.metadata.get("topic_type_hash", "")
        if not text and is_known(ros_type):
            text, type_hash = definition(ros_type)
        profiles = load_profiles(channel.metadata.get("offered_qos_profiles", ""))
        bag.register(
            channel.topic, ros_type, profiles, definition=text,
            encoding=schema.encoding if schema else "", type_hash=type_hash, serialization=channel.message_encoding,
        )  # fmt: skip


def _parsed(kind: Any, content: bytes) -> Any | None:
    """Return a record of mcap's class `kind`, None where its bytes do not make one."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError

    try:
        return kind.read(ReadDataStream(BytesIO(content)))
    except (McapError, struct.error, UnicodeDecodeError):
        return None
