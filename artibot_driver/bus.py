"""A CAN bus by name: opened with a clear word about what is missing, and watched while it is used.

Frames go through python-can, so any of its interfaces serves. Nothing here raises once the bus is open: a frame that
could not be sent is counted, and :meth:`Bus.health` says what the controller and the interface report.
"""

from __future__ import annotations

import contextlib
import enum
import errno
import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import can
from can.interfaces.socketcan.socketcan import build_can_frame, capture_message
from can_remote.websocket import WebsocketClosed

from artibot_driver.frames import Frame
from artibot_driver.relay import RelayedBus
from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# What a CAN controller reports of itself: SocketCAN's error frames, and the interface's flags in the kernel.
# ----------------------------------------------------------------------


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
    """The controller's new state, where the frame has one."""
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


# ----------------------------------------------------------------------
# A CAN bus by name: opened with a clear word about what is missing, and watched while it is used.
# ----------------------------------------------------------------------


_ARPHRD_CAN = 280
_NO_BITRATE: Final = ("socketcan", "remote", "virtual", "udp_multicast")
_SEND_TIMEOUT: Final = 0.1
"""A network socket that takes no data for this long has lost its other end, s."""


@dataclass
class Counters:
    """What a bus has seen since it was opened."""

    sent: int = 0
    received: int = 0
    not_sent: int = 0
    error_frames: int = 0
    overruns: int = 0
    restarts: int = 0


@dataclass(frozen=True)
class Health:
    """State of a bus at one moment.

    Attributes
    ----------
    tx_errors, rx_errors : int or None
        The controller's error counters, where an error frame had them.
    reason : str
        The last thing that went wrong, empty where nothing did.
    """

    state: BusState
    tx_errors: int | None
    rx_errors: int | None
    reason: str


_TROUBLE: Final = (can.CanError, OSError, ValueError, WebsocketClosed)
"""What python-can and its interfaces raise once a bus is open: ValueError is a closed socket."""


class Bus:
    """An open bus; also a context manager. Made by :func:`open_bus`, for one thread at a time.

    Attributes
    ----------
    counters : Counters
    raw : can.BusABC
        python-can's bus, for canopen and others.
    """

    def __init__(self, raw: can.BusABC, interface: str, channel: str) -> None:
        self.raw = raw
        self.interface = interface
        self.channel = channel
        self.counters = Counters()
        self._controller = BusState.ACTIVE
        self._errors: tuple[int | None, int | None] = (None, None)
        self._reason = ""
        self._socket: socket.socket | None = None
        if interface == "socketcan":
            self._socket = raw.socket  # type: ignore[attr-defined]
            self._socket.setblocking(False)

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, frame: Frame) -> bool:
        """Send a frame; False, and counted, where it could not be sent."""
        message = can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)
        return self.send_message(message)

    def send_all(self, frames: Sequence[Frame]) -> list[bool]:
        """Send frames, in one go where the bus can; of each whether it could be sent."""
        if not isinstance(self.raw, RelayedBus) or self._controller is BusState.LOST:
            return [self.send(frame) for frame in frames]
        try:
            self.raw.send_frames(frames)
        except _TROUBLE as error:
            self.counters.not_sent += len(frames)
            self._failed(error)
            return [False] * len(frames)
        self.counters.sent += len(frames)
        return [True] * len(frames)

    def send_message(self, message: can.Message) -> bool:
        """Send any frame of python-can's; False, and counted, where it could not be sent."""
        if self._controller is BusState.LOST:
            self.counters.not_sent += 1
            return False
        try:
            if self._socket is not None:  # python-can's own asks first whether there is room
                self._socket.send(build_can_frame(message))
            else:
                self.raw.send(message)
        except _TROUBLE as error:
            self.counters.not_sent += 1
            self._failed(error)
            return False
        self.counters.sent += 1
        return True

    def receive(self, timeout: float = 0.0) -> can.Message | None:
        """The next frame within `timeout` (s), or None; error frames are kept here and change the health."""
        deadline = time.monotonic() + timeout
        while True:
            message = self.receive_any(max(0.0, deadline - time.monotonic()))
            if message is None or not message.is_error_frame:
                return message

    def receive_any(self, timeout: float = 0.0) -> can.Message | None:
        """Receive a frame like :meth:`receive`; error frames are handed out too, once they have changed the health."""
        if self._controller is BusState.LOST:
            return None
        try:
            message = self._next(timeout)
        except _TROUBLE as error:
            self._failed(error)
            return None
        if message is not None and message.is_error_frame:
            self._take_error_frame(message)
        else:
            self.counters.received += message is not None
        return message

    def _next(self, timeout: float) -> can.Message | None:
        """As python-can's ``recv``, which asks first whether there is a frame: one system call where it makes two."""
        if timeout > 0.0 or self._socket is None:
            return self.raw.recv(timeout)
        try:
            return capture_message(self._socket)
        except can.CanOperationError as error:
            if error.error_code != errno.EAGAIN:
                raise
            return None

    def health(self) -> Health:
        """What is known now; for SocketCAN the interface is asked."""
        state = self._controller
        if self.interface == "socketcan" and state is not BusState.LOST:
            link = link_state(self.channel)
            if link is BusState.LOST:
                self._lose(f"{self.channel} is no longer there")
            if link is BusState.DOWN:
                self._controller = BusState.ACTIVE  # it begins anew when it is put up, and no error frame says so
            state = worse(link, state)
        return Health(state, *self._errors, self._reason)

    def close(self) -> None:
        """Close the bus, whatever state it is in; what was sent before still goes out."""
        if self.interface != "remote":
            with contextlib.suppress(can.CanError, OSError):
                self.raw.shutdown()
            return
        # python-can-remote's own shutdown fails on a server that is gone and waits for one that hangs
        if self._controller is not BusState.LOST:
            with contextlib.suppress(OSError):
                self.raw.remote_protocol.close()  # type: ignore[attr-defined]
                self._drain(time.monotonic() + _SEND_TIMEOUT)
        with contextlib.suppress(*_TROUBLE):
            self.raw.socket.close()  # type: ignore[attr-defined]
            can.BusABC.shutdown(self.raw)

    def _drain(self, deadline: float) -> None:
        """Read on until the other end has closed: to close with something unread would drop what was sent last."""
        while self._controller is not BusState.LOST and time.monotonic() < deadline:
            self.receive(0.01)

    def _failed(self, error: Exception) -> None:
        code = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if code in (errno.ENODEV, errno.ENXIO):
            self._lose(f"{self.channel} is no longer there")
        elif self.interface == "remote" or isinstance(error, ValueError):
            self._lose(f"connection lost: {error}")
        else:
            self._reason = str(error)

    def _lose(self, reason: str) -> None:
        if self._controller is not BusState.LOST:
            self._controller, self._reason = BusState.LOST, reason

    def _take_error_frame(self, message: can.Message) -> None:
        self.counters.error_frames += 1
        seen = read_error_frame(message)
        self.counters.overruns += seen.overrun
        self.counters.restarts += seen.restarted
        self._controller = seen.state or self._controller
        self._errors = (seen.tx_errors, seen.rx_errors) if seen.tx_errors is not None else self._errors
        self._reason = seen.text or self._reason


def open_bus(interface: str = "socketcan", channel: str = "vcan0", bitrate: int = 500_000, **options: Any) -> Bus:
    """Open a CAN bus.

    Parameters
    ----------
    interface, channel : str
        As python-can names them: ``socketcan`` and ``can0``; ``remote`` and ``ws://127.0.0.1:PORT/`` for a loopback
        bus between processes.
    bitrate : int
        For interfaces that are set up on opening; SocketCAN's rate is set by ``ip link``.
    **options
        Handed to python-can.

    Raises
    ------
    ArtibotError
        When the interface is missing, down or no CAN interface, with the command that mends it.
    """
    if interface == "socketcan":
        check_socketcan(channel)
    if interface not in _NO_BITRATE:
        options = {"bitrate": bitrate, **options}
    try:
        raw = RelayedBus(channel) if interface == "remote" else can.Bus(interface=interface, channel=channel, **options)
    except ConnectionError as error:
        raise ArtibotError(
            f"bus {channel}: nobody answers there ({error.strerror}); start a loopback bus: "
            "artibot can loopback --port PORT"
        ) from error
    except (can.CanError, OSError, ValueError, TypeError, ImportError, AssertionError) as error:
        raise ArtibotError(f"bus {interface} {channel}: cannot be opened: {' '.join(str(error).split())}") from error
    own = getattr(raw, "socket", None)
    if interface == "remote" and isinstance(own, socket.socket):
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(_SEND_TIMEOUT))
    return Bus(raw, interface, channel)


def check_socketcan(channel: str) -> None:
    """Raise :class:`ArtibotError`, with the mend, unless `channel` is a CAN interface of this kernel that is up."""
    virtual = channel.startswith("vcan")
    kind = "type vcan" if virtual else "type can bitrate 500000"
    mend = f"sudo ip link add dev {channel} type vcan; sudo ip link set {channel} up"
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (OSError, AttributeError) as error:
        raise ArtibotError(
            f"bus {channel}: this machine's kernel has no CAN ({error}); load it (sudo modprobe can_raw vcan), or use "
            "a loopback bus: start `artibot can loopback` and give what it prints, --channel ws://127.0.0.1:PORT/"
        ) from error
    try:
        found = int((SYS / channel / "type").read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        mend = mend if virtual else "connect the adapter and see `ip link`; without hardware take vcan0"
        raise ArtibotError(f"bus {channel}: there is no such interface; {mend}") from error
    if found != _ARPHRD_CAN:
        raise ArtibotError(f"bus {channel}: is no CAN interface; `ip -br link show type can` lists those there are")
    if link_state(channel) is BusState.DOWN:
        options = "" if virtual else f" {kind}"
        raise ArtibotError(f"bus {channel}: the interface is down; sudo ip link set {channel} up{options}")


def _timeval(seconds: float) -> bytes:
    """A C struct timeval."""
    return struct.pack("ll", int(seconds), round(1e6 * (seconds % 1)))
