"""What a benchmark finds, and the file that the contract describes."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from artibot_sim.model.batch import available_cores
from artibot_sim.version import __version__


@dataclass(frozen=True)
class Peer:
    """The same measured with another program in the same run; `by_cpu_time` is the value by its CPU time."""

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
        """The same with a peer."""
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
