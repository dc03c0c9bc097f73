"""How long an identification takes."""

from __future__ import annotations

import time

import numpy as np

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.model.batch import available_cores

SEED = 3
DURATION = 45.0
"""s of each recording."""


def identify_3x45s(scenario: Scenario) -> list[Result]:
    """Wall time of identifying five soil parameters from three recordings in memory."""
    from artibot_sim.identify import identify
    from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic

    rng = np.random.default_rng(SEED)
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
