"""What a run of a sweep costs, measures and table included."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.bench.speed import ALL_EFFECTS, BatchTiming, soils
from artibot_sim.model.batch import available_cores

WAYS: dict[str, dict[str, Any]] = {
    "sweep_rk4_1ms": {"integrator": "rk4", "dt": 1e-3},
    "sweep_rk4_1ms_no_energy": {"integrator": "rk4", "dt": 1e-3, "energy": False},
    "sweep_semi_implicit_2ms": {"integrator": "semi_implicit", "dt": 2e-3},
    "sweep_semi_implicit_2ms_no_energy": {"integrator": "semi_implicit", "dt": 2e-3, "energy": False},
}
"""Result → how its runs are simulated."""


def sweeps(scenario: Scenario) -> list[Result]:
    """Runs of Table 6 per second of one core, from parameters to the rows of a table."""
    from artibot_sim.sweep import plan_from_dict
    from artibot_sim.sweep.chunk import run_chunk

    count = 4 if scenario.quick else 64
    axes = {"contact.k_l": {"from": 1500, "to": 3500}, "contact.mu_s": {"from": 0.45, "to": 0.9}}
    results = []
    for name, way in WAYS.items():
        plan = plan_from_dict({"axes": axes, "method": "latin", "runs": count, **way})
        task = {"plan": plan.as_task(), "first": 0, "values": plan.columns(0, count), "threads": 1}
        run_chunk(task | {"values": plan.columns(0, 1)})
        walls, cpus = [], []
        for _ in range(scenario.runs(4)):
            wall, cpu = time.perf_counter(), time.thread_time()
            run_chunk(task)
            walls.append(time.perf_counter() - wall)
            cpus.append(time.thread_time() - cpu)
            scenario.tick()
        million = min(cpus) / count * 1e6 / 3600
        note = f"runs of Table 6 (28.85 s of motion), one core; a million of them take {million:.1f} hours of a core"
        detail = {"by_cpu_time": count / min(cpus), "core_hours_per_million": million, "runs": len(walls)}
        results.append(Result(name, count / min(walls), "runs/s", note, detail))
    return results


def batch_with_effects(scenario: Scenario) -> list[Result]:
    """A batch over soils on all cores with every effect that acts in the model."""
    cores, count = available_cores(), 4 if scenario.quick else 32
    robots = [dataclasses.replace(robot, effects=ALL_EFFECTS) for robot in soils(scenario.robot, count)]
    BatchTiming(scenario, robots[:2], cores)
    wall = min(BatchTiming(scenario, robots, cores).wall for _ in range(scenario.runs(4)))
    note = f"{count} soils, RK4 at 1 ms, all effects, first and last row kept, threads on {cores} cores"
    rate = scenario.steps(1e-3) * count / wall
    return [Result("batch_rk4_all_effects_all_cores", rate, "steps/s", note, {"cores": cores})]
