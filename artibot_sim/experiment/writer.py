"""Writing a rosbag2 folder that survives being killed, and never half of one that was computed."""

from __future__ import annotations

import errno
import os
import shutil
import struct
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.messages import definition as known_definition
from artibot_sim.experiment.topics import Qos, dump_profiles

# ----------------------------------------------------------------------
# rosbag2's metadata.yaml, version 9 (Jazzy).
# ----------------------------------------------------------------------


@dataclass
class TopicEntry:
    """One topic as a writer keeps it.

    Attributes
    ----------
    name, ros_type : of the topic.
    qos : offered profiles, as `Qos.as_dict` makes them.
    type_hash : RIHS01.
    number : MCAP channel id.
    count : messages safe in the file.
    sequence : number of the last message taken.
    serialization : message encoding.
    """

    name: str
    ros_type: str
    qos: list[dict[str, Any]]
    type_hash: str
    number: int = 0
    count: int = 0
    sequence: int = 0
    serialization: str = "cdr"


class _Plain(yaml.SafeDumper):
    """Writes every mapping out: anchors and aliases are legal but no pleasure to read."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def write_bag_metadata(
    folder: Path, files: list[str], topics: list[TopicEntry], start_ns: int, duration_ns: int
) -> None:
    """Write `folder/metadata.yaml`, whole or not at all.

    Parameters
    ----------
    folder : the recording.
    files : names of its storage files, in order; the counts are given to the first.
    topics : in order of registration.
    start_ns, duration_ns : of all messages, log time.

    Raises
    ------
    OSError
        If it cannot be written; the one that was there is then untouched.
    """
    count = sum(topic.count for topic in topics)
    span = {
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "duration": {"nanoseconds": duration_ns},
        "message_count": count,
    }
    content = {
        "version": 9,
        "storage_identifier": "mcap",
        **{key: span[key] for key in ("duration", "starting_time", "message_count")},
        "topics_with_message_count": [_topic(topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": files,
        "files": [{"path": name, **span} for name in files[:1]],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    text = yaml.dump({"rosbag2_bagfile_information": content}, Dumper=_Plain, sort_keys=False, default_flow_style=False)
    target = folder / "metadata.yaml"
    partial = folder / ".metadata.yaml.partial"
    try:
        partial.write_text(text)
        partial.replace(target)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def _topic(topic: TopicEntry) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.ros_type,
            "serialization_format": topic.serialization,
            "offered_qos_profiles": topic.qos,
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.count,
    }


# ----------------------------------------------------------------------
# The file under an MCAP writer: written a whole chunk at a time, cut back to the last one when a write fails.
# ----------------------------------------------------------------------


_MAGIC = b"\x89MCAP0\r\n"
_DATA_END, _FOOTER = 0x0F, 0x02
# the shortest valid end of a file: no index, so readers go through it from the start
_END = struct.pack("<BQI", _DATA_END, 4, 0) + struct.pack("<BQQQI", _FOOTER, 20, 0, 0, 0) + _MAGIC

RESERVE_BYTES = 1 << 21
"""Space that is kept for the end of a recording: a chunk, the index of an hour, a metadata.yaml of some 300 topics."""


class Reserve:
    """A hidden file in a recording's folder that holds space on the disk, given back when the disk is full."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".reserve"
        try:
            self._path.write_bytes(bytes(RESERVE_BYTES))  # not a hole: its blocks must be taken
        except OSError:
            self.release()

    def release(self) -> None:
        """Give the space back; again is allowed."""
        self._path.unlink(missing_ok=True)


class Sink:
    """What `mcap.writer.Writer` writes to: bytes wait here until `commit` puts them into the file in one go.

    Attributes
    ----------
    committed : bytes that are in the file, always a whole number of records.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.committed = 0
        self._waiting = bytearray()
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise ArtibotError(f"{path}: cannot be made: {error.strerror}") from error

    def write(self, data: bytes) -> int:
        """Take bytes; they reach the file with the next `commit`."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Return where in the file the next byte will stand."""
        return self.committed + len(self._waiting)

    def flush(self) -> None:
        """Do nothing: `commit` decides when bytes go out."""

    def commit(self) -> None:
        """Write everything that waits.

        Raises
        ------
        OSError
            If the disk is full or broken; call `abandon` then.
        """
        rest = memoryview(bytes(self._waiting))
        while rest:
            rest = rest[os.write(self._file, rest) :]
        self.committed += len(self._waiting)
        self._waiting.clear()

    def rewind(self) -> None:
        """Take what a commit that failed has written of its bytes out of the file; they go on waiting."""
        os.ftruncate(self._file, self.committed)
        os.lseek(self._file, self.committed, os.SEEK_SET)

    def abandon(self) -> bool:
        """Cut the file back to `committed` and end it validly without an index; say whether that succeeded."""
        self._waiting.clear()
        try:
            os.ftruncate(self._file, self.committed)
            if os.pwrite(self._file, _END, self.committed) != len(_END):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            os.ftruncate(self._file, self.committed)
            return False
        return True

    def sync(self) -> None:
        """Ask the system to put the file on the disk."""
        os.fdatasync(self._file)

    def close(self) -> None:
        """Close the file; again is allowed."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


# ----------------------------------------------------------------------
# Folders of recordings: never overwritten, and never half of one that was computed.
# ----------------------------------------------------------------------


def make_folder(folder: Path) -> None:
    """Make a recording's folder, which must not be there."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ArtibotError(f"{folder}: exists already; recordings are never overwritten, give another name") from None
    except OSError as error:
        raise ArtibotError(f"{folder}: cannot be made: {error.strerror}") from error


class WriteError(ArtibotError):
    """A recording that could not be written to its end.

    Attributes
    ----------
    reason : why, in the system's words.
    """

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text)
        self.reason = reason


_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What only writing can fail with."""


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Give a folder beside `folder` to write into, renamed to it at the end, removed if anything fails.

    Raises
    ------
    ArtibotError
        If `folder` exists, its folder cannot be written to, or the disk is full.
    """
    if folder.exists():
        raise ArtibotError(f"{folder}: exists already; recordings are never overwritten, give another name")
    partial = folder.with_name(f".{folder.name}.{os.getpid()}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        partial.rmdir()  # who writes makes it: tried here, where an error can name the folder that was asked for
    except OSError as error:
        raise ArtibotError(f"{folder}: cannot be made: {error.strerror}") from error
    try:
        yield partial
        partial.rename(folder)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        reason = error.reason if isinstance(error, WriteError) else ""
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            reason = str(error.strerror)
        if reason:  # what a writer says of what it has kept is not true of a folder that is removed
            raise ArtibotError(
                f"{folder}: writing failed: {reason}; nothing of it is kept: free some space, or name another folder"
            ) from error
        raise


# ----------------------------------------------------------------------
# Writing a rosbag2 folder that survives being killed, and never half of one that was computed.
# ----------------------------------------------------------------------


CHUNK_PERIOD = 0.5
"""A chunk is closed after this many seconds at the latest."""
CHUNK_BYTES = 1 << 20


class BagWriter:
    """Write messages to a rosbag2 folder (MCAP, profile ros2) as the contract lays it out.

    Parameters
    ----------
    folder : made anew, with its parents; its name is also that of the file inside.
    metadata : strings for the `artibot` record.
    live : True while recording: a thread closes the chunk in hand at least every 0.5 s of wall time, also
        when no message arrives, so a killed process loses at most that. False when writing what was computed:
        chunks are cut by size alone, and equal input gives equal bytes.
    compression : `zstd`, `lz4` or `none`, of each chunk.
    name : stem of the .mcap file; the folder's name by default.
    sync_period : s between requests to the operating system to put the file on the disk itself (a power cut
        loses what was not); None leaves it to the system.

    Raises
    ------
    ArtibotError
        If the folder exists, or cannot be made. From `write` and `close` when the disk is full: what was
        written up to then is kept, and the recording ended with space that was kept for that.

    Examples
    --------
    >>> with BagWriter("run1", {"robot": "agriq"}) as bag:            # doctest: +SKIP
    ...     bag.register("/odom", "nav_msgs/msg/Odometry")
    ...     bag.write("/odom", data, publish_ns=stamp, log_ns=stamp)
    """

    def __init__(
        self,
        folder: Path | str,
        metadata: Mapping[str, str] | None = None,
        *,
        live: bool = True,
        compression: str = "zstd",
        name: str | None = None,
        sync_period: float | None = None,
    ) -> None:
        from mcap.writer import CompressionType, Writer

        kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
        if compression not in kinds:
            raise ArtibotError(f"compression '{compression}' is unknown; expected one of {', '.join(kinds)}")
        self.folder = Path(folder)
        self.file = self.folder / f"{name or self.folder.resolve().name}_0.mcap"
        self._entries: dict[str, TopicEntry] = {}
        self._schemas: dict[tuple[str, str, str], int] = {}
        self._waiting: Counter[str] = Counter()  # messages of the chunk in hand, by topic
        self._span: list[int] = []  # [first, last] log time on disk
        self._waiting_span: list[int] = []
        self._waiting_bytes = 0
        self._opened_at = self._synced_at = time.monotonic()
        self._failure: WriteError | None = None
        self._raised = self._closed = False
        self._stale_yaml = False
        self._sync_period = sync_period
        self._lock = threading.RLock()
        make_folder(self.folder)
        self._reserve = Reserve(self.folder)
        self._sink = Sink(self.file)
        # the chunk size is out of reach: chunks end in `_end_chunk` alone, which counts what is safe on disk
        self._mcap = Writer(self._sink, chunk_size=1 << 62, compression=kinds[compression])  # type: ignore[arg-type]
        with self._keeping():
            self._mcap.start(profile="ros2", library="artibot")
            self._mcap.add_metadata("artibot", {"contract": "1", **(metadata or {})})
            self._sink.commit()
        self._write_yaml()
        if self._failure:
            self._sink.close()
            self._reserve.release()
        self._raise_failure()
        self._stop = threading.Event()
        self._ticker = threading.Thread(target=self._tick, name="bag chunks", daemon=True) if live else None
        if self._ticker:
            self._ticker.start()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._raised = True  # the error on its way is the one to report
        self.close()

    @property
    def message_count(self) -> int:
        """Messages taken so far, on disk or waiting for the chunk to be closed."""
        return sum(entry.count for entry in self._entries.values()) + sum(self._waiting.values())

    @property
    def bytes_written(self) -> int:
        """Size of the file, in bytes."""
        return self._sink.committed

    def register(
        self,
        topic: str,
        ros_type: str,
        qos: Qos | list[dict[str, Any]] | None = None,
        *,
        definition: str | None = None,
        encoding: str = "ros2msg",
        type_hash: str | None = None,
        serialization: str = "cdr",
    ) -> None:
        """Announce a topic before its first message; again with the same type is allowed and changes nothing.

        Parameters
        ----------
        topic, ros_type : names; the type is `package/msg/Name`.
        qos : the publisher's, or the profiles of several as mappings.
        definition, encoding, type_hash : of a type that is not one of Jazzy's common messages.
        serialization : message encoding.

        Raises
        ------
        ArtibotError
            If the type is unknown and no definition is given, or the topic was registered with another type.
        """
        known = self._entries.get(topic)
        if known:
            if known.ros_type != ros_type:
                raise ArtibotError(f"topic {topic}: type {ros_type}, but it was registered as {known.ros_type}")
            return
        if definition is None:
            definition, type_hash = known_definition(ros_type)
        profiles = [(qos or Qos()).as_dict()] if qos is None or isinstance(qos, Qos) else qos
        channel = {"offered_qos_profiles": dump_profiles(profiles), "topic_type_hash": type_hash or ""}
        with self._lock:
            key = (ros_type, encoding, definition)
            if key not in self._schemas:
                self._schemas[key] = self._mcap.register_schema(ros_type, encoding, definition.encode())
            number = self._mcap.register_channel(topic, serialization, self._schemas[key], channel)
            entry = TopicEntry(topic, ros_type, profiles, type_hash or "", number, serialization=serialization)
            self._entries[topic] = entry
            self._stale_yaml = True

    def write(self, topic: str, data: bytes, publish_ns: int, log_ns: int, sequence: int | None = None) -> None:
        """Take one message.

        Parameters
        ----------
        topic : registered before.
        data : CDR bytes.
        publish_ns, log_ns : when it was published and received, ns.
        sequence : the publisher's counter; counted here if None.

        Raises
        ------
        ArtibotError
            If the topic is not registered, or the disk is full.
        """
        try:
            entry = self._entries[topic]
        except KeyError:
            raise ArtibotError(f"topic {topic} was not registered with the writer of {self.folder}") from None
        with self._lock:
            self._raise_failure()
            self._begin_chunk_if_due()
            self._raise_failure()
            entry.sequence = entry.sequence + 1 if sequence is None else sequence
            self._mcap.add_message(entry.number, log_ns, data, publish_ns, entry.sequence & 0xFFFFFFFF)
            self._waiting[topic] += 1
            self._waiting_bytes += len(data) + 31  # with the record around it
            self._waiting_span = _widen(self._waiting_span, [log_ns])

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record beside the `artibot` one."""
        with self._lock, self._keeping():
            self._mcap.add_metadata(name, dict(values))
            self._sink.commit()

    def add_attachment(self, name: str, media_type: str, data: bytes, log_ns: int = 0, create_ns: int = 0) -> None:
        """Add a file to the recording."""
        with self._lock, self._keeping():
            self._mcap.add_attachment(create_ns, log_ns, name, media_type, data)
            self._sink.commit()

    def close(self) -> None:
        """Finish the file with its index and the folder with its final metadata.yaml; later calls do nothing.

        Raises
        ------
        ArtibotError
            If the disk is full, and no call has said so yet.
        """
        if self._closed:
            return
        self._closed = True
        if self._ticker:
            self._stop.set()
            self._ticker.join()
        with self._lock:
            with self._keeping():
                self._end_chunk()
                if not self._failure:
                    self._mcap.finish()
                    self._sink.commit()
            self._sink.close()
            self._reserve.release()
            self._write_yaml()
        if not self._raised:
            self._raise_failure()

    def _begin_chunk_if_due(self) -> None:
        """Close the chunk in hand if it is full."""
        if self._waiting_bytes >= CHUNK_BYTES:
            with self._keeping():
                self._end_chunk()
        if not self._waiting:
            self._opened_at = time.monotonic()

    def _end_chunk(self) -> None:
        """Put the chunk in hand into the file in one write, and only then count its messages."""
        if self._failure or not self._waiting:
            return
        self._mcap.flush()
        self._sink.commit()
        self._count_chunk()

    def _count_chunk(self) -> None:
        """Count the messages of the chunk that was in hand: they are in the file."""
        for topic, count in self._waiting.items():
            self._entries[topic].count += count
        self._span = _widen(self._span, self._waiting_span)
        self._waiting.clear()
        self._waiting_span = []
        self._waiting_bytes = 0

    def _tick(self) -> None:
        """Close the chunk in hand when it grows old: the thread's body."""
        period = CHUNK_PERIOD / 5
        while not self._stop.wait(period):
            with self._lock:
                with self._keeping():
                    if time.monotonic() - self._opened_at > CHUNK_PERIOD - period:
                        self._end_chunk()
                if self._stale_yaml:
                    self._write_yaml()
            if self._sync_period and time.monotonic() - self._synced_at > self._sync_period:
                self._synced_at = time.monotonic()
                with self._keeping():  # but not the lock: a slow disk must not hold up messages
                    self._sink.sync()

    def _write_yaml(self) -> None:
        with self._keeping():
            self._put_yaml()

    def _put_yaml(self) -> None:
        first, last = self._span or (0, 0)
        self._stale_yaml = False
        write_bag_metadata(self.folder, [self.file.name], list(self._entries.values()), first, last - first)

    @contextmanager
    def _keeping(self) -> Iterator[None]:
        """When something cannot be written, end the recording after its last whole chunk, as completely as can be."""
        try:
            yield
        except OSError as error:
            with self._lock:
                if self._failure is None:
                    self._end_early(error)

    def _end_early(self, error: OSError) -> None:
        """End the file with the space that was kept, bring metadata.yaml up to date; keep what to say."""
        self._reserve.release()
        indexed = self._finished()
        whole = indexed or self._sink.abandon()
        self._waiting.clear()
        try:
            self._put_yaml()
        except OSError:
            indexed = whole = False
        recover = f"`artibot recover {self.folder}`"
        mend = f"{recover} makes them readable"
        if indexed:
            mend = "readable as they are, with an index"
        elif whole:
            mend = f"readable as they are, without the index that some readers ask for: {recover} makes it"
        self._failure = WriteError(
            f"{self.file}: writing failed: {error.strerror}; the {self.message_count} messages "
            f"({self._sink.committed / 1e6:.1f} MB) up to then are kept, {mend}; free some space and record anew",
            str(error.strerror),
        )

    def _finished(self) -> bool:
        """Whether the chunk in hand and the index had room."""
        try:
            self._sink.rewind()
            self._mcap.finish()
            self._sink.commit()
        except OSError:
            return False
        self._count_chunk()
        return True

    def _raise_failure(self) -> None:
        if self._failure is not None:
            self._raised = True
            raise self._failure


def _widen(span: list[int], stamps: list[int]) -> list[int]:
    """Return the [first, last] of a span and more stamps."""
    return [min(span + stamps), max(span + stamps)] if span + stamps else []
