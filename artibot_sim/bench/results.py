"""What a benchmark finds, timed on a machine that others use too, and the file that the contract describes."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.simulate.batch import available_cores
from artibot_sim.version import __version__

# ----------------------------------------------------------------------
# Timing on a machine that others use too: the best of many, and how much the rest were disturbed.
# ----------------------------------------------------------------------


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


# ----------------------------------------------------------------------
# What a benchmark finds, and the file that the contract describes.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Peer:
    """What another program reached at this benchmark in this run; `by_cpu_time` is its value by CPU time."""

    name: str
    value: float
    unit: str
    by_cpu_time: float | None = None


@dataclass(frozen=True)
class Result:
    """One number.

    Attributes
    ----------
    name, unit : str
    value : float
        The best of the runs where there are several: what others on the machine disturbed least.
    note : str
        What was measured, in a line.
    detail : mapping
        More numbers (median, runs, spread, …), which go to the file as they are.
    """

    name: str
    value: float
    unit: str
    note: str = ""
    detail: dict[str, float] = field(default_factory=dict)
    peer: Peer | None = None

    def beside(self, peer: Peer | None) -> Result:
        """This result with another program's beside it."""
        return replace(self, peer=peer)

    def as_json(self) -> dict[str, Any]:
        """As the contract has it, with the details beside."""
        own = {"name": self.name, "value": self.value, "unit": self.unit, "peer": self.peer and asdict(self.peer)}
        return {**self.detail, "note": self.note} | own


@dataclass(frozen=True)
class Skipped:
    """A benchmark that could not be run here, or failed, and why."""

    name: str
    reason: str
    failed: bool = False


def machine() -> dict[str, Any]:
    """What the numbers were measured on and with."""
    return {
        "cpu": _cpu(),
        "cores": available_cores(),
        "load_average": round(os.getloadavg()[0], 2),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "numba": _version("numba"),
        "numpy": _version("numpy"),
        "mujoco": _version("mujoco"),
        "artibot": __version__,
        "commit": _commit(),
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    """The checkout's commit, with a + where files were changed; None for an installed copy."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None

    def git(*args: str) -> str:
        command = ["git", "-C", str(root), *args]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return None


def write_json(path: Path, machine: dict[str, Any], results: Sequence[Result], skipped: Sequence[Skipped]) -> None:
    """Write the contract's file, whole or not at all."""
    content = {
        "machine": machine,
        "results": [result.as_json() for result in results],
        "skipped": [asdict(skip) for skip in skipped],
    }
    part = path.with_name(f".{path.name}.part")
    part.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(path)
