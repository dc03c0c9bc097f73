"""How long an identification, a diagnosis, a sweep and the recorder's writer take."""

from __future__ import annotations

import dataclasses
import importlib.util
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.bench.model import ALL_EFFECTS, BatchTiming, Scenario, soils
from artibot_sim.bench.results import Result, repeat
from artibot_sim.errors import ArtibotError
from artibot_sim.model.simulate.batch import available_cores

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment
    from artibot_sim.model import Robot

# ----------------------------------------------------------------------
# How long an identification takes.
# ----------------------------------------------------------------------


IDENTIFICATION_SEED = 3
DURATION = 45.0
"""s of each recording."""


def identify_3x45s(scenario: Scenario) -> list[Result]:
    """Wall time of identifying five soil parameters from three recordings in memory."""
    from artibot_sim.identify import identify
    from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic

    rng = np.random.default_rng(IDENTIFICATION_SEED)
    real = random_soil(scenario.robot, rng)
    drives = [
        synthetic(real, random_manoeuvre(rng, DURATION), duration=DURATION, kappa=kappa, seed=i, name=f"run{i}")
        for i, kappa in enumerate((1.0, 0.8, 0.65))
    ]
    identify(drives[:1], scenario.robot, fit=["k_l"])  # compiles, or loads what was compiled
    scenario.tick()
    wall, cpu = time.perf_counter(), time.process_time()
    work = identify(drives, scenario.robot)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    scenario.tick()
    seconds = sum(experiment.duration for experiment in drives)
    note = (
        f"3 synthetic recordings, {seconds:.0f} s in all, {work.result.samples} samples, {work.result.windows} windows"
    )
    detail = {"cpu_time": cpu, "cores": available_cores(), "runs": 1}
    return [Result("identify_3x45s", wall, "s", note, detail)]


# ----------------------------------------------------------------------
# How long a diagnosis takes.
# ----------------------------------------------------------------------


WHERE = "artibot_sim.diagnose.pipeline"
DIAGNOSIS_SEED = 5
KAPPA = (1.0, 0.85, 0.75, 0.65)
HIDDEN: dict[str, dict[str, Any]] = {
    "slope": {"grade": 0.05, "heading": 0.7},
    "joint_friction": {"torque": 10.0},
    "bulldozing": {"coefficient": 900.0},
}
"""What may be wrong with the rover of these recordings; of a diagnosis on the clock the first."""


def missing() -> str | None:
    """Why no diagnosis can be measured here, or None."""
    return None if importlib.util.find_spec(WHERE) else "this version has no diagnosis"


def recordings(robot: Robot, count: int, duration: float, effects: int) -> list[Experiment]:
    """So many recordings of different manoeuvres (s each) with as many of HIDDEN at work."""
    from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic

    rng = np.random.default_rng(DIAGNOSIS_SEED)
    real = dataclasses.replace(random_soil(robot, rng), effects=dict(list(HIDDEN.items())[:effects]))
    return [
        synthetic(
            real, random_manoeuvre(rng, duration), duration=duration, kappa=KAPPA[i % len(KAPPA)], seed=i,
            name=f"run{i:02d}",
        )
        for i in range(count)
    ]  # fmt: skip


def diagnose_4x45s(scenario: Scenario) -> list[Result]:
    """Wall time of a diagnosis of four recordings in memory, made on a slope that the model does not know of."""
    drives = recordings(scenario.robot, len(KAPPA), DURATION, 1)
    diagnose: Any = importlib.import_module(WHERE).diagnose
    scenario.tick()
    wall, cpu = time.perf_counter(), time.process_time()
    found = diagnose(drives, scenario.robot)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    scenario.tick()
    causes = ", ".join(cause.effect for cause in found.causes) or "no cause"
    note = f"{len(drives)} synthetic recordings on a slope, {sum(d.duration for d in drives):.0f} s in all: {causes}"
    return [Result("diagnose_4x45s", wall, "s", note, {"cpu_time": cpu, "cores": available_cores(), "runs": 1})]


# ----------------------------------------------------------------------
# What a run of a sweep costs, measures and table included.
# ----------------------------------------------------------------------


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
    from artibot_sim.sweep.run import run_chunk

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


# ----------------------------------------------------------------------
# How much the recorder's writer takes, and that all of it is there afterwards.
# ----------------------------------------------------------------------


TOPIC, ROS_TYPE = "/joint_states", "sensor_msgs/msg/JointState"


def writer(scenario: Scenario) -> list[Result]:
    """Messages of /joint_states' size that BagWriter takes per second, as it works while recording; none is lost."""
    from artibot_sim.experiment import BagWriter, bag_info

    count, data = (2_000 if scenario.quick else 20_000), bytes(range(256)) * 2
    with tempfile.TemporaryDirectory(prefix="artibot-bench-") as folder:
        number = iter(range(1_000_000))

        def record() -> None:
            with BagWriter(Path(folder) / f"run{next(number)}", live=True) as bag:
                bag.register(TOPIC, ROS_TYPE)
                for _ in range(count):
                    now = time.time_ns()
                    bag.write(TOPIC, data, publish_ns=now, log_ns=now)

        timing = repeat(record, scenario.runs(5), scenario.tick)
        bags = sorted(Path(folder).iterdir())
        lost = count * len(bags) - sum(bag_info(bag).message_count for bag in bags)
    if lost:
        raise ArtibotError(f"bench: the writer lost {lost} of {count * len(bags)} messages")
    note = f"BagWriter, {len(data)} bytes each, chunks each 0.5 s, until the bag is closed; none of {count} lost"
    detail = timing.per_second(count) | {"lost": 0.0}
    return [Result("recorder_writer", count / timing.best, "messages/s", note, detail)]
