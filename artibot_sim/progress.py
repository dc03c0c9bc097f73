"""How far a piece of work is: one bar for everything that may take longer than two seconds.

It is drawn on standard error where that is a terminal, and gone when the work is over. In a pipe or a log a line says
twice a minute how far long work is, and short work says nothing. Libraries know nothing of it: they call a function
with the share of their work that is done, 0 to 1.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

Report = Callable[[float], None]
"""Called with the share that is done."""

DELAY = 0.5
"""Work that is over sooner (s) shows no bar."""
PERIOD = 0.1
"""s between two pictures; one takes a few ms."""
LINES = 30.0
"""s between two lines where standard error is no terminal, and before the first."""
_LEAST = 0.02
"""Before this share is done nothing is said of the time left."""


compiling: list[Callable[[bool], None]] = []
"""Called with True when compilation of a loop of the model begins, with False when it is over; empty in a library."""


@contextmanager
def told_of_compiling(listener: Callable[[bool], None]) -> Iterator[None]:
    """Within, a function is called as those in `compiling`."""
    compiling.append(listener)
    try:
        yield
    finally:
        compiling.remove(listener)


class CompilationNotice:
    """A bar without an end while the model is compiled, which happens once on a machine and takes seconds.

    It stays away where another bar is drawn.
    """

    def __init__(self) -> None:
        self._rich: Any = None

    def __call__(self, begins: bool) -> None:
        """Draw it, or take it away."""
        if self._rich is not None:
            self._rich.stop()
            self._rich = None
        if begins and not Bar.drawn and sys.stderr.isatty():
            self._rich = _progress(auto_refresh=True)
            self._rich.add_task("compiling the model for this machine, once", total=None, note="a few seconds")
            self._rich.start()


def _progress(auto_refresh: bool) -> Any:
    """Rich's columns: what, how far, and a note."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.fields[note]}"))
    return Progress(*columns, console=Console(stderr=True), transient=True, auto_refresh=auto_refresh)


class Bar:
    """A bar with what is done at present, and how much time is left.

    Parameters
    ----------
    total : float or None
        Size of the whole work, in any unit; None where nobody knows.
    delay, period, lines : float
        s before the first picture, and between two; s between two lines where there is no terminal.
    kept : bool
        Whether something is kept of work that is interrupted: then whoever keeps it says so. Else the bar says that
        it is lost.

    Examples
    --------
    >>> with Bar(total=3.0) as bar:                            # doctest: +SKIP
    ...     experiment = read_bag(path, progress=bar.stage("reading", 2.0))
    ...     draw(experiment, progress=bar.stage("drawing", 1.0))
    """

    drawn = 0
    """Bars on the terminal now."""

    def __init__(
        self, total: float | None = 1.0, *, delay: float = DELAY, period: float = PERIOD, lines: float = LINES,
        kept: bool = False,
    ) -> None:  # fmt: skip
        self.total = total
        self._kept = kept
        self._terminal = sys.stderr.isatty()
        self._period = period if self._terminal else lines
        self._began = time.monotonic()
        self._next = self._began + (delay if self._terminal else lines)
        self._stage = (0.0, 0.0)  # begin and size of the present stage
        self._rich: Any = None
        self._what = ""

    def __enter__(self) -> Bar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()
        if kind is KeyboardInterrupt and not self._kept:
            doing = f" ({self._what})" if self._what else ""
            print(f"interrupted{doing}: what was not finished is lost", file=sys.stderr)

    def stage(self, what: str, size: float) -> Report:
        """Begin the next part of the work, of this size: what came before is done."""
        begin = sum(self._stage)
        self._stage = (begin, size)
        self._what = what
        self.show(begin)
        return lambda share: self.show(begin + size * min(max(share, 0.0), 1.0))

    def stages(self, size: float) -> Callable[[float, str, str], None]:
        """Begin the next part of the work, of this size, which names its stages and says what time is left."""
        begin = sum(self._stage)
        self.stage(self._what, size)
        return lambda share, what, left: self.show(begin + size * share, what, left)

    def show(self, done: float, what: str | None = None, note: str | None = None) -> None:
        """Draw, if it is time to: how much is done, what is being done, and instead of the time left a note."""
        if what is not None:
            self._what = what
        now = time.monotonic()
        if not self.due(now):
            return
        self._next = now + self._period
        note = self._time_left(done, now) if note is None else note
        if not self._terminal:
            print(f"{self._what}: {note}" if note else self._what, file=sys.stderr, flush=True)
            return
        if self._rich is None:
            self._start()
        self._rich.update(self._rich.task_ids[0], completed=done, description=self._what, note=note)
        self._rich.refresh()

    def due(self, now: float) -> bool:
        """Whether `show` would draw at this steady time, s."""
        return now >= self._next

    def end(self) -> None:
        """Take the bar away."""
        if self._rich is not None:
            self._rich.stop()
            self._rich = None
            Bar.drawn -= 1

    def _start(self) -> None:
        self._rich = _progress(auto_refresh=False)
        self._rich.add_task(self._what, total=self.total, note="")
        self._rich.start()
        Bar.drawn += 1

    def _time_left(self, done: float, now: float) -> str:
        if not self.total:
            return ""
        share = min(done / self.total, 1.0)
        if share < _LEAST:
            return f"{share:4.0%}"
        left = round((now - self._began) * (1.0 - share) / share)
        return f"{share:4.0%}, {left // 60}:{left % 60:02d} left"
