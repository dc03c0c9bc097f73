"""`enable_on_start`: the drives are enabled once, at the start, and not after something has happened."""

from __future__ import annotations

from typing import NamedTuple

from artibot_driver.master import Phase, Status
from artibot_sim.nodes.driver_answers import stop_text

START_WITHIN = 60.0
"""It holds for so long after the bus was opened, s: drives that come later ask for a person."""


class Verdict(NamedTuple):
    """Whether to enable the drives now, or why the wish has lapsed; mostly neither."""

    enable: bool = False
    lapsed: str = ""


class AutoEnable:
    """The wish to be enabled as soon as the drives are set up."""

    def __init__(self) -> None:
        self._until: float | None = None

    def begin(self, now: float) -> None:
        """It holds from now on (steady s)."""
        self._until = now + START_WITHIN

    def end(self) -> None:
        """Whoever commands by hand, or closes the bus, takes its place."""
        self._until = None

    def look(self, status: Status, now: float) -> Verdict:
        """What it comes to in this period."""
        if self._until is None:
            return Verdict()
        if now > self._until:
            found = Verdict(lapsed=f"the drives were not ready within {START_WITHIN:g} s")
        elif status.stop is not None:
            found = Verdict(lapsed=stop_text(status.stop))
        elif status.phase is Phase.LOCKED:
            found = Verdict(lapsed=status.phase.value)
        elif status.phase is Phase.READY:
            found = Verdict(enable=True)
        else:
            return Verdict()
        self._until = None
        return found
