"""Real-time quality of the nodes, from the statistics that they write themselves."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.errors import ArtibotError
from artibot_sim.resources import local_environment

NO_ROS = "rclpy is not installed; source a ROS 2 Jazzy, or pip install 'artibot_sim[ros]'"
PLANNER_READY = 3.0
"""How long the planner gets to start before the simulator, whose statistics it would disturb, s."""


def missing() -> str | None:
    """Why the nodes cannot run here, or None."""
    return None if importlib.util.find_spec("rclpy") else NO_ROS


def replay_missing() -> str | None:
    """Why replay cannot be measured here, or None."""
    if missing():
        return missing()
    if importlib.util.find_spec("artibot_sim.nodes.replay_node") is None:
        return "this version has no replay"
    shown = subprocess.run([*word_of("replay"), "--help"], capture_output=True, text=True, check=False)
    return None if "--stats" in shown.stdout else "replay has no --stats to measure itself with"


def sim(scenario: Scenario) -> list[Result]:
    """The sim node in real time, physics at 1 kHz and topics at 100 Hz, driven along Table 6 by the planner."""
    seconds = 4 if scenario.quick else 20
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        stats = Path(folder) / "sim.json"
        with started("planner", ["table6_agriq", "--keep"], folder):
            pause(PLANNER_READY, scenario)
            with started("sim", ["--duration", str(seconds), "--stats", str(stats)], folder) as process:
                found = statistics_of(process, stats, seconds + 60, scenario)
    note = f"sim node in real time, RK4 at 1 kHz, topics at 100 Hz, driving Table 6 for {found['wall_s']:.0f} s"
    late = ("late_p50_ms", "late_max_ms", "overruns", "steps")
    return [
        Result("sim_node_cpu_share", found["cpu_share"], "cores", note),
        Result("sim_node_late_p99", found["late_p99_ms"], "ms", f"{note}; load {os.getloadavg()[0]:.1f}",
               {key: found[key] for key in late} | load()),
    ]  # fmt: skip


def replay(scenario: Scenario) -> list[Result]:
    """Replay of a computed recording of Table 6 with its recorded timing."""
    from artibot_sim.experiment import write_experiment

    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        bag, stats = Path(folder) / "table6", Path(folder) / "replay.json"
        write_experiment(bag, scenario.rollout("rk4", 1e-3), scenario.plan, scenario.robot)
        end = ["--end", "4"] if scenario.quick else []
        with started("replay", [str(bag), *end, "--stats", str(stats)], folder) as process:
            found = statistics_of(process, stats, 120, scenario)
    if "late_p99_ms" not in found:
        raise ArtibotError(f"bench: replay --stats wrote {sorted(found)}; expected late_p99_ms")
    numbers = {key: value for key, value in found.items() if isinstance(value, int | float) and key != "late_p99_ms"}
    note = f"published after the recorded instant, Table 6 at its own pace; load {os.getloadavg()[0]:.1f}"
    return [Result("replay_late_p99", found["late_p99_ms"], "ms", note, numbers | load())]


def load() -> dict[str, float]:
    """How busy the machine was: lateness tells about the node only where a core was free."""
    return {"load_average": os.getloadavg()[0]}


def word_of(word: str) -> list[str]:
    return [sys.executable, "-m", "artibot_sim.cli", word]


def environment_of(log: str) -> dict[str, str]:
    """On this machine only, and in a domain of its own, unless the caller chose one."""
    own = {**local_environment(), "ROS_LOG_DIR": log}
    path = os.pathsep.join(filter(None, sys.path))
    return {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), **os.environ, **own, "PYTHONPATH": path}


@contextmanager
def started(word: str, arguments: list[str], folder: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is asked to end, and then made to, when the block is left."""
    with (
        open(Path(folder) / f"{word}.log", "wb") as log,
        subprocess.Popen([*word_of(word), *arguments], stdout=log, stderr=log, env=environment_of(folder)) as process,
    ):
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(5.0)
                except subprocess.TimeoutExpired:
                    process.kill()


def statistics_of(process: subprocess.Popen[bytes], stats: Path, timeout: float, scenario: Scenario) -> dict[str, Any]:
    """What a node wrote when it came to its own end."""
    deadline = time.monotonic() + timeout
    while process.poll() is None and time.monotonic() < deadline:
        pause(0.2, scenario)
    if process.returncode != 0 or not stats.exists():
        lines = stats.with_suffix(".log").read_text(encoding="utf-8", errors="replace").splitlines()
        said = lines[-1] if lines else "nothing"
        raise ArtibotError(f"bench: {stats.stem} ended with status {process.returncode} and said: {said}")
    found: dict[str, Any] = json.loads(stats.read_text(encoding="utf-8"))
    return found


def pause(seconds: float, scenario: Scenario) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        time.sleep(min(left, 0.1))
        scenario.tick()
