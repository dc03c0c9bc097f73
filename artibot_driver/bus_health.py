"""What a CAN controller reports of itself: SocketCAN's error frames, and the interface's flags in the kernel."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import can

SYS: Final = Path("/sys/class/net")
_IFF_UP = 1


class BusState(enum.Enum):
    """What a CAN controller or its interface can do at the moment, best first."""

    ACTIVE = "error active"
    WARNING = "error warning: many errors"
    PASSIVE = "error passive: too many errors, no cable or no other node"
    BUS_OFF = "bus-off: the controller has left the bus"
    DOWN = "interface down"
    LOST = "interface gone"

    @property
    def carries_frames(self) -> bool:
        """Whether frames can still pass."""
        return self in (BusState.ACTIVE, BusState.WARNING, BusState.PASSIVE)


@dataclass(frozen=True)
class ErrorFrame:
    """What one of SocketCAN's error frames says (linux/can/error.h)."""

    state: BusState | None
    """The controller's new state, where the frame tells one."""
    overrun: bool
    restarted: bool
    tx_errors: int | None
    rx_errors: int | None
    text: str


_CONTROLLER, _BUS_OFF, _RESTARTED, _COUNTERS = 0x004, 0x040, 0x100, 0x200
_CLASSES: Final = (
    (0x001, "transmission timed out"),
    (0x002, "arbitration lost"),
    (_CONTROLLER, "controller"),
    (0x008, "protocol violation"),
    (0x010, "transceiver"),
    (0x020, "no acknowledgement"),
    (_BUS_OFF, "bus-off"),
    (0x080, "bus error"),
    (_RESTARTED, "controller restarted"),
)
_CONTROLLER_STATES: Final = (  # bits of byte 1, worst first
    (0x30, BusState.PASSIVE),
    (0x0C, BusState.WARNING),
    (0x40, BusState.ACTIVE),
)


def read_error_frame(message: can.Message) -> ErrorFrame:
    """Read an error frame."""
    return read_error_classes(message.arbitration_id, bytes(message.data))


def read_error_classes(classes: int, data: bytes) -> ErrorFrame:
    """Read an error frame's identifier, which holds classes, and its data; bytes that are missing count as zero."""
    data = data + bytes(8)
    detail = data[1] if classes & _CONTROLLER else 0
    state = next((state for bits, state in _CONTROLLER_STATES if detail & bits), None)
    if classes & _RESTARTED:
        state = BusState.ACTIVE
    if classes & _BUS_OFF:
        state = BusState.BUS_OFF
    overrun = bool(detail & 0x03)
    words = [text for bit, text in _CLASSES if classes & bit]
    words += ["overrun"] if overrun else []
    counted = bool(classes & _COUNTERS)
    return ErrorFrame(
        state,
        overrun,
        bool(classes & _RESTARTED),
        data[6] if counted else None,
        data[7] if counted else None,
        ", ".join(words),
    )


def worse(one: BusState, other: BusState) -> BusState:
    """The worse of two states."""
    order = list(BusState)
    return max(one, other, key=order.index)


def link_state(channel: str) -> BusState:
    """What the kernel says of a SocketCAN interface."""
    try:
        flags = int((SYS / channel / "flags").read_text(encoding="ascii"), 0)
        if not flags & _IFF_UP:
            return BusState.DOWN
        carrier = (SYS / channel / "carrier").read_text(encoding="ascii").strip()
    except FileNotFoundError:
        return BusState.LOST
    except (OSError, ValueError):
        return BusState.DOWN  # put down between the two reads: the kernel refuses the second
    return BusState.ACTIVE if carrier == "1" else BusState.BUS_OFF
