"""CAN frames from wherever they were written down: a recording, a log of candump, standard input."""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, takewhile
from pathlib import Path
from typing import Any, Final, NamedTuple

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.messages import CAN_FRAME, decoder
from artibot_sim.experiment.reader import bag_info
from artibot_sim.experiment.storage import BagInfo, ChannelInfo, RawMessage, iter_messages
from artibot_sim.experiment.topics import Qos

# ----------------------------------------------------------------------
# CAN frames in a recording: `can_msgs/msg/Frame` to bytes and back, and all of a recording's in order.
# ----------------------------------------------------------------------


CAN_TOPIC = "from_can_bus"
"""Name of the topic, relative: ros2_socketcan's for what it receives from a bus."""
CAN_QOS = Qos(depth=500)
"""What ros2_socketcan offers it with."""

_SECOND = 1_000_000_000
_HEAD: Final = struct.Struct("<HHiII")  # encapsulation and options; stamp; length of the frame_id with its end
_BODY: Final = struct.Struct("<I???B8s")
_LITTLE_ENDIAN = 0x0100  # the bytes 0, 1
LONGEST = 8
"""Data bytes that a frame has at most; those of CAN FD have no place in the message."""


class CanFrame(NamedTuple):
    """A frame as a bus carried it.

    Attributes
    ----------
    stamp_ns : when it arrived, system time in ns.
    can_id : identifier of 11 bits, of 29 where `is_extended`; classes of SocketCAN's where `is_error`.
    data : up to 8 bytes; of a remote frame none.
    dlc : data length code; that of a remote frame says how much it asks for.
    """

    stamp_ns: int
    can_id: int
    data: bytes
    dlc: int
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False


def encode_frame(frame: CanFrame, frame_id: str = "can") -> bytes:
    """Return a `can_msgs/msg/Frame` as little-endian CDR; its header has the frame's stamp.

    Raises
    ------
    ArtibotError
        If the message cannot hold it: more than 8 bytes, or numbers out of range.
    """
    name = frame_id.encode() + b"\0"
    sec, nanosec = divmod(frame.stamp_ns, _SECOND)
    try:
        if len(frame.data) > LONGEST:
            raise struct.error(f"{len(frame.data)} data bytes")
        head = _HEAD.pack(_LITTLE_ENDIAN, 0, sec, nanosec, len(name))
        body = _BODY.pack(frame.can_id, frame.is_remote, frame.is_extended, frame.is_error, frame.dlc, frame.data)
    except struct.error as error:
        raise ArtibotError(f"{frame}: no classical CAN frame: {error}; expected at most {LONGEST} bytes") from error
    return head + name + bytes(-len(name) % 4) + body


def frame_decoder(channel: ChannelInfo) -> Callable[[bytes], CanFrame]:
    """Return a function from CDR bytes of a channel to frames, by the recording's own definition.

    Raises
    ------
    ArtibotError
        If the recording has no usable definition of the type. From the function, on bytes that are no such message.
    """
    from rosbags.serde import SerdeError

    general = decoder(channel.ros_type, channel.definition, channel.definition_encoding, channel.type_hash)

    def decode(data: bytes) -> CanFrame:
        try:
            return _as_frame(general(data))
        except (SerdeError, struct.error, ValueError, LookupError, AttributeError) as error:
            raise ArtibotError(f"topic {channel.topic}: a message is no {CAN_FRAME}: {error}") from error

    return decode


def _as_frame(message: Any) -> CanFrame:
    stamp = message.header.stamp
    remote, dlc = bool(message.is_rtr), int(message.dlc)
    data = b"" if remote else bytes(message.data)[:dlc]
    return CanFrame(
        stamp.sec * _SECOND + stamp.nanosec, int(message.id), data, dlc, bool(message.is_extended), remote,
        bool(message.is_error),
    )  # fmt: skip


def can_topics(info: BagInfo, wanted: Collection[str] = (), option: str = "--topic") -> tuple[str, ...]:
    """Return the topics of a recording that carry CAN frames.

    Parameters
    ----------
    info : of the recording.
    wanted : only these of them, with or without the leading slash.
    option : of the command line, by which they are chosen.

    Raises
    ------
    ArtibotError
        If there are none, or one that is wanted is not among them; or if none is wanted and they are below several
        namespaces: the nodes of two buses have the same ids.
    """
    found = sorted({c.topic for c in info.channels if c.ros_type == CAN_FRAME and c.encoding == "cdr"})
    if not found:
        others = ", ".join(sorted({channel.topic for channel in info.channels})) or "no topic at all"
        raise ArtibotError(
            f"{info.path}: no CAN frames: expected a topic of type {CAN_FRAME}, /{CAN_TOPIC} by default, found "
            f"{others}; record with `artibot record --can CHANNEL`"
        )
    for name in wanted:
        if "/" + name.lstrip("/") not in found:
            raise ArtibotError(f"{info.path}: no CAN frames on a topic '{name}'; expected one of {', '.join(found)}")
    if not wanted and len({topic.rpartition("/")[0] for topic in found}) > 1:
        raise ArtibotError(
            f"{info.path}: frames of several buses ({', '.join(found)}); choose with {option} {found[0]}"
        )
    return tuple(topic for topic in found if not wanted or topic in {"/" + name.lstrip("/") for name in wanted})


def iter_frames(
    path: Path | str, topics: Collection[str], start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[CanFrame]:
    """Stream the frames of a recording in the order of their log times.

    Parameters
    ----------
    path : folder or bare file.
    topics : as `can_topics` gives them.
    start_ns, end_ns : first log time wanted, and the first no longer wanted.

    Raises
    ------
    ArtibotError
        While iterating, where the recording is damaged.
    """
    decoders = FrameDecoders()
    for message in iter_messages(path, topics, start_ns, end_ns):
        yield decoders(message)


class FrameDecoders:
    """Decodes raw messages of any CAN topic; a message without a stamp gets its log time."""

    def __init__(self) -> None:
        self._by_channel: dict[int, Callable[[bytes], CanFrame]] = {}
        self._kept: list[ChannelInfo] = []  # so that no other channel gets the id of one that is gone

    def __call__(self, message: RawMessage) -> CanFrame:
        decode = self._by_channel.get(id(message.channel))
        if decode is None:
            self._kept.append(message.channel)
            decode = self._by_channel[id(message.channel)] = frame_decoder(message.channel)
        frame = decode(message.data)
        return frame if frame.stamp_ns else frame._replace(stamp_ns=message.log_ns)


# ----------------------------------------------------------------------
# Logs of `candump -l` and `candump -L` as frames, line by line.
# ----------------------------------------------------------------------


# Not python-can's CanutilsLogReader: it takes error frames for data frames (or drops what they say), stamps of 1 ns for
# doubles, fails on `_9` to `_F` behind eight bytes, and names neither file nor line of what it cannot read.
_LINE: Final = re.compile(
    r"\((?P<sec>\d+)\.(?P<fraction>\d{1,9})\)\s+(?P<channel>\S+)\s+(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"(?P<kind>##?)(?P<data>[0-9A-Fa-f]*|R[0-9A-Fa-f]?)(?:_(?P<dlc>[9A-Fa-f]))?(?:\s+[RT])?\s*"
)
_ERROR, _EXTENDED, _STANDARD = 0x20000000, 0x1FFFFFFF, 0x7FF
_LOOKED_AT: Final = 256


def is_candump(file: Path) -> bool:
    """Whether a file begins as such a log does."""
    try:
        with open(file, "rb") as stream:
            head = stream.read(_LOOKED_AT)
    except OSError:
        return False
    return re.match(rb"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]+#", head) is not None


def frame_of(line: str) -> CanFrame | None:
    """The frame in a line; None for one of CAN FD, which has no place in a recording.

    Raises
    ------
    ArtibotError
        If the line is none of candump's.
    """
    found = _LINE.fullmatch(line)
    text = found["data"] if found else ""
    if found is not None and found["kind"] == "##":
        return None
    if found is None or (not text.startswith("R") and len(text) % 2):
        raise ArtibotError(
            f"found '{line.strip()[:60]}', expected a line such as (1700000000.123456) can0 181#3702E803"
        )
    remote = text.startswith("R")
    data = b"" if remote else bytes.fromhex(text)
    if len(data) > LONGEST:
        raise ArtibotError(f"found {len(data)} data bytes in '{line.strip()[:60]}', expected at most {LONGEST}")
    dlc = int(text[1:] or "0", 16) if remote else len(data)
    number = int(found["id"], 16)
    error = len(found["id"]) == 8 and bool(number & _ERROR)
    extended = len(found["id"]) == 8 and not error
    return CanFrame(
        stamp_ns=int(found["sec"]) * 1_000_000_000 + int(found["fraction"].ljust(9, "0")),
        can_id=number & (_EXTENDED if extended else _STANDARD),
        data=data,
        dlc=int(found["dlc"], 16) if found["dlc"] else dlc,
        is_extended=extended,
        is_remote=remote,
        is_error=error,
    )


def iter_candump(lines: Iterable[str], name: str) -> Iterator[CanFrame]:
    """Stream the frames of a log's lines; empty lines, comments (`#`) and CAN FD frames are passed over.

    Raises
    ------
    ArtibotError
        While iterating, naming the file and the line.
    """
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            frame = frame_of(line)
        except ArtibotError as error:
            raise ArtibotError(f"{name}: line {number}: {error}") from error
        if frame is not None:
            yield frame


# ----------------------------------------------------------------------
# CAN frames from wherever they were written down: a recording, a log of candump, standard input.
# ----------------------------------------------------------------------


_STDIN: Final = "-"


@dataclass(frozen=True)
class FrameStream:
    """Frames to go through.

    Attributes
    ----------
    name : of the recording.
    stream : the frames.
    start_ns, end_ns : first and last stamp of the recording; None where only reading tells (the last of a log).
    robot : as the recording says, or None.
    """

    name: str
    stream: Iterator[CanFrame]
    start_ns: int | None
    end_ns: int | None
    robot: str | None


def open_frames(source: str, topics: tuple[str, ...], start: float | None, end: float | None) -> FrameStream:
    """Open a recording, a log of candump or standard input (`-`).

    Parameters
    ----------
    source : folder, file or `-`.
    topics : of a recording, which to read; all that carry frames if empty.
    start, end : s from the beginning, or None.

    Raises
    ------
    ArtibotError
        If there are no frames in it. While iterating, where it is damaged.
    """
    if start is not None and end is not None and not start <= end:
        raise ArtibotError(f"--start {start:g} --end {end:g}: nothing lies between them")
    path = Path(source)
    if source == _STDIN:
        return _from_log("standard input", iter_candump(sys.stdin, "standard input"), start, end)
    if path.is_file() and is_candump(path):
        return _from_log(source, _log(path), start, end)
    info = bag_info(path)
    found = can_topics(info, topics)
    begin = info.start_ns + round((start or 0.0) * _SECOND)
    last = info.end_ns if end is None else min(info.end_ns, info.start_ns + round(end * _SECOND))
    stream = iter_frames(path, found, begin, last + 1) if begin <= last else iter(())
    return FrameStream(source, stream, info.start_ns, last, info.metadata.get("robot"))


def _log(path: Path) -> Iterator[CanFrame]:
    with open(path, encoding="ascii", errors="replace") as stream:
        yield from iter_candump(stream, str(path))


def _from_log(name: str, frames: Iterator[CanFrame], start: float | None, end: float | None) -> FrameStream:
    """The frames between two times from the first one on; the first is read at once."""
    head = next(frames, None)
    if head is None:
        return FrameStream(name, iter(()), None, None, None)
    begin = head.stamp_ns + round((start or 0.0) * _SECOND)
    last = None if end is None else head.stamp_ns + round(end * _SECOND)
    stream = (frame for frame in chain((head,), frames) if frame.stamp_ns >= begin)
    cut = stream if last is None else takewhile(lambda frame: frame.stamp_ns <= last, stream)
    return FrameStream(name, cut, head.stamp_ns, None, None)
