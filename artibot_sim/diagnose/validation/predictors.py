"""How well held-out recordings are predicted: by the robot as given, by what was fitted, by kinematic models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.policy import CLEARLY_WORSE
from artibot_sim.diagnose.records import FILES, GIVEN, HALF_WIDTH, PredictionError, Predictor, Refusal
from artibot_sim.diagnose.validation.predictions import STEPS
from artibot_sim.estimation.kinematic import kinematic_models
from artibot_sim.estimation.measurements import CHANNEL_UNITS, stretches
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.windows import Window
from artibot_sim.experiment import Experiment
from artibot_sim.identify.validation import PredictedRecording, end_errors, hold_out
from artibot_sim.model import Robot

Array = NDArray[np.float64]

CHANNELS = ("position", "yaw")
"""What all of them predict."""
_DRAWS = 500
"""Draws of windows."""


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
    ends: list[Ends] = []
    rolling: dict[str, Ends] = {}
    for name, model in models.items():
        if any(model == one.robot for one in found):
            continue
        mine = {} if found else rivals  # they predict the same whatever the dynamic model
        made = next((runs for robot, runs in known if robot == model and not mine), None)
        runs = made or [
            hold_out(one, model, horizon, workers, mine, STEPS, HALF_WIDTH, its)
            for one, its in zip(held, seen, strict=True)
        ]
        ends.append(ends_of([(run.windows, run.residuals) for run in runs]))
        found.append(Predictor(name, pooled(ends[-1]), model))
        rolling |= {rival: ends_of([(run.windows, run.rivals[rival]) for run in runs]) for rival in mine}
    found += [Predictor(f"{rival} kinematics", pooled(its), kinematic=True) for rival, its in rolling.items()]
    return with_alike(found, [*ends, *rolling.values()])


Ends = Mapping[str, Array]
"""Errors at the ends of predictions by channel, (windows,) each, SI; NaN where a window's end was not measured."""


def ends_of(predicted: Sequence[tuple[Sequence[Window], Sequence[Array]]]) -> Ends:
    """Errors of several recordings at the ends of predictions, of which each has windows and residuals."""
    return {
        name: np.concatenate([np.empty(0), *(end_errors(windows, residuals, name) for windows, residuals in predicted)])
        for name in CHANNELS
    }


def pooled(ends: Ends) -> dict[str, PredictionError]:
    """Root mean squares by channel, of those that were measured."""
    known = {name: error[np.isfinite(error)] for name, error in ends.items()}
    return {
        name: PredictionError(CHANNEL_UNITS[name], float(np.sqrt(np.mean(error**2))), len(error))
        for name, error in known.items()
        if len(error)
    }


def with_alike(found: Sequence[Predictor], ends: Sequence[Ends]) -> tuple[Predictor, ...]:
    """Predictors that know which others windows drawn anew may put before or behind them.

    Parameters
    ----------
    found : sequence of Predictor
    ends : sequence of Ends
        Of each, over the same windows.
    """
    squares = np.array([[one[name] ** 2 for name in CHANNELS] for one in ends])
    squares = squares[:, np.isfinite(squares).any(axis=(0, 2))]
    if not squares.size:
        return tuple(found)
    rng, count = np.random.default_rng(0), squares.shape[-1]
    drawn = np.stack([np.nansum(squares[..., rng.integers(0, count, count)], axis=-1) for _ in range(_DRAWS)])
    scores = 0.5 * np.log(np.maximum(drawn, 1e-300)).mean(axis=-1)  # (draws, predictors), but for the windows' number
    names = [one.name for one in found]
    told = []
    for k, one in enumerate(found):
        low, high = np.quantile(scores - scores[:, k : k + 1], (0.025, 0.975), axis=0)
        unsure = np.flatnonzero((low <= 0.0) & (high >= 0.0)).tolist()
        told.append(replace(one, alike=tuple(names[i] for i in unsure if i != k)))
    return tuple(told)


def best_of(found: Sequence[Predictor]) -> Predictor | None:
    """The dynamic model that predicts best; the simplest of those that are nearly as good. None without any."""
    models = [one for one in found if not one.kinematic and one.errors]
    least = min((one.score for one in models), default=0.0)
    return next((one for one in models if one.score <= least + CLEARLY_WORSE / 5.0), None)


def refusals(
    found: Sequence[Predictor], models: Mapping[str, Robot], noise: Mapping[str, float] | None = None
) -> list[Refusal]:
    """Fitted models that predict held-out recordings clearly and surely worse than a simpler or a kinematic one.

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
