"""From recordings to the windows that a fit has to explain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.measurements import HALF_WIDTH, Stretch, stretches, with_pooled_noise
from artibot_sim.estimation.parameters import ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.windows import cut
from artibot_sim.experiment import Experiment

LEAD = 0.3
"""s at a window's beginning that are not compared."""
MOST = 600.0
"""s of windows that are fitted at most, evenly from a longer recording. What is left then of a handful of
parameters is not the noise of the windows but the model's own error, and that does not average out."""


def problem_of(
    recordings: Sequence[Experiment],
    parameters: ParameterSet,
    window: float,
    workers: int | None,
    half_width: float = HALF_WIDTH,
    seed: int = 0,
) -> Problem:
    """The windows of recordings, and what is to explain them; motors are smoothed over `half_width` s."""
    if not recordings:
        raise ArtibotError("identify: no recording; give at least one")
    if not (np.isfinite(window) and window >= 0.5):
        raise ArtibotError(f"window: {window} s; expected at least 0.5 s")
    found: list[Stretch] = []
    for experiment in recordings:
        found += stretches(experiment, parameters.robot, half_width)
    found = with_pooled_noise(found)
    windows = cut(found, parameters.robot, window, LEAD)
    if not windows:
        raise ArtibotError(f"{recordings[0].path}: no stretch holds four positions; record longer, or check the stamps")
    return Problem(parameters, found, windows, workers, seed=seed)


def enough_of(problem: Problem, most: float = MOST) -> tuple[Problem, list[str]]:
    """A problem with windows of `most` s in all, evenly from all of them, and a remark where that is not all."""
    seconds, number = float(problem.durations.sum()), len(problem)
    if seconds <= most:
        return problem, []
    count = max(1, int(number * most / seconds))
    few = problem.part((np.arange(count) * number // count).tolist())
    return few, [f"{count} of {number} windows were fitted: {most / 60.0:g} of {seconds / 60.0:.0f} min say as much"]
