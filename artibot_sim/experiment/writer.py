"""Writing a rosbag2 folder that survives being killed, and never half of one that was computed."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.bag_metadata import TopicEntry, write_bag_metadata
from artibot_sim.experiment.folders import make_folder
from artibot_sim.experiment.messages import definition as known_definition
from artibot_sim.experiment.qos import Qos, dump_profiles
from artibot_sim.experiment.sink import Reserve, Sink

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
        self._failure: ArtibotError | None = None
        self._told = self._closed = False
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
            self._told = True  # the error on its way is the one to report
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
        if not self._told:
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
            if self._failure is None:
                self._end_early(error)

    def _end_early(self, error: OSError) -> None:
        """Cut the file back to its last whole chunk, end it and bring metadata.yaml up to date; keep what to say."""
        self._reserve.release()
        whole = self._sink.abandon()
        self._waiting.clear()
        try:
            self._put_yaml()
        except OSError:
            whole = False
        recover = f"`artibot recover {self.folder}`"
        mend = (
            f"readable as they are ({recover} gives them an index, too)" if whole else f"{recover} makes them readable"
        )
        self._failure = ArtibotError(
            f"{self.file}: writing failed: {error.strerror}; the {self.message_count} messages "
            f"({self._sink.committed / 1e6:.1f} MB) up to then are kept, {mend}; free some space and record anew"
        )

    def _raise_failure(self) -> None:
        if self._failure is not None:
            self._told = True
            raise self._failure


def _widen(span: list[int], stamps: list[int]) -> list[int]:
    """Return the [first, last] of a span and more stamps."""
    return [min(span + stamps), max(span + stamps)] if span + stamps else []
