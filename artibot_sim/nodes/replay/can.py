"""Recorded CAN frames played on a bus: beside the topics, or alone and without ROS."""

from __future__ import annotations

import sys
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from artibot_driver.bus import Bus, open_bus
from artibot_driver.config import load_config
from artibot_driver.dictionary import load_dictionary
from artibot_driver.listener import interface_of
from artibot_driver.pdo import Codec
from artibot_driver.playback import FrameChoice, Sender, Which, check_alone
from artibot_sim.experiment.can_frames import CanFrame, can_topics, frame_decoder
from artibot_sim.experiment.storage import BagInfo, ChannelInfo, RawMessage
from artibot_sim.nodes.common.pacer import write_statistics
from artibot_sim.nodes.common.process import asked_to_end, undisturbed
from artibot_sim.nodes.common.stamps import SECOND
from artibot_sim.nodes.replay.progress import ReplayProgress
from artibot_sim.nodes.replay.source import MessageSource, PlayedSpan, lateness_summary

_NAP = 0.02
_READING = 0.002
_QUIET = 0.003
"""Without a frame for so long, s, there is time for other things."""
_DRAIN_PERIOD = 0.1
_UNDRAINED = 100
"""Frames that are sent at most before what others send is thrown away."""

Say = Callable[[str], None]


class FramePublisher:
    """Takes CDR messages of one topic as an rclpy publisher does, and sends their frames.

    Parameters
    ----------
    decode : bytes to frame.
    send : takes the frame.
    topic_name : what it is called in messages.
    """

    def __init__(self, decode: Callable[[bytes], CanFrame], send: Callable[[CanFrame], None], topic_name: str) -> None:
        self.topic_name = topic_name
        self._decode = decode
        self._send = send

    def publish(self, data: bytes) -> None:
        """Send a message's frame."""
        self._send(self._decode(data))

    def get_subscription_count(self) -> int:
        """Return enough: who listens on a bus is not known."""
        return sys.maxsize

    def wait_for_all_acked(self, _timeout: Any) -> bool:
        """Return at once: a bus acknowledges frames itself."""
        return True


class FrameOutlet:
    """Sends recorded frames on a bus.

    Parameters
    ----------
    bus : open.
    chooser : which frames to send.
    channels : of the recording, those with frames.
    warn : called once when frames cannot be sent.

    Attributes
    ----------
    publishers : topic → where its messages go.
    """

    PRIORITY = 40
    """Of playing frames, among the machine's real-time threads; below the driver's."""

    def __init__(self, bus: Bus, chooser: FrameChoice, channels: Sequence[ChannelInfo], warn: Say) -> None:
        name = f"CAN bus {bus.channel}"
        self._decoders = {channel.topic: frame_decoder(channel) for channel in channels}
        self.publishers = {topic: FramePublisher(decode, self._send, name) for topic, decode in self._decoders.items()}
        self._sender = Sender(bus)
        self._chooser = chooser
        self._warn = warn
        self._undrained = 0
        self._timer: Any = None

    @property
    def failed(self) -> int:
        """Frames that could not be sent."""
        return self._sender.failed

    def admits(self, message: RawMessage) -> bool:
        """Say whether to play a message: any of another topic, of ours those whose frames are chosen."""
        decode = self._decoders.get(message.channel.topic)
        return decode is None or self._chooser.wants(decode(message.data))

    def _send(self, frame: CanFrame) -> None:
        if not self._sender.send(frame) and self._sender.failed == 1:
            reason = self._sender.bus.health().reason or self._sender.bus.health().state.value
            self._warn(f"CAN bus {self._sender.bus.channel}: a frame could not be sent: {reason}")
        self._undrained += 1
        if self._undrained >= _UNDRAINED:
            self.drain()

    def drain(self) -> None:
        """Throw away what others have sent on the bus."""
        self._undrained = 0
        self._sender.drain()

    def drain_by(self, node: Any) -> None:
        """Let a node do so too, for pauses."""
        from rclpy.clock import Clock, ClockType

        self._timer = node.create_timer(_DRAIN_PERIOD, self.drain, clock=Clock(clock_type=ClockType.STEADY_TIME))


@contextmanager
def frame_outlet(info: BagInfo, given: dict[str, Any], warn: Say) -> Iterator[FrameOutlet]:
    """Open the bus of `--can`; yield where the recording's frames go.

    Parameters
    ----------
    info : of the recording.
    given : options of the command line.
    warn : called with what a person must know.

    Raises
    ------
    ArtibotError
        If there are no frames, the bus cannot be opened, or somebody sends there what is to be sent.
    """
    topics = can_topics(info, given["can_topic"], "--can-topic")
    channels = [channel for channel in info.channels if channel.topic in topics]
    which = Which(given["can_frames"] or Which.DRIVES.value)
    config = load_config(given["can_params"] or "driver")
    chooser = FrameChoice(which, Codec(load_dictionary(config.eds), config.node_ids), config.driver_id)
    bus = open_bus(interface_of(given["can"], given["can_interface"]), given["can"])
    try:
        outlet = FrameOutlet(bus, chooser, channels, warn)
        check_alone(bus, chooser.chosen)
        if which.moves_motors:
            warn(f"commands are played on CAN bus {bus.channel}: drives that listen there WILL MOVE their motors")
        yield outlet
    finally:
        bus.close()


def play_frames(info: BagInfo, given: dict[str, Any], say: Say) -> int:
    """Play the frames of a recording alone, without ROS; return the exit status.

    0 at the end and after SIGINT or SIGTERM, 1 if frames could not be sent.

    Parameters
    ----------
    info, given : as for `frame_outlet`.
    say : called with how it goes.
    """
    stretch = PlayedSpan.of(info, given["start"], given["end"])
    rate = given["rate"] or 1.0
    with asked_to_end() as asked, frame_outlet(info, given, say) as outlet:
        source = MessageSource(info.path, outlet.publishers, (), stretch, given["loop"], outlet.admits)
        say(
            f"playing the CAN frames of {info.path}, {(stretch.end_ns - stretch.begin_ns) / SECOND:.1f} s at {rate:g} x"
        )
        with undisturbed(outlet.PRIORITY):
            late = np.array(_play(source, outlet, rate, asked))
        found = {"messages": len(late), "not_sent": outlet.failed, "rate": rate, **lateness_summary(late)}
        timing = f", {found['late_p50_ms']:.2f} ms late (median; p99 {found['late_p99_ms']:.2f})" if len(late) else ""
        say(f"{'ended' if asked else 'done'}: {len(late) - outlet.failed} frames{timing}")
        write_statistics(given["stats"], found)
        return 1 if outlet.failed else 0


def _play(source: MessageSource, outlet: FrameOutlet, rate: float, asked: list[int]) -> array[float]:
    """Send a source's frames at their times; return how late each was, s."""
    late = array("d")
    progress = ReplayProgress(source.stretch.period_ns / SECOND, source.loop)
    source.wait_ready()
    origin = time.monotonic()
    try:
        for due in source:
            deadline = origin + due.at_ns / SECOND / rate if due else time.monotonic() + _READING
            while not asked and (left := deadline - (now := time.monotonic())) > 0:
                if left > _QUIET:
                    progress.show((now - origin) * rate, len(late))
                    outlet.drain()
                    left = deadline - time.monotonic()
                time.sleep(min(max(0.0, left), _NAP))
            if asked:
                break
            if due:
                outlet.publishers[due.message.channel.topic].publish(due.message.data)
                late.append(time.monotonic() - deadline)
    finally:
        progress.end()
        source.close()
    return late
