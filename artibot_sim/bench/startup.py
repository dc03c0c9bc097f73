"""How long a fresh process takes to its first finished rollout, with and without compiled code at hand."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

import numpy as np

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.errors import ArtibotError

PROGRAM = """
import time
from artibot_sim.model import load_robot, rollout
from artibot_sim.planning import load_manoeuvre, plan
robot = load_robot("agriq")
result = rollout(robot, plan(load_manoeuvre("table6_agriq"), robot).commands())
print(time.monotonic(), time.process_time())
assert result.status == 0
"""
"""What is started: plan and simulate Table 6. The steady clock is the machine's, the same in both processes."""


def first_rollout(cache: str) -> tuple[float, float]:
    """Seconds from the start of a process to the end of its first rollout, compiled code kept in `cache`.

    Returns
    -------
    tuple of 2 floats
        Wall time, and the process's CPU time up to then.
    """
    environment = {**os.environ, "ARTIBOT_CACHE_DIR": cache, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    start = time.monotonic()
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ArtibotError(f"bench: a fresh process failed to simulate: {done.stderr.strip().splitlines()[-1:]}")
    end, cpu = done.stdout.split()[-2:]
    return float(end) - start, float(cpu)


def starts(scenario: Scenario) -> list[Result]:
    """Cold, with an empty cache, and warm, with the cache that the cold start left."""
    cold: list[tuple[float, float]] = []
    warm: list[tuple[float, float]] = []
    for _ in range(1 if scenario.quick else 3):
        with tempfile.TemporaryDirectory(prefix="artibot-bench-") as cache:
            cold.append(first_rollout(cache))
            scenario.tick()
            for _ in range(scenario.runs(5)):
                warm.append(first_rollout(cache))
                scenario.tick()
    return [_result("start_cold", cold, "empty"), _result("start_warm", warm, "filled")]


def _result(name: str, runs: list[tuple[float, float]], cache: str) -> Result:
    wall, cpu = np.array(runs).T
    note = f"process start to the end of the first rollout (Table 6, RK4 1 ms), {cache} cache of compiled code"
    detail = {"median": float(np.median(wall)), "by_cpu_time": float(cpu.min()), "runs": len(runs)}
    return Result(name, float(wall.min()), "s", note, detail)
