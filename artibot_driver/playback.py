"""Recorded frames sent again: which of them, and that none is lost where a bus is full for a moment."""

from __future__ import annotations

import enum
import time
from collections.abc import Collection
from typing import Final

import can

from artibot_driver.bus import Bus, BusState
from artibot_driver.explain import AnyFrame
from artibot_driver.frames import HEARTBEAT_BASE, SDO_REQUEST, SDO_RESPONSE
from artibot_driver.pdo import Codec
from artibot_sim.errors import ArtibotError

_FULL: Final = 0.2
"""A frame is tried again for so long, s: an interface's queue holds as few as ten."""
_BETWEEN: Final = 2e-4
_LISTEN: Final = 0.3
"""Longer than any heartbeat's or SYNC's period, s."""
_DRAIN: Final = 1e-3


class Which(enum.Enum):
    """Frames to send again."""

    DRIVES = "drives"
    COMMANDS = "commands"
    ALL = "all"

    @property
    def moves_motors(self) -> bool:
        """Whether there are commands among them."""
        return self is not Which.DRIVES


def identifiers_from_drives(codec: Codec) -> frozenset[int]:
    """Identifiers of what the drives send: TPDOs, emergencies, heartbeats, SDO answers."""
    pdos = (each.id_of(node) for each in codec.maps.values() if not each.to_drive for node in codec.nodes.values())
    bases = (codec.emcy_base, HEARTBEAT_BASE, SDO_RESPONSE)
    return frozenset([*pdos, *(base + node for base in bases for node in codec.nodes.values())])


def identifiers_of_commands(codec: Codec, driver_id: int) -> frozenset[int]:
    """Identifiers of what commands them: RPDOs, NMT, SYNC, SDO requests, the driver's heartbeat."""
    pdos = (each.id_of(node) for each in codec.maps.values() if each.to_drive for node in codec.nodes.values())
    requests = (SDO_REQUEST + node for node in codec.nodes.values())
    return frozenset([0, codec.sync_id, HEARTBEAT_BASE + driver_id, *pdos, *requests])


class FrameChoice:
    """Says which frames to send again.

    Error frames never are: they are about a controller, not about the bus.
    """

    def __init__(self, which: Which, codec: Codec, driver_id: int) -> None:
        self.which = which
        self.chosen = {
            Which.DRIVES: identifiers_from_drives(codec),
            Which.COMMANDS: identifiers_of_commands(codec, driver_id),
        }.get(which, frozenset(range(0x800)))

    def wants(self, frame: AnyFrame) -> bool:
        """Whether to send a frame."""
        if frame.is_error:
            return False
        if self.which is Which.ALL:
            return True
        return not (frame.is_extended or frame.is_remote) and frame.can_id in self.chosen


class Sender:
    """Sends frames on a bus, in order.

    Attributes
    ----------
    sent, failed : frames that went out, and that did not although they were tried again.
    """

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.sent = self.failed = 0

    def send(self, frame: AnyFrame) -> bool:
        """Send a frame; False, and counted, where the bus is gone or full for too long."""
        message = can.Message(
            arbitration_id=frame.can_id,
            is_extended_id=frame.is_extended,
            is_remote_frame=frame.is_remote,
            dlc=frame.dlc if frame.is_remote else None,
            data=None if frame.is_remote else frame.data,
        )
        if not self.bus.send_message(message) and not self._send_again(message):
            self.failed += 1
            return False
        self.sent += 1
        return True

    def _send_again(self, message: can.Message) -> bool:
        deadline = time.monotonic() + _FULL
        while time.monotonic() < deadline and self.bus.health().state.carries_frames:
            time.sleep(_BETWEEN)
            if self.bus.send_message(message):
                return True
        return False

    def drain(self) -> None:
        """Throw away what others have sent: a bus that nobody reads fills up."""
        deadline = time.monotonic() + _DRAIN
        while time.monotonic() < deadline and self.bus.receive(0.0) is not None:
            pass


def check_alone(bus: Bus, identifiers: Collection[int]) -> None:
    """Listen for a moment whether somebody sends what is to be sent.

    Raises
    ------
    ArtibotError
        If so: two senders of one identifier disturb each other, and deceive whoever listens.
    """
    deadline = time.monotonic() + _LISTEN
    while (left := deadline - time.monotonic()) > 0 and bus.health().state is not BusState.LOST:
        message = bus.receive(left)
        if message is not None and not message.is_extended_id and message.arbitration_id in identifiers:
            raise ArtibotError(
                f"bus {bus.channel}: somebody sends frame {message.arbitration_id:03X} there, which is to be played; "
                "play on a bus of its own (artibot can loopback), or end the drives or the driver that send it"
            )
