"""Real buses to try faults on, which can be taken away and given back."""

from __future__ import annotations

import fcntl
import socket
import struct
import time
from typing import Final, Protocol

from artibot_driver.bus import Bus, open_bus
from artibot_driver.loopback import channel_of, start_server
from artibot_sim.errors import ArtibotError

_REOPEN: Final = 10.0
"""A loopback bus is tried to be started again on its port for so long, s."""


_SIOCGIFFLAGS, _SIOCSIFFLAGS, _IFF_UP = 0x8913, 0x8914, 1


class Place(Protocol):
    """A bus that trials can take down."""

    def open(self) -> Bus:
        """Another end of it."""

    def down(self) -> None:
        """Have it carry nothing any more."""

    def up(self) -> bool:
        """Have it carry frames again; whether its ends have to be opened anew."""

    def close(self) -> None:
        """Leave nothing behind."""


class LoopbackPlace:
    """The loopback bus; to take it down is to kill its server, to give it back to start another on the same port."""

    def __init__(self) -> None:
        self._server = start_server()
        self.channel = channel_of(self._server)

    def open(self) -> Bus:
        """Another end of it."""
        return open_bus("remote", self.channel)

    def down(self) -> None:
        """Kill the server."""
        self._server.kill()
        self._server.communicate()

    def up(self) -> bool:
        """Start another server."""
        port, until = int(self.channel.rstrip("/").rpartition(":")[2]), time.monotonic() + _REOPEN
        while True:
            self._server = start_server(port)
            try:
                self.channel = channel_of(self._server)
                return True
            except ArtibotError:  # the port is not free yet
                if time.monotonic() > until:
                    raise
                time.sleep(0.1)

    def close(self) -> None:
        """Leave no server behind."""
        self.down()


class SocketCanPlace:
    """An interface of this kernel; to put it down and up takes the right to do so."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        open_bus("socketcan", channel).close()  # says at once what is missing

    def open(self) -> Bus:
        """Another end of it."""
        return open_bus("socketcan", self.channel)

    def down(self) -> None:
        """Put the interface down."""
        self._set(False)

    def up(self) -> bool:
        """Put it up; open sockets go on."""
        self._set(True)
        return False

    def close(self) -> None:
        """The interface stays."""

    def _set(self, up: bool) -> None:
        """By ioctl, as `ip link set` does, but in microseconds: whoever calls keeps a loop going."""
        name = self.channel.encode()
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
                answer = fcntl.ioctl(control, _SIOCGIFFLAGS, struct.pack("16sH14x", name, 0))
                _, flags = struct.unpack("16sH14x", answer)
                flags = flags | _IFF_UP if up else flags & ~_IFF_UP
                fcntl.ioctl(control, _SIOCSIFFLAGS, struct.pack("16sH14x", name, flags))
        except OSError as error:
            state = "up" if up else "down"
            raise ArtibotError(f"bus {self.channel}: cannot be put {state}: {error.strerror}; run as root") from None
