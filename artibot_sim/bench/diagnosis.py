"""How long a diagnosis takes."""

from __future__ import annotations

import dataclasses
import importlib.util
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.model.batch import available_cores

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment
    from artibot_sim.model import Robot

WHERE = "artibot_sim.diagnose.run"
SEED = 5
DURATION = 45.0
"""s of each recording."""
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

    rng = np.random.default_rng(SEED)
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
