"""How far a replay is: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import sys
import time
from typing import Any

PERIOD = 0.25
"""s between two pictures; drawing one takes a few ms, in which no message is published."""


class Progress:
    """A bar with position, speed and messages a second.

    Parameters
    ----------
    total : s of one pass.
    loop : whether there are more passes.
    """

    def __init__(self, total: float, loop: bool = False) -> None:
        self.total = total
        self.loop = loop
        self._next = 0.0
        self._last: tuple[float, float, int] | None = None
        self._bar: Any = None
        self._task: Any = None
        if sys.stderr.isatty():
            self._start()

    def _start(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        columns = (TextColumn("{task.fields[at]}"), BarColumn(), TextColumn("{task.fields[speed]}"))
        self._bar = Progress(*columns, console=Console(stderr=True), auto_refresh=False)
        self._task = self._bar.add_task("replay", total=self.total, at="", speed="")
        self._bar.start()

    def show(self, position: float, messages: int) -> None:
        """Draw, if it is time to: `position` in recorded s since the first pass began."""
        now = time.monotonic()
        if self._bar is None or now < self._next:
            return
        self._next = now + PERIOD
        then, before, count = self._last or (now, position, messages)
        self._last = (now, position, messages)
        elapsed = max(now - then, 1e-9)
        number, rest = divmod(position, self.total) if self.loop else (0, min(position, self.total))
        which = f"pass {number + 1:.0f}, " if self.loop else ""
        self._bar.update(
            self._task,
            completed=rest,
            at=f"{which}{rest:.1f} of {self.total:.1f} s",
            speed=f"{(position - before) / elapsed:.2f} x, {(messages - count) / elapsed:.0f} messages/s",
        )
        self._bar.refresh()

    def end(self) -> None:
        """Leave the bar."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
