"""Recordings as streams of raw messages: MCAP and SQLite files, alone or in a rosbag2 folder, checked to be whole."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from bisect import bisect_left
from collections.abc import Collection, Container, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import yaml

from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# Is this a whole recording? What to say when it is not.
# ----------------------------------------------------------------------


MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, and the summary's checksum
_RECORD = struct.Struct("<BQ")  # kind and length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; then comes the message
_SQLITE_MAGIC = b"SQLite format 3\x00"
# what decoders raise on bytes that make no sense: a length of 2**63, a name that is not UTF-8, an unknown id
_DAMAGE = (struct.error, LookupError, ValueError, ArithmeticError, RuntimeError, MemoryError, OSError)
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_OTHERS = {
    b"#ROSBAG V": "a ROS 1 bag; convert it: rosbags-convert --src {file} --dst {new} --dst-typestore ros2_jazzy",
    ZSTD_MAGIC: "a zstd-compressed file; decompress it with `zstd -d` first",
    b"PK\x03\x04": "a zip archive; unpack it first",
    b"\x1f\x8b": "a gzip archive; unpack it first",
}


def check_file(file: Path) -> str:
    """Look at both ends of a file and return `mcap` or `sqlite3`.

    Raises
    ------
    ArtibotError
        If it is empty, cut short, or of another format; the message says what to do.
    """
    try:
        with open(file, "rb") as stream:
            head = stream.read(16)
            size = stream.seek(0, 2)
            stream.seek(max(0, size - len(MAGIC)))
            tail = stream.read()
    except OSError as error:
        raise ArtibotError(f"{file}: cannot be read: {error.strerror}") from error
    if not size:
        raise ArtibotError(f"{file}: the file is empty; expected a recording (.mcap)")
    if head == _SQLITE_MAGIC:
        return "sqlite3"
    if not head.startswith(MAGIC):
        for magic, what in _OTHERS.items():
            if head.startswith(magic):
                raise ArtibotError(f"{file}: this is {what.format(file=file, new=file.with_suffix(''))}")
        raise ArtibotError(
            f"{file}: not a recording: begins with {head[:8]!r}, expected MCAP's {MAGIC!r}; of tables (CSV, Parquet) "
            "`artibot import` makes recordings"
        )
    if tail != MAGIC or size < 2 * len(MAGIC) + 29:
        raise ArtibotError(
            f"{file}: cut short or still being written (no MCAP end mark in {size} bytes); run `artibot recover {file}`"
        )
    if not _index_is_whole(file, size):
        raise ArtibotError(f"{file}: damaged: the index's checksum does not fit; run `artibot recover {file}`")
    return "mcap"


def _index_is_whole(file: Path, size: int) -> bool:
    """Say whether the checksum of the summary section, if the file has one, fits: it guides all reading."""
    with open(file, "rb") as stream:
        stream.seek(size - len(MAGIC) - _FOOTER.size)
        start, _, expected = _FOOTER.unpack(stream.read(_FOOTER.size))
        if not start or not expected or start >= size:
            return start < size
        stream.seek(start)
        return zlib.crc32(stream.read(size - len(MAGIC) - 4 - start)) == expected


@contextmanager
def clear_errors(file: Path) -> Iterator[None]:
    """Turn what the libraries raise on damaged bytes into one sentence naming the file and the mend."""
    from mcap.exceptions import McapError, UnsupportedCompressionError
    from mcap.stream_reader import CRCValidationError
    from zstandard import ZstdError

    try:
        yield
    except ArtibotError:
        raise
    except UnsupportedCompressionError as error:
        raise ArtibotError(f"{file}: {error}; `pip install lz4 zstandard` to read it") from error
    except sqlite3.Error as error:
        raise ArtibotError(f"{file}: damaged SQLite recording: {error}") from error
    except CRCValidationError as error:
        raise ArtibotError(f"{file}: damaged: {error}; run `artibot recover {file}`") from error
    except (*_DAMAGE, McapError, ZstdError) as error:
        said = f"{type(error).__name__} {error}".strip()
        raise ArtibotError(f"{file}: damaged: {said}; run `artibot recover {file}`") from error


# ----------------------------------------------------------------------
# Recordings as streams of raw messages: MCAP and SQLite files, alone or in a rosbag2 folder.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class ChannelInfo:
    """One topic as the recording describes it.

    Attributes
    ----------
    topic, ros_type : names.
    definition, definition_encoding : the type's text and its format (`ros2msg`, `ros2idl`, or empty).
    type_hash : RIHS01 hash, empty if not recorded.
    qos : YAML text of `offered_qos_profiles`, empty if not recorded.
    encoding : message encoding; `cdr` is what artibot reads.
    message_count : how many, where the recording's index says so.
    """

    topic: str
    ros_type: str
    definition: str = field(repr=False)
    definition_encoding: str
    type_hash: str = field(repr=False)
    qos: str = field(repr=False)
    encoding: str
    message_count: int = 0


class RawMessage(NamedTuple):
    """A message as recorded: its channel, times in ns, publisher's counter and CDR bytes."""

    channel: ChannelInfo
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True)
class BagInfo:
    """What a recording holds, from its index, without reading the messages.

    Attributes
    ----------
    path, files : as asked for, and the files that hold the messages, in order.
    channels : one per topic (or more, where a topic was offered in several ways).
    metadata : strings of the `artibot` record.
    start_ns, end_ns : first and last log time.
    message_count : of all channels.
    """

    path: Path
    files: tuple[Path, ...]
    channels: tuple[ChannelInfo, ...]
    metadata: dict[str, str]
    start_ns: int
    end_ns: int
    message_count: int

    @property
    def name(self) -> str:
        """The recording's name: the folder's, or the file's without its number."""
        return recording_name(self.path)


def recording_name(path: Path) -> str:
    """Return the name of a folder or of a bare file (`run_0.mcap` → `run`)."""
    path = Path(path).resolve()
    return path.stem.removesuffix("_0") if path.is_file() else path.name


def storage_files(path: Path | str) -> tuple[Path, ...]:
    """Return the files of a recording, in order.

    Raises
    ------
    ArtibotError
        If there is no such file or folder, or no recording in it.
    """
    path = Path(path)
    if path.is_file():
        return (path,)
    if not path.is_dir():
        raise ArtibotError(f"{path}: no such file or folder; expected a recording (a rosbag2 folder or an .mcap file)")
    listed = [_unpacked(path / Path(name).name) for name in _listed_files(path / "metadata.yaml")]
    if listed and all(file.is_file() for file in listed):
        return tuple(listed)
    # no metadata.yaml, or one that speaks of files that were renamed with the folder
    found = sorted(path.glob("*.mcap"), key=_number) or sorted(path.glob("*.db3"), key=_number)
    if found:
        return tuple(found)
    packed = sorted(path.glob("*.mcap.zstd")) + sorted(path.glob("*.db3.zstd"))
    if packed:
        raise ArtibotError(f"{packed[0]}: compressed as a whole file; decompress it with `zstd -d` first")
    for file in sorted(path.glob("*.bag")):
        check_file(file)  # a ROS 1 bag says how to convert it
    raise ArtibotError(f"{path}: no .mcap or .db3 file in this folder; expected a rosbag2 recording")


def _unpacked(file: Path) -> Path:
    """Return what `zstd -d` has made of a compressed file, which metadata.yaml knows nothing of; else the file."""
    unpacked = file.with_suffix("")
    return unpacked if file.suffix == ".zstd" and unpacked.is_file() else file


def _number(file: Path) -> tuple[int, str]:
    tail = file.stem.rpartition("_")[2]
    return (int(tail) if tail.isdigit() else 0, file.name)


def _listed_files(metadata: Path) -> list[str]:
    """Return `relative_file_paths` of a metadata.yaml, nothing where it cannot be read."""
    try:
        content = yaml.safe_load(metadata.read_text())["rosbag2_bagfile_information"]
        return [str(name) for name in content["relative_file_paths"]]
    except (OSError, yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
        return []


def iter_messages(
    path: Path | str, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[RawMessage]:
    """Stream a recording's messages in the order of their log times, a chunk in memory at a time.

    Parameters
    ----------
    path : folder or bare file (.mcap, .db3).
    topics : names as recorded; all if None.
    start_ns, end_ns : first log time wanted, and the first no longer wanted.

    Raises
    ------
    ArtibotError
        While iterating, where the recording is damaged, empty or foreign.
    """
    for file in storage_files(path):
        read = _iter_mcap if check_file(file) == "mcap" else _iter_sqlite
        several = read(file, topics, start_ns, end_ns)
        while True:
            with clear_errors(file):  # not around the yield: the caller's errors are the caller's
                messages = [_decompressed(message) for message in next(several, ())]
            if not messages:
                break
            yield from messages


def _decompressed(message: RawMessage) -> RawMessage:
    """Unpack what rosbag2 compressed on its own (compression_mode: message); CDR never begins like that."""
    if not message.data.startswith(ZSTD_MAGIC):
        return message
    import zstandard

    return message._replace(data=zstandard.ZstdDecompressor().decompressobj().decompress(message.data))


def _iter_mcap(
    file: Path, topics: Collection[str] | None, start: int | None, end: int | None
) -> Iterator[list[RawMessage]]:
    """Some messages at a time, never none: a chunk's where chunks do not overlap in time.

    The library's own way puts one message after the other through a queue that is sorted by comparisons in Python,
    which takes longer than all else about reading.
    """
    from mcap.reader import make_reader

    with open(file, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None or not summary.chunk_indexes:  # a file without an index, or without chunks
            infos: dict[int, ChannelInfo] = {}
            for schema, channel, m in reader.iter_messages(topics, starting_at=start, ending_before=end):
                info = infos.get(channel.id) or infos.setdefault(channel.id, channel_info(schema, channel))
                yield [RawMessage(info, m.log_time, m.publish_time, m.sequence, m.data)]
            return
        wanted = {
            number: channel_info(summary.schemas[channel.schema_id] if channel.schema_id else None, channel)
            for number, channel in summary.channels.items()
            if topics is None or channel.topic in topics
        }
        bounds = (0 if start is None else start, 2**64 if end is None else end)
        chunks = [
            chunk
            for chunk in summary.chunk_indexes
            if chunk.message_end_time >= bounds[0]
            and chunk.message_start_time < bounds[1]
            and (not chunk.message_index_offsets or not wanted.keys().isdisjoint(chunk.message_index_offsets))
        ]
        order = sorted((chunk.message_start_time, chunk.chunk_start_offset) for chunk in chunks)
        read: list[tuple[int, int, int, RawMessage]] = []
        for (_, offset), ahead in zip(order, [*order[1:], (2**64, 0)], strict=False):
            read += _messages_of_chunk(stream, offset, wanted, summary.channels, bounds)
            read.sort()
            ready = bisect_left(read, ahead)  # before all that the next chunk holds
            if ready:
                yield [message for *_, message in read[:ready]]
            del read[:ready]


def _messages_of_chunk(
    stream: BinaryIO, offset: int, wanted: Mapping[int, ChannelInfo], known: Container[int], bounds: tuple[int, int]
) -> Iterator[tuple[int, int, int, RawMessage]]:
    """Messages of a chunk, each behind its log time and its place in the file, which is their order.

    Parameters
    ----------
    wanted : channels by their numbers.
    known : numbers of all channels.
    bounds : first log time wanted, and the first no longer wanted.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Chunk
    from mcap.stream_reader import get_chunk_data_stream

    stream.seek(offset + _RECORD.size)
    unpacked, size = get_chunk_data_stream(Chunk.read(ReadDataStream(stream)), validate_crc=True)
    data: bytes = unpacked.read(size)
    at = 0
    while at < size:
        kind, length = _RECORD.unpack_from(data, at)
        begin = at + _RECORD.size
        at = begin + length
        if at > size:
            raise ValueError(f"a record of {length} bytes in a chunk that has {size - begin} left")
        if kind != Opcode.MESSAGE:
            continue
        number, sequence, log, publish = _MESSAGE.unpack_from(data, begin)
        channel = wanted.get(number)
        if channel is None:
            if number not in known:
                raise LookupError(f"a message of channel {number}, which there is not")
        elif bounds[0] <= log < bounds[1]:
            yield log, offset, begin, RawMessage(channel, log, publish, sequence, data[begin + _MESSAGE.size : at])


def channel_info(schema: Any, channel: Any, count: int = 0) -> ChannelInfo:
    """Return MCAP's schema and channel records as a `ChannelInfo`."""
    return ChannelInfo(
        topic=channel.topic,
        ros_type=schema.name if schema else "",
        definition=schema.data.decode("utf-8", "replace") if schema else "",
        definition_encoding=schema.encoding if schema else "",
        type_hash=channel.metadata.get("topic_type_hash", ""),
        qos=channel.metadata.get("offered_qos_profiles", ""),
        encoding=channel.message_encoding,
        message_count=count,
    )


def sqlite_channels(base: sqlite3.Connection) -> dict[int, ChannelInfo]:
    """Return the topics of a rosbag2 SQLite file, of any schema version."""
    base.row_factory = sqlite3.Row
    texts = {}
    if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
        for row in base.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"):
            texts[row[0]] = (row[2], row[1])
    counts = dict(tuple(row) for row in base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
    infos = {}
    for row in base.execute("SELECT * FROM topics ORDER BY id"):
        text, encoding = texts.get(row["type"], ("", ""))
        there = set(row.keys())  # older versions lack some
        old = {key: row[key] if key in there else "" for key in ("type_description_hash", "offered_qos_profiles")}
        infos[row["id"]] = ChannelInfo(
            row["name"], row["type"], text, encoding, old["type_description_hash"] or "",
            old["offered_qos_profiles"] or "", row["serialization_format"], counts.get(row["id"], 0),
        )  # fmt: skip
    return infos


def open_sqlite(file: Path) -> sqlite3.Connection:
    """Open a SQLite recording to read only."""
    return sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)


def _iter_sqlite(
    file: Path, topics: Collection[str] | None, start: int | None, end: int | None
) -> Iterator[list[RawMessage]]:
    """One message at a time."""
    with closing(open_sqlite(file)) as base:
        infos = sqlite_channels(base)
        bounds = (-(2**63) if start is None else start, 2**63 - 1 if end is None else end)
        query = "SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= ? AND timestamp < ?"
        for topic_id, stamp, data in base.execute(f"{query} ORDER BY timestamp, id", bounds):
            info = infos[topic_id]
            if topics is None or info.topic in topics:
                yield [RawMessage(info, stamp, stamp, 0, bytes(data))]
