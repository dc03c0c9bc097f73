"""Timing on a machine that others use too: the best of many, and how much the rest were disturbed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Timing:
    """Wall time and this thread's CPU time of each run, s."""

    wall: Array
    cpu: Array

    @property
    def best(self) -> float:
        """The shortest wall time, s: the least disturbed."""
        return float(self.wall.min())

    @property
    def median(self) -> float:
        """The median wall time, s."""
        return float(np.median(self.wall))

    @property
    def spread(self) -> float:
        """Distance of the quartiles over the median."""
        low, high = np.percentile(self.wall, [25, 75])
        return float((high - low) / self.median)

    def per_second(self, count: float) -> dict[str, float]:
        """`count` things a run as rates: median, by CPU time of the thread, runs and spread."""
        return {
            "median": count / self.median,
            "by_cpu_time": count / max(float(self.cpu.min()), 1e-9),
            "runs": len(self.wall),
            "spread": self.spread,
        }


def repeat(function: Callable[[], object], runs: int, tick: Callable[[], None] = lambda: None) -> Timing:
    """Call once to warm up, then `runs` times on the clock; `tick` after each."""
    function()
    wall, cpu = [], []
    for _ in range(runs):
        cpu_before, before = time.thread_time(), time.perf_counter()
        function()
        wall.append(time.perf_counter() - before)
        cpu.append(time.thread_time() - cpu_before)
        tick()
    return Timing(np.array(wall), np.array(cpu))


def thread_waited() -> float | None:
    """How long this thread has been ready to run without a core so far, s; None where Linux does not say."""
    try:
        return int(Path("/proc/thread-self/schedstat").read_text(encoding="ascii").split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return None
