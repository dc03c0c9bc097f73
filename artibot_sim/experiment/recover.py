"""`recover`: a valid recording from one that was cut short."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import scan
from artibot_sim.experiment.checks import MAGIC
from artibot_sim.experiment.chunks import LEAST_MESSAGE, MESSAGE, Message, Record, parse_message
from artibot_sim.experiment.folders import whole_folder
from artibot_sim.experiment.messages import definition, is_known
from artibot_sim.experiment.qos import load_profiles
from artibot_sim.experiment.storage import recording_name, storage_files
from artibot_sim.experiment.writer import BagWriter
from artibot_sim.progress import Report

_TELL_EVERY = 500
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
    if not head.startswith(MAGIC) and not scan.is_mcap(file):
        raise ArtibotError(f"{file}: begins with {head[:8]!r}, expected MCAP's {MAGIC!r}; there is nothing to recover")


class _Salvage:
    """Copies records from damaged files into a new recording."""

    def __init__(self, files: tuple[Path, ...], progress: Report | None = None) -> None:
        self.files = files
        self._progress = progress
        self._until_told = 0
        self._size = sum(file.stat().st_size for file in files)
        self.damages: list[scan.Damage] = []
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
                    self._tell()
        return (last - first) / 1e9 if self.counts else 0.0

    def _tell(self) -> None:
        """Say how far the work is, now and then."""
        self._until_told -= 1
        if self._progress and self._until_told < 0:
            self._until_told = _TELL_EVERY
            self._progress(min(1.0, sum(damage.at for damage in self.damages) / self._size))

    def _metadata(self) -> tuple[dict[str, str], list[tuple[str, dict[str, str]]]]:
        """Return the `artibot` record of all files together, and the other metadata records."""
        from mcap.records import Metadata

        artibot: dict[str, str] = {}
        others = []
        for file in self.files:
            for opcode, content in scan.scan(file, scan.Damage(), chunks=False):
                record = _parsed(Metadata, content) if opcode == scan.METADATA else None
                if record is not None and record.name == "artibot":
                    artibot |= record.metadata
                elif record is not None:
                    others.append((record.name, record.metadata))
        return artibot, others

    def _messages(self, file: Path, bag: BagWriter) -> Iterator[int]:
        """Copy a file's messages into `bag`, yielding the log time of each."""
        from mcap.records import Attachment

        damage = scan.Damage()
        self.damages.append(damage)
        self._schemas, self._channels = {}, {}  # ids count anew in each file
        expected = found = 0
        for record in scan.summary(file):  # what the chunks say may be damaged
            self._learn(record, bag)
            if record.opcode == scan.STATISTICS:
                expected = int.from_bytes(record.content[:8], "little")
        for opcode, content in scan.scan(file, damage, self._channels):
            if opcode == MESSAGE and len(content) >= LEAST_MESSAGE:
                message = parse_message(content)
                found += 1
                if message.channel_id in self._channels:
                    yield self._copy(bag, message)
                else:
                    self.unknown += 1
            elif opcode == scan.ATTACHMENT and (kept := _parsed(Attachment, content)):
                bag.add_attachment(kept.name, kept.media_type, kept.data, kept.log_time, kept.create_time)
            else:
                self._learn(Record(opcode, content), bag)
        damage.missing = max(0, expected - found)

    def _learn(self, record: Record, bag: BagWriter) -> None:
        """Take in what a record says of a schema or channel."""
        from mcap.records import Channel, Schema

        if record.opcode == scan.SCHEMA and (schema := _parsed(Schema, record.content)):
            self._schemas.setdefault(schema.id, schema)
        channel = _parsed(Channel, record.content) if record.opcode == scan.CHANNEL else None
        if channel and channel.id not in self._channels:
            self._channels[channel.id] = channel
            self._register(bag, channel)

    def _copy(self, bag: BagWriter, message: Message) -> int:
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
