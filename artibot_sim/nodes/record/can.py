"""The frames of a CAN bus, put into a recording beside the topics by a thread of their own."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.can_frames import CAN_QOS, CAN_TOPIC, LONGEST, CanFrame, encode_frame
from artibot_sim.experiment.messages import CAN_FRAME
from artibot_sim.nodes.common.parameters import declare
from artibot_sim.nodes.record.recorder import Recorder
from artibot_sim.parameters import Spec

if TYPE_CHECKING:
    from artibot_driver.listener import Listener

MOST_WAITING = 200_000
"""Messages that may wait for a slow disk before frames are left out: memory is not for ever."""
_PATIENCE = 0.1
_LAST_FRAMES = 10.0
"""At the end what has arrived before is still taken, however much that is, but no longer than this, s."""
_BRIEF = 0.5
"""Time for which arrived frames are still taken at the end where stamps do not tell what came before, s."""
_STEP_BACK = 1_000_000_000
"""ns; a smaller step back of the clock does not change the order of frames."""


PARAMETERS = (
    Spec("can_channel", "", "CAN bus to record beside the topics: can0, vcan0, ws://127.0.0.1:PORT/; empty: none."),
    Spec("can_interface", "", "python-can's name of its interface; empty: remote for ws://, else socketcan."),
)


def open_listener(node: Any, channel: str | None, interface: str | None) -> Listener | None:
    """Declare the node's parameters and open the bus that they name; None where they name none.

    Parameters
    ----------
    node : rclpy node; how the bus fares is logged by it.
    channel, interface : from the command line, where they are given: they rule over parameters.

    Raises
    ------
    ArtibotError
        If the bus cannot be opened, or has an interface and no channel.
    """
    asked = [str(declare(node, spec, given)) for spec, given in zip(PARAMETERS, (channel, interface), strict=True)]
    if not asked[0]:
        if asked[1]:
            raise ArtibotError(f"--can-interface {asked[1]}: of which bus? give --can CHANNEL too")
        return None
    from artibot_driver.listener import Listener, interface_of  # recording topics alone needs no python-can

    log = node.get_logger()

    def say(bad: bool, text: str) -> None:
        if bad:  # two lines: rclpy lets one line of code log with one severity only
            log.warning(f"{text}; the recording goes on")
        else:
            log.info(text)

    return Listener(interface_of(asked[0], asked[1]), asked[0], say)


class CanTap:
    """Records a bus from its making until `close`.

    Parameters
    ----------
    recorder : takes the frames.
    listener : receives them; closed by `close`.

    Attributes
    ----------
    taken, missed : frames recorded, and frames that were not: the kernel's or our own queue was full, or the message
        cannot hold them (CAN FD).
    """

    def __init__(self, recorder: Recorder, listener: Listener) -> None:
        self.taken = self._crowded = self._too_long = 0
        self.topic = recorder.node.resolve_topic_name(CAN_TOPIC)
        self._recorder = recorder
        self._log = recorder.node.get_logger()
        self._listener = listener
        self._last_ns = 0
        self._said_missed = 0
        self._ending = threading.Event()
        recorder.add(self.topic, CAN_FRAME, CAN_QOS, f"the frames of {listener.channel} are recorded under this name")
        self._log.info(f"recording {self.topic} [{CAN_FRAME}] from CAN bus {listener.channel}")
        self._thread = threading.Thread(target=self._run, name="can frames", daemon=True)
        self._thread.start()

    @property
    def missed(self) -> int:
        """Frames that are not in the recording."""
        return self._crowded + self._too_long + self._listener.dropped

    def close(self) -> None:
        """Take the last frames and leave the bus; the recorder must still be open."""
        self._ending.set()
        self._thread.join()
        self._listener.close()
        if self.missed:
            self._log.warning(f"{self.topic}: {self.taken} frames recorded, {self.missed} missed ({self._reasons()})")

    def _run(self) -> None:
        """Pass frames on until the end, and then those that are there already: the thread's body."""
        while not self._ending.is_set():
            message = self._listener.receive(_PATIENCE)
            if message is not None:
                self._take(message)
            if self.missed >= max(1, 10 * self._said_missed):
                self._say_missed()
        end_ns, deadline = time.time_ns(), time.monotonic() + (_LAST_FRAMES if self._listener.own_clock else _BRIEF)
        while (self._last_ns < end_ns or not self._listener.own_clock) and time.monotonic() < deadline:
            message = self._listener.receive(0.0)
            if message is None:
                return
            self._take(message)

    def _take(self, message: Any) -> None:
        if len(message.data) > LONGEST:
            self._too_long += 1
            return
        if self._recorder.waiting >= MOST_WAITING:
            self._crowded += 1
            return
        stamp = self._listener.arrival_ns(message)
        if self._last_ns - _STEP_BACK < stamp < self._last_ns:
            stamp = self._last_ns  # readers sort by time: frames stay in the order in which they came
        self._last_ns = stamp
        frame = CanFrame(
            stamp, message.arbitration_id, b"" if message.is_remote_frame else bytes(message.data), message.dlc,
            message.is_extended_id, message.is_remote_frame, message.is_error_frame,
        )  # fmt: skip
        try:
            data = encode_frame(frame)
        except ArtibotError:
            self._too_long += 1
            return
        self._recorder.put(self.topic, data, stamp)
        self.taken += 1

    def _say_missed(self) -> None:
        """Warn of the first frame missed, and again each time ten times as many are."""
        self._said_missed = self.missed
        self._log.warning(f"{self.topic}: {self.missed} frames missed so far ({self._reasons()})")

    def _reasons(self) -> str:
        counts = (
            (self._listener.dropped, "not read in time"),
            (self._crowded, "the disk is too slow"),
            (self._too_long, "CAN FD"),
        )
        return ", ".join(f"{count} {why}" for count, why in counts if count)
