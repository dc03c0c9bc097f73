"""The driver's bus: opened at once or not at all, and opened again beside the loop where it was lost."""

from __future__ import annotations

import threading

from artibot_driver.bus import Bus, open_bus
from artibot_driver.config import DriverConfig
from artibot_sim.errors import ArtibotError

AGAIN = 0.2
"""Between two attempts to open a lost bus, s."""

OPENING = 1.0
"""An attempt that is under way is waited for so long at the end, s."""


class BusKeeper:
    """Opens, opens again and closes a bus.

    Parameters
    ----------
    config : DriverConfig
    """

    def __init__(self, config: DriverConfig) -> None:
        self._config = config
        self._bus: Bus | None = None
        self._search: Search | None = None

    def open(self) -> Bus:
        """Open the bus.

        Raises
        ------
        ArtibotError
            When it cannot be opened, with the mend.
        """
        self._bus = opened(self._config)
        return self._bus

    def again(self) -> Bus | None:
        """A new bus in place of one that was lost, once there is one; never waits."""
        if self._search is None:
            self._search = Search(self._config)
        found = self._search.take()
        if found is None:
            return None
        if self._bus is not None:
            self._bus.close()
        self._bus, self._search = found, None
        return found

    def close(self) -> None:
        """Close what is open, and what a search may still find; what was sent before still goes out."""
        if self._search is not None:
            self._search.end()
        if self._bus is not None:
            self._bus.close()
        self._bus = self._search = None


class Search:
    """Tries to open a bus, in a thread of its own, until it has or is ended; what it finds then, nobody gets."""

    def __init__(self, config: DriverConfig) -> None:
        self._config = config
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._found: Bus | None = None
        self._thread = threading.Thread(target=self._run, name="bus", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                found = opened(self._config)
            except ArtibotError:
                self._ended.wait(AGAIN)
                continue
            with self._lock:
                if self._ended.is_set():
                    found.close()
                else:
                    self._found = found
            return

    def take(self) -> Bus | None:
        """What it has found, once."""
        with self._lock:
            found, self._found = self._found, None
        return found

    def end(self) -> None:
        """Search no more, and close what was found; the thread is over by then, unless opening hangs."""
        with self._lock:
            self._ended.set()
        self._thread.join(OPENING)
        found = self.take()
        if found is not None:
            found.close()


def opened(config: DriverConfig) -> Bus:
    """The bus of a configuration; raises :class:`ArtibotError` when it cannot be opened, with the mend."""
    return open_bus(config.interface, config.channel, config.bitrate)
