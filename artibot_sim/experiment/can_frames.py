"""CAN frames in a recording: `can_msgs/msg/Frame` to bytes and back, and all of a recording's in order."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.messages import CAN_FRAME, decoder
from artibot_sim.experiment.qos import Qos
from artibot_sim.experiment.storage import BagInfo, ChannelInfo, RawMessage, iter_messages

CAN_TOPIC = "from_can_bus"
"""Name of the topic, relative: ros2_socketcan's for what it hears on a bus."""
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


def can_topics(info: BagInfo, wanted: Collection[str] = ()) -> tuple[str, ...]:
    """Return the topics of a recording that carry CAN frames.

    Parameters
    ----------
    info : of the recording.
    wanted : only these of them, with or without the leading slash.

    Raises
    ------
    ArtibotError
        If there are none, or one that is wanted is not among them.
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
