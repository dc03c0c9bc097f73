"""What this machine could do at most, and how much of that a rollout uses."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench.model import BatchTiming, Scenario, soils
from artibot_sim.bench.results import Result
from artibot_sim.errors import ArtibotError
from artibot_sim.model.simulate.batch import available_cores

ELEMENTS, CHAIN = 512, 32
"""Numbers in the first cache, and multiply-adds on each between load and store."""


@numba.njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _multiply_add(x: NDArray[np.float64], rounds: int) -> float:
    """`rounds` times CHAIN fused multiply-adds on every element of `x`, all elements independent."""
    for _ in range(rounds):
        for i in range(x.shape[0]):
            y = x[i]
            for _ in range(CHAIN):
                y = y * 0.999999 + 1e-6
            x[i] = y
    return x[0]


def flops_per_second(threads: int, runs: int = 60, rounds: int = 1_000) -> float:
    """Multiply-adds, counted as two operations each, on so many threads: the best of many runs of a few ms."""
    arrays = [np.full(ELEMENTS, 1.0 + i) for i in range(threads)]
    _multiply_add(arrays[0], 1)
    best = 0.0
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(runs + 1):
            start = time.perf_counter()
            list(pool.map(_multiply_add, arrays, [rounds] * threads))
            best = max(best, 2.0 * ELEMENTS * CHAIN * rounds * threads / (time.perf_counter() - start))
    return best


def operations_of_a_step() -> int:
    """Floating-point operations of one RK4 step, counted by running it uncompiled with numbers that count."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", "artibot_sim.bench.flops"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ArtibotError(f"bench: operations could not be counted: {done.stderr.strip().splitlines()[-1:]}")
    return int(done.stdout.split()[-1])


def peak(scenario: Scenario) -> list[Result]:
    """The machine's peak in this very run, and the fraction that a rollout and a batch reach."""
    cores = available_cores()
    one, every = flops_per_second(1), flops_per_second(cores)
    scenario.tick()
    operations = operations_of_a_step()
    scenario.tick()
    robots = soils(scenario.robot, 8 if scenario.quick else 64)
    BatchTiming(scenario, robots[:2], cores)
    wall = min(BatchTiming(scenario, robots, cores).wall for _ in range(scenario.runs(4)))
    single = min(BatchTiming(scenario, robots[:4], 1).wall for _ in range(scenario.runs(4)))
    steps = scenario.steps(1e-3)
    rate, alone = steps * len(robots) / wall, steps * 4 / single
    note = "fused multiply-adds in vector registers, counted as two operations"
    said = f"{operations} operations (+ − × ÷ √, counted) a RK4 step, over the peak of the same run"
    detail = {"operations": float(operations)}
    return [
        Result("peak_one_core", one, "flop/s", f"{note}, one core"),
        Result("peak_all_cores", every, "flop/s", f"{note}, {cores} cores"),
        Result("peak_fraction_one_core", 100 * alone * operations / one, "%", f"rollouts one by one: {said}", detail),
        Result(
            "peak_fraction_all_cores", 100 * rate * operations / every, "%", f"batch, {cores} cores: {said}", detail
        ),
    ]
