"""Speed of rollouts: single ones, and batches on all cores."""

from __future__ import annotations

import dataclasses
import threading
import time
from typing import Any

import numpy as np

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.bench.timing import repeat, thread_waited
from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot
from artibot_sim.model.batch import available_cores, rollout_batch
from artibot_sim.model.effects import EFFECTS

SOIL = {
    "contact.k_l": (2000.0, 3300.0),
    "contact.k_t": (1400.0, 2600.0),
    "contact.mu_s": (0.45, 0.80),
    "contact.mu_d": (0.20, 0.42),
    "contact.u_w": (0.004, 0.014),
}
"""Ranges (about Table 4) of the soils in a batch."""


def single(scenario: Scenario, name: str, integrator: str, dt: float) -> Result:
    """Steps per second of wall time of one rollout on one core, from commands to named outputs."""
    timing = repeat(lambda: scenario.rollout(integrator, dt), scenario.runs(40), scenario.tick)
    steps = scenario.steps(dt)
    note = f"one rollout of {scenario.commands.duration:.4g} s, {integrator} at {dt * 1e3:g} ms, all outputs at 100 Hz"
    return Result(name, steps / timing.best, "steps/s", note, timing.per_second(steps))


def rollouts(scenario: Scenario) -> list[Result]:
    """Both integrators at 1 ms, and the semi-implicit one at 2 ms."""
    return [
        single(scenario, "rollout_rk4_1ms", "rk4", 1e-3),
        single(scenario, "rollout_semi_implicit", "semi_implicit", 1e-3),
        single(scenario, "rollout_semi_implicit_2ms", "semi_implicit", 2e-3),
    ]


ALL_EFFECTS: dict[str, dict[str, Any]] = {
    "back_friction": {"scale": 0.9},
    "bulldozing": {"coefficient": 300.0},
    "com_offset": {"x": 0.02, "y": -0.02},
    "external_force": {"force": 10.0, "heading": 1.0},
    "friction_patch": {"scale": 0.9, "x": 3.0, "y": 1.0, "radius": 1.5},
    "gear_efficiency": {"scale": 0.95},
    "joint_damping": {"coefficient": 5.0},
    "joint_friction": {"torque": 1.0},
    "joint_stiffness": {"stiffness": 5.0},
    "joint_stop": {"angle": 0.9},
    "motor_drag": {"torque": 0.02, "motor": "front_left"},
    "payload": {"mass": 5.0, "module": "back"},
    "motion_resistance": {"force": 5.0},
    "residual_force": {"front_sway": 1.0, "back_turn": 1.0, "back_turn_rate": -0.1},
    "rolling_resistance_speed": {"coefficient": 0.5},
    "slope": {"grade": 0.01, "heading": 0.5},
    "soil_softening": {"rate": 0.001},
    "stribeck": {"velocity": 0.03},
    "torque_limit": {"front_max": 5.0},
    "tyre_relaxation": {"length": 0.1},
    "wheel_radius_mismatch": {"relative": 0.003},
}
"""Every effect at work at once, each a little."""


def all_effects(scenario: Scenario) -> list[Result]:
    """RK4 at 1 ms with every effect that acts in the model."""
    working = {name for name, effect in EFFECTS.items() if effect.hooks or effect.adapt}
    if working != set(ALL_EFFECTS):
        raise ArtibotError(f"bench: effects {sorted(working ^ set(ALL_EFFECTS))} are not in the table of ALL_EFFECTS")
    robot = dataclasses.replace(scenario.robot, effects=ALL_EFFECTS)
    return [single(dataclasses.replace(scenario, rover=robot), "rollout_rk4_1ms_all_effects", "rk4", 1e-3)]


def soils(robot: Robot, count: int, seed: int = 0) -> list[Robot]:
    """Robots on `count` soils: a Latin hypercube over SOIL."""
    rng = np.random.default_rng(seed)
    low, high = np.array(list(SOIL.values())).T
    unit = (np.array([rng.permutation(count) for _ in SOIL]).T + rng.random((count, len(SOIL)))) / count
    return [robot.with_vector(list(SOIL), values) for values in low + unit * (high - low)]


class BatchTiming:
    """One batch: its wall time, the calling thread's processor time, and how long its threads waited for a core.

    One worker is the calling thread; somebody else had the core meanwhile.
    """

    def __init__(self, scenario: Scenario, robots: list[Robot], workers: int) -> None:
        before = thread_waited()
        waited: dict[int, float] = {}

        def progress(_done: int) -> None:
            waited[threading.get_ident()] = thread_waited() or 0.0

        start, cpu = time.perf_counter(), time.thread_time()
        rollout_batch(robots, scenario.commands, workers=workers, keep="final", progress=progress)
        self.wall, self.cpu = time.perf_counter() - start, time.thread_time() - cpu
        base = (before or 0.0) if workers == 1 else 0.0  # one worker is the calling thread, which is older
        self.waited = (sum(waited.values()) - base) / workers
        scenario.tick()

    @property
    def undisturbed(self) -> float:
        """Wall time less the waiting, s."""
        return max(self.wall - self.waited, 1e-9)


def batch(scenario: Scenario) -> list[Result]:
    """A batch over soils on all cores, and its ratio to one core; one and all take turns."""
    cores = available_cores()
    robots = soils(scenario.robot, 8 if scenario.quick else 256)
    BatchTiming(scenario, robots[:2], cores)
    runs = [(BatchTiming(scenario, robots, 1), BatchTiming(scenario, robots, cores)) for _ in range(scenario.runs(5))]
    one, every = (min(run[i].wall for run in runs) for i in (0, 1))
    undisturbed = float(np.median([run[0].undisturbed / run[1].undisturbed for run in runs]))
    steps = scenario.steps(1e-3) * len(robots)
    median = float(np.median([run[1].wall for run in runs]))
    note = f"{len(robots)} soils, RK4 at 1 ms, first and last row kept, threads on {cores} cores"
    detail = {"median": steps / median, "runs": len(runs), "one_core": steps / one, "cores": cores}
    detail["by_cpu_time"] = steps / min(run[0].cpu for run in runs)  # of one core
    ratio_detail = {"undisturbed": undisturbed, "cores": cores, "runs": len(runs)}
    ratio_note = (
        f"batch on {cores} cores over one core; about {undisturbed:.2f} "
        "without the time that threads waited for a core others had"
    )
    return [
        Result("batch_rk4_all_cores", steps / every, "steps/s", note, detail),
        Result("batch_rk4_ratio_to_one_core", one / every, "x", ratio_note, ratio_detail),
    ]
