"""Receiving everything that passes on a bus, for hours: what was lost is counted, and a bus that went away is awaited.

Nothing is ever sent, except that an interface's own driver acknowledges frames.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from typing import Final

import can

from artibot_driver.bus import Bus, BusState, open_bus
from artibot_sim.errors import ArtibotError

Notify = Callable[[bool, str], None]
"""Takes whether it is bad news, and the news."""

REMOTE_SCHEMES: Final = ("ws://", "wss://")
_SO_RCVBUFFORCE, _SO_MEMINFO, _DROPS = 33, 55, 8  # asm-generic/socket.h; linux/sock_diag.h
_BUFFER: Final = 4 << 20
"""Bytes asked for between kernel and reader; its default holds some 0.1 s of a full bus."""
_WATCH_PERIOD: Final = 0.5
_OPEN_PERIOD: Final = 1.0
_BATCH: Final = 50
"""Frames that are read at most before clock and bus are checked."""
_BREATH: Final = 0.02
"""After a read that failed at once, s."""
_FOREIGN_CLOCK: Final = 60.0
"""A stamp so far from the system's time, s, is of another clock: an adapter's since it was plugged in."""


def interface_of(channel: str, interface: str | None = None) -> str:
    """python-can's interface for a channel: what is given, else by what the channel looks like."""
    return interface or ("remote" if channel.startswith(REMOTE_SCHEMES) else "socketcan")


def stamp_ns(message: can.Message) -> int:
    """The interface's own stamp of a frame, ns."""
    whole = int(message.timestamp)
    return whole * 1_000_000_000 + round((message.timestamp - whole) * 1e9)


class Listener:
    """Receives everything on a bus, for one thread at a time.

    Parameters
    ----------
    interface, channel : str
        As for :func:`open_bus`.
    notify : callable
        Called with the bus's state when it changes, once each time.

    Attributes
    ----------
    dropped : int
        Frames that the kernel has thrown away since nobody read them in time; only SocketCAN counts them.
    own_clock : bool
        Whether the interface's stamps are system time, as the last checked frame says.

    Raises
    ------
    ArtibotError
        When the bus cannot be opened. Later losses are said, not raised.
    """

    def __init__(self, interface: str, channel: str, notify: Notify) -> None:
        self.interface, self.channel = interface, channel
        self.dropped = 0
        self.own_clock = True
        self._notify = notify
        self._unwatched = _BATCH  # the first frame is checked
        self._bus: Bus | None = None
        self._state = BusState.ACTIVE
        self._dropped_before = 0  # by sockets that are closed
        self._next_watch = 0.0
        self._open()

    def receive(self, timeout: float) -> can.Message | None:
        """The next frame of any kind within about `timeout` (s), or None."""
        self._unwatched += 1
        if self._unwatched < _BATCH and self._bus is not None and (message := self._bus.receive_any(0.0)) is not None:
            return message  # the quick way, for a busy bus
        self._unwatched = 0
        begin = time.monotonic()
        message = self._bus.receive_any(timeout) if self._bus is not None else None
        now = time.monotonic()
        if message is None and now - begin < min(timeout, _BREATH):
            time.sleep(min(timeout, _BREATH))  # the bus cannot be read at the moment: no busy waiting for it
        elif message is not None:
            self.own_clock = abs(message.timestamp - time.time()) < _FOREIGN_CLOCK
        if now >= self._next_watch:
            self._next_watch = now + _WATCH_PERIOD
            self._watch()
        return message

    def arrival_ns(self, message: can.Message) -> int:
        """When a frame arrived, system time in ns: its own stamp, or now where those are of another clock."""
        return stamp_ns(message) if self.own_clock else time.time_ns()

    def close(self) -> None:
        """Close the bus."""
        if self._bus is not None:
            self._count_drops()
            self._bus.close()
            self._bus = None

    def _open(self) -> None:
        self._bus = open_bus(self.interface, self.channel)
        self._dropped_before = self.dropped
        sock = getattr(self._bus.raw, "socket", None)
        if self.interface == "socketcan" and sock is not None:
            _widen(sock)

    def _watch(self) -> None:
        """Say what has changed; open the bus again where it is lost."""
        if self._bus is None:
            self._reopen()
            return
        self._count_drops()
        health = self._bus.health()
        if health.state is self._state:
            return
        self._state = health.state
        if health.state is BusState.LOST:
            self.close()
            self._next_watch = time.monotonic() + _OPEN_PERIOD
            self._notify(True, f"CAN bus {self.channel}: {health.reason or health.state.value}; waiting for it")
        else:
            self._notify(health.state is not BusState.ACTIVE, f"CAN bus {self.channel}: {health.state.value}")

    def _reopen(self) -> None:
        self._next_watch = time.monotonic() + _OPEN_PERIOD
        try:
            self._open()
        except ArtibotError:
            return
        self._state = BusState.ACTIVE
        self._notify(False, f"CAN bus {self.channel}: there again")

    def _count_drops(self) -> None:
        sock = getattr(self._bus.raw, "socket", None) if self._bus is not None else None
        if self.interface == "socketcan" and sock is not None:
            self.dropped = self._dropped_before + _kernel_drops(sock)


def _widen(sock: socket.socket) -> None:
    """Ask for a larger buffer; beyond the system's limit only root is given it."""
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):
        try:
            sock.setsockopt(socket.SOL_SOCKET, option, _BUFFER)
        except OSError:
            continue
        return


def _kernel_drops(sock: socket.socket) -> int:
    """Frames that did not fit into a socket's buffer."""
    try:
        info = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * (_DROPS + 1))
    except OSError:
        return 0
    return struct.unpack_from("I", info, 4 * _DROPS)[0] if len(info) > 4 * _DROPS else 0
