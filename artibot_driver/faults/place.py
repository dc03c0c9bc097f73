"""Real buses to try faults on, which can be taken away and given back."""

from __future__ import annotations

import subprocess
import time
from typing import Final, Protocol

from artibot_driver.bus import Bus, open_bus
from artibot_driver.loopback import channel_of, start_server
from artibot_sim.errors import ArtibotError

_REOPEN: Final = 10.0
"""A loopback bus is tried to be started again on its port for so long, s."""


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
        self._ip("down")

    def up(self) -> bool:
        """Put it up; open sockets go on."""
        self._ip("up")
        return False

    def close(self) -> None:
        """The interface stays."""

    def _ip(self, state: str) -> None:
        command = ["ip", "link", "set", self.channel, state]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ArtibotError(f"bus {self.channel}: cannot be put {state}: {done.stderr.strip()}; run as root")
