"""Serving between two periods of a loop, and the statistic of how long that held the loop up."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

KEPT = 1 << 16
"""How many of the last turns are kept (22 minutes at 50 Hz)."""


class Server:
    """Calls what the executor has to call, one callback a turn, and times each turn."""

    def __init__(self) -> None:
        self._wall, self._cpu = np.zeros(KEPT), np.zeros(KEPT)
        self._turns = 0
        self._most = (0.0, 0.0)

    def turn(self, executor: Any) -> None:
        """Make at most one callback: a service, a parameter, a transition."""
        wall, cpu = time.monotonic_ns(), time.thread_time_ns()
        executor.spin_once(timeout_sec=0.0)
        took = 1e-6 * (time.monotonic_ns() - wall), 1e-6 * (time.thread_time_ns() - cpu)
        k = self._turns % KEPT
        self._wall[k], self._cpu[k] = took
        self._most = max(self._most[0], took[0]), max(self._most[1], took[1])
        self._turns += 1

    @property
    def most_ms(self) -> float:
        """The longest turn so far, ms of wall time."""
        return self._most[0]

    def statistics(self) -> dict[str, Any]:
        """Turns, and what they took, ms: wall time, which a busy machine lengthens, and the thread's own."""
        kept = slice(0, min(self._turns, KEPT))
        p99 = [float(np.percentile(each[kept], 99)) if self._turns else 0.0 for each in (self._wall, self._cpu)]
        return {
            "callback_turns": self._turns,
            "callback_wall_p99_ms": p99[0],
            "callback_wall_max_ms": self._most[0],
            "callback_cpu_p99_ms": p99[1],
            "callback_cpu_max_ms": self._most[1],
        }
