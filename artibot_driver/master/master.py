"""The master: one cycle in every SYNC period."""

from __future__ import annotations

from artibot_driver.bus import Bus
from artibot_driver.master.values import Cycle, Reason, Setpoints
from artibot_driver.rig import Rig


class Master:
    """Leads the four drives of a rig."""

    def __init__(self, bus: Bus, rig: Rig) -> None:
        self._bus, self._rig = bus, rig

    def cycle(self, now_ns: int, setpoints: Setpoints | None) -> Cycle:
        """One SYNC period."""
        raise NotImplementedError

    def poll(self, now_ns: int) -> None:
        """Read the bus between two cycles."""
        raise NotImplementedError

    def enable(self) -> None:
        """Ask for the drives to be enabled."""
        raise NotImplementedError

    def disable(self) -> None:
        """Ask for standstill and no current."""
        raise NotImplementedError

    def quick_stop(self) -> None:
        """Ask for standstill."""
        raise NotImplementedError

    def stop(self, reason: Reason, text: str) -> None:
        """Ask for standstill for a reason of the caller's."""
        raise NotImplementedError

    def reset_fault(self) -> None:
        """Ask for faults to be reset."""
        raise NotImplementedError

    def use_bus(self, bus: Bus) -> None:
        """Go on with another bus."""
        raise NotImplementedError

    def close(self, now_ns: int) -> None:
        """Torque off, and leave the drives."""
        raise NotImplementedError
