"""How well held-out recordings are predicted: by the robot as given, by what was fitted, by kinematic models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.diagnose.policy import CLEARLY_WORSE
from artibot_sim.diagnose.records import FILES, GIVEN, HALF_WIDTH, PredictionError, Predictor, Refusal
from artibot_sim.diagnose.validation.predictions import STEPS
from artibot_sim.estimation.kinematic import kinematic_models
from artibot_sim.estimation.measurements import stretches
from artibot_sim.estimation.problem import Problem
from artibot_sim.experiment import Experiment
from artibot_sim.identify.result import ChannelFit
from artibot_sim.identify.validation import PredictedRecording, hold_out
from artibot_sim.model import Robot

CHANNELS = ("position", "yaw")
"""What all of them predict."""


def predictors(
    held: Sequence[Experiment],
    models: Mapping[str, Robot],
    problem: Problem,
    horizon: float,
    workers: int | None,
    known: Sequence[tuple[Robot, Sequence[PredictedRecording]]] = (),
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
    known : sequence of (Robot, sequence of PredictedRecording)
        Robots by which all of `held` were predicted before, and these predictions (`validation.predictions.predicted`).
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
        made = next((runs for robot, runs in known if robot == model and not mine), None)
        runs = made or [
            hold_out(one, model, horizon, workers, mine, STEPS, HALF_WIDTH, its)
            for one, its in zip(held, seen, strict=True)
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


def refusals(
    found: Sequence[Predictor], models: Mapping[str, Robot], noise: Mapping[str, float] | None = None
) -> list[Refusal]:
    """Fitted models that predict held-out recordings clearly worse than a simpler one, or than a kinematic model.

    Parameters
    ----------
    found : sequence of Predictor
    models : mapping of str to Robot
        What `predictors` was asked for.
    noise : mapping of str to float
        Of the sensors, by channel: errors below it are all alike.
    """
    found = [_at_least(one, noise or {}) for one in found]
    known = {name: one for name, robot in models.items() for one in found if one.robot == robot}
    rolling = min((one for one in found if one.kinematic), key=lambda one: one.score, default=None)
    simpler = [known[GIVEN]] if GIVEN in known else []
    said = []
    for name, file in FILES.items():
        if name not in known:
            continue
        mine = replace(known[name], name=name)
        worse = mine.is_clearly_worse_than
        better = [one for one in (*simpler, rolling) if one is not None and worse(one)]
        kept = best_of([*simpler, mine])
        simpler.append(mine)
        if not better or kept is None:
            continue
        least = min(better, key=lambda one: one.score)
        rivals = ", ".join(f"{one.name} {errors(one)}" for one in better)
        instead = f"the file holds the robot {kept.name}" if kept.name != name else "do not simulate with it"
        why = f"{file} ({name}) is refused: held-out errors {errors(mine)}; {rivals}; {instead}"
        said.append(Refusal(file, name, least.name, kept.name, why))
    return said


def _at_least(one: Predictor, noise: Mapping[str, float]) -> Predictor:
    """A predictor whose errors are the sensors' noise where they are less."""
    floored = {name: replace(e, rmse=max(e.rmse, noise.get(name, 0.0))) for name, e in one.errors.items()}
    return replace(one, errors=floored)


def errors(one: Predictor) -> str:
    """A predictor's errors in words."""
    words = {"position": "position", "yaw": "heading"}
    return ", ".join(f"{words[name]} {error.rmse:.3g} {error.unit}" for name, error in one.errors.items())
