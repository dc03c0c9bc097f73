"""Deadlines on the steady clock, serving between two of them, and statistics of both."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# Serving between two periods of a loop, and the statistic of how long that held the loop up.
# ----------------------------------------------------------------------


TURNS_KEPT = 1 << 16
"""How many of the last turns are kept (22 minutes at 50 Hz)."""


class Server:
    """Calls what the executor has to call, one callback a turn, and times each turn."""

    def __init__(self) -> None:
        self._wall, self._cpu = np.zeros(TURNS_KEPT), np.zeros(TURNS_KEPT)
        self._turns = 0
        self._most = (0.0, 0.0)

    def turn(self, executor: Any) -> None:
        """Make at most one callback: a service, a parameter, a transition."""
        wall, cpu = time.monotonic_ns(), time.thread_time_ns()
        executor.spin_once(timeout_sec=0.0)
        took = 1e-6 * (time.monotonic_ns() - wall), 1e-6 * (time.thread_time_ns() - cpu)
        k = self._turns % TURNS_KEPT
        self._wall[k], self._cpu[k] = took
        self._most = max(self._most[0], took[0]), max(self._most[1], took[1])
        self._turns += 1

    @property
    def most_ms(self) -> float:
        """The longest turn so far, ms of wall time."""
        return self._most[0]

    def statistics(self) -> dict[str, Any]:
        """Turns, and what they took, ms: wall time, which a busy machine lengthens, and the thread's own."""
        kept = slice(0, min(self._turns, TURNS_KEPT))
        p99 = [float(np.percentile(each[kept], 99)) if self._turns else 0.0 for each in (self._wall, self._cpu)]
        return {
            "callback_turns": self._turns,
            "callback_wall_p99_ms": p99[0],
            "callback_wall_max_ms": self._most[0],
            "callback_cpu_p99_ms": p99[1],
            "callback_cpu_max_ms": self._most[1],
        }


# ----------------------------------------------------------------------
# What is said again and again, said once in a while. rclpy's own throttle looks for its caller's file at every call,
# whether it says something or not: 0.1 ms, and more on a machine that is late already.
# ----------------------------------------------------------------------


class Seldom:
    """Whether it is time to say something again.

    Parameters
    ----------
    seconds : float
        How long it is not said again, steady s.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds, self._next = seconds, -math.inf

    def due(self) -> bool:
        """True the first time, and once it has not been for that long."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + self._seconds
        return True


# ----------------------------------------------------------------------
# Pacing on a steady clock with absolute deadlines, and the statistic of how late publications were.
# ----------------------------------------------------------------------


MAX_LAG_NS = 250_000_000
"""A machine that is further behind than this is not asked to catch up: the simulation slips instead."""

KEPT = 1 << 18
"""How many of the last latenesses are kept (44 minutes at 100 Hz)."""


class Pacer:
    """Deadlines one period apart, from the moment of :meth:`start`; no error adds up.

    Parameters
    ----------
    period_ns : int
        Simulated time between two deadlines.
    rate : float
        Simulated over real time; 0 for no deadlines at all.
    """

    def __init__(self, period_ns: int, rate: float) -> None:
        self.rate = rate
        self._wall_ns = round(period_ns / rate) if rate else 0
        self._period_ns = period_ns
        self._late = np.zeros(KEPT)
        self._steps = self._overruns = self._slips = 0
        self._worst = 0.0
        self._deadline = self._began = time.monotonic_ns()
        self._cpu = time.process_time()

    def start(self) -> None:
        """The next deadline is one period from now. Statistics count from the first start."""
        now = time.monotonic_ns()
        if not self._steps:
            self._began, self._cpu = now, time.process_time()
        self._deadline = now + self._wall_ns

    def remaining(self) -> float:
        """Seconds to the deadline, negative when it is over."""
        return (self._deadline - time.monotonic_ns()) * 1e-9 if self.rate else 0.0

    @property
    def deadline_ns(self) -> int:
        """Steady time of the deadline, ns."""
        return self._deadline

    def due_ns(self) -> int:
        """System time of the deadline, ns since 1970, as the system clock stands now."""
        return time.time_ns() + round(self.remaining() * 1e9)

    @property
    def overruns(self) -> int:
        """How many steps were published more than a period late."""
        return self._overruns

    def done(self) -> int:
        """Note that the step of this deadline is published, and go on to the next deadline.

        Returns
        -------
        int
            Real nanoseconds by which the schedule slipped because the machine is too slow; mostly 0.
        """
        now = time.monotonic_ns()
        late = now - self._deadline if self.rate else 0
        self._late[self._steps % KEPT] = late
        self._worst = max(self._worst, late)
        self._steps += 1
        self._overruns += bool(self.rate and late > self._wall_ns)
        self._deadline += self._wall_ns
        if self.rate and late > MAX_LAG_NS:
            self._slips += 1
            self._deadline = now + self._wall_ns
            return late
        return 0

    def skip(self) -> int:
        """Note that the step of this deadline is done, and go on to the first deadline that is not over.

        Returns
        -------
        int
            Deadlines from this one to the next: 1, and more where some were missed. They are not made up for.
        """
        self.done()
        missed = max(0, -round(self.remaining() * 1e9) // self._wall_ns)
        self._deadline += missed * self._wall_ns
        return 1 + missed

    def recent(self, steps: int, percentile: float) -> float:
        """A percentile of how late the last steps were, s."""
        count = min(self._steps, steps, KEPT)
        last = self._late[np.arange(self._steps - count, self._steps) % KEPT]
        return float(np.percentile(last, percentile)) * 1e-9 if count else 0.0

    def statistics(self) -> dict[str, Any]:
        """Lateness of publication (ms after the deadline), overruns, share of one core, since the first step."""
        wall = max(time.monotonic_ns() - self._began, 1) * 1e-9
        late = self._late[: min(self._steps, KEPT)] * 1e-6
        p50, p99 = (float(np.percentile(late, q)) if len(late) else 0.0 for q in (50, 99))
        return {
            "steps": self._steps,
            "rate": self.rate,
            "period_s": self._period_ns * 1e-9,
            "wall_s": wall,
            "achieved_rate": self._steps * self._period_ns * 1e-9 / wall,
            "cpu_share": (time.process_time() - self._cpu) / wall,
            "late_p50_ms": p50,
            "late_p99_ms": p99,
            "late_max_ms": self._worst * 1e-6,
            "overruns": self._overruns,
            "slips": self._slips,
        }


def check_stats(name: str) -> None:
    """Refuse a file of statistics whose folder is missing: a run of hours must not find out at its end.

    Raises
    ------
    ArtibotError
        Naming the file.
    """
    path = Path(name)
    if name and not path.parent.is_dir():
        raise ArtibotError(f"parameter stats: {path}: there is no folder {path.parent}; make it first")


def write_statistics(path: Path | None, statistics: dict[str, Any]) -> None:
    """Write statistics as JSON, whole or not at all; nothing where no file is asked for.

    Raises
    ------
    ArtibotError
        When the file cannot be written.
    """
    if path is None:
        return
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(json.dumps(statistics, indent=2) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise ArtibotError(f"stats: {path} cannot be written: {error.strerror}") from error
