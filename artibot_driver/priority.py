"""Real-time priority, where the system grants it: a busy machine then delays everything else before the bus."""

from __future__ import annotations

import contextlib
import os


def take_priority(priority: int) -> str:
    """Have this thread, and those that it starts from now on, preferred to all ordinary ones (SCHED_FIFO).

    Parameters
    ----------
    priority : int
        1 to 99; 0 changes nothing.

    Returns
    -------
    str
        Why it was not granted, or empty.
    """
    try:
        if priority:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError) as error:  # no right to, or not Linux
        return str(error)
    return ""


def drop_priority() -> None:
    """Have this thread treated as an ordinary one again."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
