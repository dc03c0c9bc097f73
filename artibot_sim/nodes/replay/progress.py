"""How far a replay is: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import math
import time

from artibot_sim.progress import Bar

PERIOD = 0.25
"""s between two pictures; drawing one takes a few ms, in which no message is published."""


class ReplayProgress:
    """A bar with position, speed and messages a second.

    Parameters
    ----------
    total : s of one pass.
    loop : whether there are more passes.
    """

    def __init__(self, total: float, loop: bool = False) -> None:
        self.total = total
        self.loop = loop
        self._last: tuple[float, float, int] | None = None
        self._bar = Bar(total, delay=0.0, period=PERIOD, lines=math.inf)  # a log needs no clock

    def show(self, position: float, messages: int) -> None:
        """Draw, if it is time to: `position` in recorded s since the first pass began."""
        now = time.monotonic()
        if not self._bar.due(now):
            return
        then, before, count = self._last or (now, position, messages)
        self._last = (now, position, messages)
        elapsed = max(now - then, 1e-9)
        number, rest = divmod(position, self.total) if self.loop else (0, min(position, self.total))
        which = f"pass {number + 1:.0f}, " if self.loop else ""
        speed = f"{(position - before) / elapsed:.2f} x, {(messages - count) / elapsed:.0f} messages/s"
        self._bar.show(rest, f"{which}{rest:.1f} of {self.total:.1f} s", speed)

    def end(self) -> None:
        """Leave the bar."""
        self._bar.end()
