"""Speed of what identification and diagnosis spend their time on: short windows of a recording, as sensors see them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import KEPT_EVERY, Scenario
from artibot_sim.bench.speed import ALL_EFFECTS, soils
from artibot_sim.bench.timing import Timing, repeat
from artibot_sim.model import Mode, Robot, Rollout, rollout
from artibot_sim.model.batch import available_cores
from artibot_sim.model.windows import KINDS, Items, MotorTable, Plan, WindowBatch

DT = 5e-3
"""Integration step of fits, s."""
LENGTH = 200
"""Knots of a window: 2 s."""
RATES = {
    "x": 20, "y": 20, "yaw": 20, "articulation_yaw": 50, "yaw_rate": 50, "torque_front_right": 50,
    "torque_front_left": 50, "torque_back_right": 50, "torque_back_left": 50,
}  # fmt: skip
"""What is sampled how often, Hz."""


def windows(scenario: Scenario) -> list[Result]:
    """Windows × soils: the paper's model, with an effect, and with all of them; against single rollouts of this run."""
    truth = scenario.rollout("rk4", 1e-3)
    robots = soils(scenario.robot, 4 if scenario.quick else 8)
    single = repeat(lambda: rollout(scenario.robot, scenario.commands, every=10), scenario.runs(10), scenario.tick)
    alone = scenario.steps(1e-3) / single.best
    kinds: dict[str, dict[str, dict[str, float | str]]] = {
        "windows": {},
        "windows_one_effect": {"joint_friction": {"torque": 5.0}},
        "windows_all_effects": ALL_EFFECTS,
    }
    results = []
    for name, effects in kinds.items():
        changed = [dataclasses.replace(robot, effects=effects) for robot in robots]
        steps, timing = _timed(scenario, truth, changed, None)
        _, one = _timed(scenario, truth, changed, 1)
        note = (
            f"{len(robots)} soils, windows of {LENGTH * KEPT_EVERY:g} s at {DT * 1e3:g} ms, sampled; "
            f"{steps / timing.best / alone:.1f} × a single rollout of the paper's model"
        )
        of_one = {"by_cpu_time": steps / float(one.cpu.min()), "one_core": steps / one.best}
        detail = timing.per_second(steps) | of_one | {"single": alone, "cores": available_cores()}
        results.append(Result(name, steps / timing.best, "steps/s", note, detail))
    return results


def _timed(scenario: Scenario, truth: Rollout, robots: Sequence[Robot], workers: int | None) -> tuple[int, Timing]:
    """Integration steps of a call, and the time of many."""
    table = MotorTable(
        KEPT_EVERY, truth.motor_position.copy(), truth.motor_velocity.copy(), np.full((len(truth.t), 4), np.nan),
        (Mode.PRESCRIBED,) * 4,
    )  # fmt: skip
    items = _items(truth, len(robots))
    batch = WindowBatch([table], [_plan()], DT, workers)
    steps = int(items.knots.sum()) * round(KEPT_EVERY / DT)
    return steps, repeat(lambda: batch.run(robots, items), scenario.runs(10), scenario.tick)


def _items(truth: Rollout, robots: int) -> Items:
    """Windows that overlap by half, from the truth's own states, for each robot."""
    begin = np.arange(0, len(truth.t) - LENGTH, LENGTH // 2)
    first = np.tile(begin, robots)
    zero = np.zeros_like(first)
    robot = np.repeat(np.arange(robots), len(begin))
    return Items(robot, zero, zero, first, zero + LENGTH, truth.q[first], truth.v[first], truth.t[first])


def _plan() -> Plan:
    times = {kind: np.arange(0.5 / rate, LENGTH * KEPT_EVERY, 1.0 / rate) for kind, rate in RATES.items()}
    kinds = [np.full(len(t), KINDS.index(kind)) for kind, t in times.items()]
    return Plan(np.concatenate(list(times.values())), np.concatenate(kinds))
