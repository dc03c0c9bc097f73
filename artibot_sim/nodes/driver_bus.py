"""The driver's bus: opened at once or not at all, and opened again beside the loop where it was lost."""

from __future__ import annotations

import threading
import time

from artibot_driver.bus import Bus, open_bus
from artibot_driver.config import DriverConfig
from artibot_sim.errors import ArtibotError

AGAIN = 0.2
"""Between two attempts to open a lost bus, s."""


class BusKeeper:
    """Opens, opens again and closes a bus.

    Parameters
    ----------
    config : DriverConfig
    """

    def __init__(self, config: DriverConfig) -> None:
        self._config = config
        self._bus: Bus | None = None
        self._found: list[Bus] = []
        self._search: threading.Thread | None = None
        self._closed = False

    def open(self) -> Bus:
        """Open the bus.

        Raises
        ------
        ArtibotError
            When it cannot be opened, with the mend.
        """
        self._closed = False
        self._bus = self._opened()
        return self._bus

    def _opened(self) -> Bus:
        return open_bus(self._config.interface, self._config.channel, self._config.bitrate)

    def again(self) -> Bus | None:
        """A new bus in place of one that was lost, once there is one; never waits."""
        if self._found:
            if self._bus is not None:
                self._bus.close()
            self._bus = self._found.pop()
            return self._bus
        if self._search is None or not self._search.is_alive():
            self._search = threading.Thread(target=self._seek, name="bus", daemon=True)
            self._search.start()
        return None

    def _seek(self) -> None:
        while not self._closed and not self._found:
            try:
                self._found.append(self._opened())
            except ArtibotError:
                time.sleep(AGAIN)

    def close(self) -> None:
        """Close what is open; what was sent before still goes out."""
        self._closed = True
        for bus in (self._bus, *self._found):
            if bus is not None:
                bus.close()
        self._bus, self._found = None, []
