"""How the demo shows its steps: a line each, and on a terminal a spinner while one runs, with a bar if it can."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text


class Steps:
    """Shows steps one after the other.

    Parameters
    ----------
    console : rich.console.Console
        Where to; what is no terminal gets plain lines.
    total : int
        How many steps there will be.
    """

    def __init__(self, console: Console, total: int) -> None:
        self.console = console
        self.total = total
        self._number = 0
        self._name = ""
        self._began = 0.0
        self._live: Live | None = None
        self._spinner = Spinner("dots")
        self._note: Callable[[], str] = str

    def begin(self, name: str, command: str, note: Callable[[], str] = str) -> None:
        """Begin a step: what it is, what a user would type, and what to say beside the spinner."""
        self._number += 1
        self._name, self._began, self._note = name, time.monotonic(), note
        head = Text.assemble((f"[{self._number}/{self.total}] ", "dim"), (name, "bold"))
        self.console.print(head)
        self.console.print(Text.assemble(("      $ ", "dim"), (command, "cyan")), soft_wrap=True)
        if self.console.is_terminal:
            self._spinner = Spinner("dots")
            self._live = Live(self._spinner, console=self.console, transient=True, auto_refresh=False)
            self._live.start()

    def tick(self) -> None:
        """Keep the spinner turning; to be called often."""
        if self._live is not None:
            note = self._note()
            self._spinner.update(text=Text(f" {time.monotonic() - self._began:4.1f} s  {note}", style="dim"))
            row = Table.grid(padding=(0, 2))
            far = re.search(r"(\d+) of (\d+)", note)
            bar = [ProgressBar(total=float(far[2]), completed=float(far[1]), width=24)] if far else []
            row.add_row(self._spinner, *bar)
            self._live.update(row, refresh=True)

    def done(self, what: str) -> None:
        """End the step and say what came of it."""
        self.stop()
        took = time.monotonic() - self._began
        self.console.print(Text.assemble(("      ✓ ", "green"), what, (f"  ({took:.1f} s)", "dim")), soft_wrap=True)

    def stop(self) -> None:
        """Take the spinner away, whatever became of the step."""
        if self._live is not None:
            self._live.stop()
            self._live = None
