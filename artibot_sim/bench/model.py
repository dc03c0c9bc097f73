"""Speed and accuracy of the model: rollouts, batches, windows, and a fresh process until its first result."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench.results import Result, Timing, repeat, thread_waited
from artibot_sim.errors import ArtibotError
from artibot_sim.model import (
    Commands,
    Ground,
    Mode,
    Robot,
    Rollout,
    State,
    initial_state,
    load_robot,
    random_ground,
    rollout,
)
from artibot_sim.model.effects import EFFECTS, LAWS
from artibot_sim.model.simulate.batch import available_cores, rollout_batch
from artibot_sim.model.simulate.window_inputs import KINDS, Items, MotorTable, SamplingPlan
from artibot_sim.model.simulate.windows import WindowBatch
from artibot_sim.planning import Plan, load_manoeuvre, plan

# ----------------------------------------------------------------------
# What all benchmarks of the model run: Agri.q on the trajectory of Table 6.
# ----------------------------------------------------------------------


KEPT_EVERY = 0.01
"""Outputs are kept at 100 Hz."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """Robot, plan and commands, and how much to measure.

    Attributes
    ----------
    quick : bool
        Fewer runs and a shorter trajectory: to see that everything works.
    tick : callable
        To be called now and then, so that the progress shows.
    rover : Robot, optional
        In place of Agri.q as shipped.
    ground : Ground, optional
        Uneven ground, on which it starts at rest.
    """

    quick: bool = False
    tick: Callable[[], None] = lambda: None
    rover: Robot | None = None
    ground: Ground | None = None

    def runs(self, full: int) -> int:
        """How often to measure: `full`, or twice when in a hurry."""
        return min(full, 2) if self.quick else full

    @cached_property
    def robot(self) -> Robot:
        """Agri.q as shipped, unless there is another."""
        return self.rover or load_robot("agriq")

    @cached_property
    def plan(self) -> Plan:
        """Table 6."""
        return plan(load_manoeuvre("table6_agriq"), self.robot, dt=KEPT_EVERY)

    @cached_property
    def commands(self) -> Commands:
        """Those of the plan; its first 8 s when in a hurry."""
        whole = self.plan.commands()
        if not self.quick:
            return whole
        end = round(8.0 / whole.dt) + 1
        return Commands(whole.dt, whole.velocity[:end], position=whole.position[:end])

    def rollout(self, integrator: str, dt: float, every: float = KEPT_EVERY) -> Rollout:
        """One rollout, rows kept each `every` s."""
        return rollout(
            self.robot, self.commands, integrator=integrator, dt=dt, every=round(every / dt),
            state=None if self.ground is None else self.rest, ground=self.ground,
        )  # fmt: skip

    @cached_property
    def rest(self) -> State:
        """At rest at the origin, on uneven ground."""
        return initial_state(self.robot, ground=self.ground)

    def steps(self, dt: float) -> int:
        """Integration steps of one rollout."""
        return round(self.commands.duration / dt)

    @cached_property
    def converged(self) -> Rollout:
        """RK4 with a step at which the pose no longer changes with it."""
        return self.rollout("rk4", 1e-4 if self.quick else 5e-5)

    @cached_property
    def steady(self) -> tuple[float, float]:
        """Second half of the longest stretch at constant speed and yaw rate: from, to (s)."""
        twist = self.plan.twist[: len(self.commands.velocity)]
        breaks = np.flatnonzero(np.abs(np.diff(twist, axis=0)).max(axis=1) > 1e-9) + 1
        edges = np.concatenate([[0], breaks, [len(twist)]])
        k = int(np.argmax(np.diff(edges)))
        first, last = edges[k], edges[k + 1] - 1
        return float(0.5 * (first + last) * KEPT_EVERY), float(last * KEPT_EVERY)


# ----------------------------------------------------------------------
# What the speed costs: ripple of the back wheels' speed, and distance from a converged rollout.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

HIGH_PASS = 0.05
"""Length of the moving average that ripple is measured from, s."""


def high_pass(signal: Array, dt: float) -> Array:
    """`signal` (n, …), sampled each `dt` s, less its centred moving average over `HIGH_PASS` s, without the ends."""
    half = max(round(0.5 * HIGH_PASS / dt), 1)
    width = 2 * half + 1
    total = np.cumsum(np.vstack([np.zeros_like(signal[:1]), signal]), axis=0)
    mean = (total[width:] - total[:-width]) / width
    return np.asarray(signal[half:-half] - mean)


def ripple(result: Rollout, steady: tuple[float, float], dt: float) -> float:
    """RMS of the high-passed speeds of the back motors over a steady part, rad/s."""
    first, last = (round(t / dt) for t in steady)
    fast = high_pass(result.motor_velocity[first : last + 1, 2:], dt)
    return float(np.sqrt(np.mean(fast**2)))


def distance(a: Array, b: Array) -> Array:
    """Between two paths of poses (n, 3), m."""
    return np.asarray(np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]))


def ripples(scenario: Scenario) -> list[Result]:
    """RK4 at 1 ms and semi-implicit at 2 ms, every step looked at, beside a converged rollout."""
    first, last = scenario.steady
    note = f"RMS above {1 / HIGH_PASS:g} Hz of the back motors' speed, steady turn from {first:.1f} to {last:.1f} s"
    results = []
    for name, integrator, dt in (
        ("rk4_1ms", "rk4", 1e-3),
        ("semi_implicit_2ms", "semi_implicit", 2e-3),
        ("converged", "rk4", 1e-4),
    ):
        result = scenario.rollout(integrator, dt, every=dt)
        mean = float(np.abs(result.motor_velocity[round(first / dt) : round(last / dt), 2:]).mean())
        found = ripple(result, scenario.steady, dt)
        results.append(Result(f"back_speed_ripple_{name}", found, "rad/s", note, {"relative": found / mean}))
        scenario.tick()
    return results


STEPS = (("rk4", 0.25), ("rk4", 0.5), ("rk4", 1.0), ("semi_implicit", 0.5), ("semi_implicit", 1.0),
         ("semi_implicit", 2.0), ("semi_implicit", 5.0))  # fmt: skip
"""Integrators with their steps, ms."""


def pose_name(integrator: str, ms: float) -> str:
    """Of the result for a step in ms."""
    return f"pose_difference_{integrator}_{ms:g}ms"


def poses(scenario: Scenario) -> list[Result]:
    """Error of the final pose against the converged rollout, and the largest on the way, beside what a step size costs.

    The cost is the time that a second of motion takes on one core.
    """
    reference = scenario.converged
    step = 1e3 * (1e-4 if scenario.quick else 5e-5)
    results = []
    for integrator, ms in STEPS:
        dt = 1e-3 * ms
        apart = distance(scenario.rollout(integrator, dt).pose, reference.pose)
        wall = repeat(partial(scenario.rollout, integrator, dt), scenario.runs(5), scenario.tick).best
        cost = wall / scenario.commands.duration
        note = (
            f"at the end, from RK4 at {step:g} ms; {1e3 * apart.max():.2g} mm at most on the way; "
            f"{1e3 * cost:.2g} ms for a second of motion"
        )
        detail = {"largest": float(apart.max()), "cost": cost}
        results.append(Result(pose_name(integrator, ms), float(apart[-1]), "m", note, detail))
    return results


# ----------------------------------------------------------------------
# Speed of rollouts: single ones, and batches on all cores.
# ----------------------------------------------------------------------


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


def over_uneven_ground(scenario: Scenario) -> list[Result]:
    """RK4 and the semi-implicit integrator at 1 ms over ground drawn at random."""
    over = dataclasses.replace(scenario, ground=random_ground(7))
    return [
        single(over, "rollout_rk4_1ms_uneven", "rk4", 1e-3),
        single(over, "rollout_semi_implicit_uneven", "semi_implicit", 1e-3),
    ]


ALL_EFFECTS: dict[str, dict[str, Any]] = {
    "back_friction": {"scale": 0.9},
    "battery_sag": {"stall": 5.0, "no_load_speed": 1000.0},
    "bulldozing": {"coefficient": 300.0, "load": 1.0},
    "com_height": {"height": 0.05},
    "com_offset": {"x": 0.02, "y": -0.02},
    "external_force": {"force": 10.0, "heading": 1.0},
    "friction_patch": {"scale": 0.9, "x": 3.0, "y": 1.0, "radius": 1.5},
    "gear_efficiency": {"scale": 0.95},
    "gear_no_load": {"torque": 0.01},
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
    "stiction": {"length": 0.01},
    "stribeck": {"velocity": 0.03},
    "torque_limit": {"front_max": 5.0},
    "tyre_relaxation": {"length": 0.1},
    "velocity_loop": {"gain": 0.06, "integral": 8.0, "windup": 0.3},
    "wheel_radius": {"scale": 1.003},
    "wheel_radius_mismatch": {"relative": 0.003},
    "wheel_resistance": {"share": 0.01},
    "wheel_windup": {"way": 0.01},
    "slip_ratio": {"exponent": 0.95},
    "load_sensitivity": {"exponent": 0.05},
    "friction_anisotropy": {"ratio": 0.95},
    "wheel_runout": {"relative": 0.003, "phase": 0.0, "wheel": "front_right_front"},
}
"""Every effect at work at once, each a little; laws, which have code of their own, apart."""


def all_effects(scenario: Scenario) -> list[Result]:
    """RK4 at 1 ms with one effect, and with every one that acts in the model."""
    working = {name for name, effect in EFFECTS.items() if (effect.hooks or effect.adapt) and name not in LAWS}
    if working != set(ALL_EFFECTS):
        raise ArtibotError(f"bench: effects {sorted(working ^ set(ALL_EFFECTS))} are not in the table of ALL_EFFECTS")
    return [
        single(
            dataclasses.replace(scenario, rover=dataclasses.replace(scenario.robot, effects=effects)), name, "rk4", 1e-3
        )
        for name, effects in (
            ("rollout_rk4_1ms_one_effect", {"joint_friction": {"torque": 5.0}}),
            ("rollout_rk4_1ms_all_effects", ALL_EFFECTS),
        )
    ]


def soils(robot: Robot, count: int) -> list[Robot]:
    """Robots on `count` soils: a Latin hypercube over SOIL."""
    rng = np.random.default_rng(0)
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


# ----------------------------------------------------------------------
# Speed of what identification and diagnosis spend their time on: short windows of a recording, as sensors see
# them.
# ----------------------------------------------------------------------


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


def _plan() -> SamplingPlan:
    times = {kind: np.arange(0.5 / rate, LENGTH * KEPT_EVERY, 1.0 / rate) for kind, rate in RATES.items()}
    kinds = [np.full(len(t), KINDS.index(kind)) for kind, t in times.items()]
    return SamplingPlan(np.concatenate(list(times.values())), np.concatenate(kinds))


# ----------------------------------------------------------------------
# How long a fresh process takes to its first finished rollout, with and without compiled code at hand.
# ----------------------------------------------------------------------


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
