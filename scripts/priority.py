"""Computing that makes way for whatever else runs: a command begun that way, and its processes made usual again.

::

    scripts/priority.py low COMMAND [ARGUMENT …]
    scripts/priority.py usual GROUP

`low` runs the command with the scheduler's policy for idle times: it gets the processor only while nobody else wants
it. `usual` ends that for all processes of a group; where this user may not, they stay as they are.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


def low(command: list[str]) -> None:
    """Become the command, of the lowest priority that there is."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.execvp(command[0], command)


def usual(group: int) -> None:
    """Every thread of a group's processes is scheduled as usual again."""
    for thread in threads(group):
        with suppress(OSError):
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


def threads(group: int) -> Iterator[int]:
    """Numbers of all threads of a group's processes."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.getpgid(int(process.name)) == group:
                yield from (int(thread.name) for thread in (process / "task").iterdir())


if __name__ == "__main__":
    what, *rest = sys.argv[1:]
    low(rest) if what == "low" else usual(int(rest[0]))
