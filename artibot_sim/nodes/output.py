"""Log lines hold no loop up: where those who should read them do not, lines are lost instead of waited for."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager

_STDERR = 2
"""What rclpy logs to."""


@contextmanager
def never_held_up(descriptor: int = _STDERR) -> Iterator[None]:
    """Meanwhile nothing that is written to a pipe or a terminal waits for its reader.

    A terminal that was stopped (Ctrl-S), or a launcher that hangs, would else stop a loop at one of its log lines as
    soon as what waits to be read is full. The pipe is opened anew for that: flags of one that was inherited are those
    of everybody who has it, the shell among them. Files and what cannot be opened anew (a socket) stay as they are.

    Parameters
    ----------
    descriptor : int
        Open, of this process.
    """
    mode = os.fstat(descriptor).st_mode
    if not (stat.S_ISFIFO(mode) or os.isatty(descriptor)):
        yield
        return
    before = os.dup(descriptor)
    try:
        _replace(descriptor)
        yield
    finally:
        os.dup2(before, descriptor)
        os.close(before)


def _replace(descriptor: int) -> None:
    """Put the same pipe or terminal, opened anew, in a descriptor's place, where the system lets it be opened."""
    try:
        mine = os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError:
        return
    os.dup2(mine, descriptor)
    os.close(mine)
