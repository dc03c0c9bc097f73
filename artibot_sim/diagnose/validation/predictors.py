"""How well held-out recordings are predicted: by the robot as given, by what was fitted, by kinematic models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from artibot_sim.diagnose.policy import CLEARLY_WORSE
from artibot_sim.diagnose.records import BASELINE, EXTENDED, FILES, GIVEN, HALF_WIDTH, PredictionError, Predictor
from artibot_sim.estimation.kinematic import kinematic_models
from artibot_sim.estimation.measurements import stretches
from artibot_sim.estimation.problem import Problem
from artibot_sim.experiment import Experiment
from artibot_sim.identify.result import ChannelFit
from artibot_sim.identify.validation import hold_out
from artibot_sim.model import Robot

CHANNELS = ("position", "yaw")
"""What all of them predict."""
_STEPS = 2
"""Of the starts that predictions begin with."""


def predictors(
    held: Sequence[Experiment], models: Mapping[str, Robot], problem: Problem, horizon: float, workers: int | None
) -> tuple[Predictor, ...]:
    """Errors of all predictors at the ends of their predictions of held-out recordings.

    Parameters
    ----------
    held : sequence of Experiment
    models : mapping of str to Robot
        By name; those that are the same as one before are left out.
    problem : Problem
        Of the fitted recordings: kinematic models are fitted to its windows, for a robot without articulation.
    horizon : float
        s.
    """
    robot = problem.parameters.robot
    rivals = {} if robot.articulated else kinematic_models(problem)
    seen = [stretches(one, robot, HALF_WIDTH) for one in held]
    found: list[Predictor] = []
    rolling: list[Predictor] = []
    for name, model in models.items():
        if any(model == one.robot for one in found):
            continue
        mine = {} if found else rivals  # they predict the same whatever the dynamic model
        runs = [
            hold_out(one, model, horizon, workers, mine, _STEPS, HALF_WIDTH, known)
            for one, known in zip(held, seen, strict=True)
        ]
        found.append(Predictor(name, pooled([run.summary.final for run in runs]), model))
        for rival in mine:
            ends = pooled([run.summary.rivals[rival] for run in runs])
            rolling.append(Predictor(f"{rival} kinematics", ends, kinematic=True))
    return (*found, *rolling)


def pooled(fits: Sequence[Mapping[str, ChannelFit]]) -> dict[str, PredictionError]:
    """Errors of several recordings together, by channel."""
    found = {}
    for name in CHANNELS:
        own = [one[name] for one in fits if name in one]
        count = sum(one.count for one in own)
        if count:
            square = sum(one.count * one.rmse**2 for one in own) / count
            found[name] = PredictionError(own[0].unit, float(np.sqrt(square)), count)
    return found


def best_of(found: Sequence[Predictor]) -> Predictor | None:
    """The dynamic model that predicts best; the simplest of those that are nearly as good. None without any."""
    models = [one for one in found if not one.kinematic and one.errors]
    least = min((one.score for one in models), default=0.0)
    return next((one for one in models if one.score <= least + CLEARLY_WORSE / 5.0), None)


def refusals(found: Sequence[Predictor]) -> list[str]:
    """Sentences on fitted models that predict worse than the robot as given, or than a kinematic model."""
    by_name = {one.name: one for one in found}
    best = best_of(found)
    said = []
    for name in (BASELINE, EXTENDED):
        one, given = by_name.get(name), by_name.get(GIVEN)
        if one is not None and given is not None and one.is_clearly_worse_than(given):
            said.append(
                f"{FILES[name]} ({name}) predicts held-out recordings worse than the robot file as given: "
                f"{errors(one)}; as given {errors(given)}: do not simulate with it"
            )
    rolling = min((one for one in found if one.kinematic), key=lambda one: one.score, default=None)
    if best is not None and rolling is not None and best.is_clearly_worse_than(rolling):
        said.append(
            f"no dynamic model predicts held-out recordings as well as {rolling.name}: "
            f"{errors(rolling)}; the best dynamic one ({best.name}) {errors(best)}: use the kinematic model"
        )
    return said


def errors(one: Predictor) -> str:
    """A predictor's errors in words."""
    words = {"position": "position", "yaw": "heading"}
    return ", ".join(f"{words[name]} {error.rmse:.3g} {error.unit}" for name, error in one.errors.items())
