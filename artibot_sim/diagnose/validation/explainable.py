"""How much is explainable at all: what a model without physics learns from recordings mends predictions of others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.records import LAST_THIRD, Explainable
from artibot_sim.estimation.boosting import can_grow
from artibot_sim.estimation.measurements import CHANNEL_UNITS, Stretch
from artibot_sim.estimation.parallel import check_time
from artibot_sim.estimation.parameters import ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.residual_model import (
    MotorSpeeds,
    Predicted,
    ResidualModel,
    body_rates,
    corrected,
    features,
    grid,
    learned,
)
from artibot_sim.estimation.windows import CHANNEL_NAMES, HEADINGS, Window
from artibot_sim.experiment.blocks import HELD_OUT
from artibot_sim.identify.validation import PredictedRecording
from artibot_sim.model import Robot
from artibot_sim.model.simulate.window_inputs import KINDS, SamplingPlan

Array = NDArray[np.float64]

CHANNELS = ("position", "yaw")
"""What corrections of velocities change directly."""
_FOLDS = 5
"""Folds, at most, each predicted by what was learned from the others."""
FEWEST = 8
"""Windows without which nothing is learned."""
_DRAWS = 500
"""Draws of windows."""


@dataclass(frozen=True)
class LearningWindow:
    """One window as the final model predicts it, and what is missing there.

    Attributes
    ----------
    window : Window
    residual : array, shape (n,)
        Of the prediction, in units of noise.
    path : Predicted
    rows : array, shape (steps, f)
        Features of its steps.
    missing : array, shape (steps, 3)
        Measured less predicted forward and leftward speed (m/s) and yaw rate (rad/s).
    """

    window: Window
    residual: Array
    path: Predicted
    rows: Array
    missing: Array

    def squares(self, missing: Array) -> Array:
        """Sums of squared errors (SI) and numbers of samples, (channels, 2), with `missing` (steps, 3) added."""
        offset = corrected(self.path, missing) - self.path.pose
        at, found = self.window.t + self.window.plan.t, np.zeros((len(CHANNELS), 2))
        for column, kinds in enumerate(((0,), (1,), HEADINGS)):
            mine = np.isin(self.window.plan.kind, kinds)
            error = (self.residual * self.window.sigma)[mine] + np.interp(at[mine], self.path.t, offset[:, column])
            # a position is two samples that count as one distance
            found[column // 2] += float(error @ error), (0.5 if column < 2 else 1.0) * len(error)
        return found


def explainable(
    held: Sequence[PredictedRecording], robot: Robot, noise: Mapping[str, float], seed: int
) -> tuple[dict[str, Explainable], list[LearningWindow]]:
    """By channel what could be explained, and the windows that say so; nothing where there is too little to learn from.

    Parameters
    ----------
    held : sequence of PredictedRecording
        All recordings as the final model predicts them.
    robot : Robot
        The final model.
    noise : mapping of str to float
        Of every channel's sensor.
    seed : int
    """
    motors = known_motors(held)
    every = [pieces(one, robot, motors) for one in held]
    flat = [piece for some in every for piece in some]
    if len(flat) < FEWEST or not can_grow():
        return {}, []
    fold = folds([one.experiment.name for one in held], [len(some) for some in every])
    squares = np.array([piece.squares(np.zeros_like(piece.missing)) for piece in flat])
    mended = np.empty_like(squares)
    for number in np.unique(fold):
        check_time()
        inside, others = np.flatnonzero(fold == number), np.flatnonzero(fold != number)
        trees = learned(*tables([flat[i] for i in others]), seed)
        for i in inside:
            mended[i] = flat[i].squares(trees(flat[i].rows))
    seconds = float(sum(piece.path.t[-1] - piece.path.t[0] for piece in flat))
    found = {}
    for c, name in enumerate(CHANNELS):
        if name in noise and squares[:, c, 1].sum():
            before, after, interval = _errors(squares[:, c], mended[:, c, 0], seed)
            found[name] = Explainable(CHANNEL_UNITS[name], noise[name], before, after, interval, seconds)
    return found, flat


def model_of(
    some: Sequence[LearningWindow], held: Sequence[PredictedRecording], robot: Robot, horizon: float, seed: int
) -> ResidualModel:
    """What is learned from all windows."""
    return ResidualModel(learned(*tables(some), seed), known_motors(held), robot.name, horizon)


def tables(some: Sequence[LearningWindow]) -> tuple[Array, Array]:
    """Features (n, f) of the steps of some windows, and what is missing there, (n, 3)."""
    return np.concatenate([piece.rows for piece in some]), np.concatenate([piece.missing for piece in some])


def folds(names: Sequence[str], windows: Sequence[int]) -> NDArray[np.int64]:
    """For every window the number of its fold, each predicted by what was learned from the others.

    A fold is a recording, or of many recordings some; of a single recording, or its two parts, it is a block of windows
    that follow each other.
    """
    which = np.repeat(np.arange(len(names)), windows)
    if len({name.removesuffix(LAST_THIRD).removesuffix(HELD_OUT) for name in names}) > 1:
        return which % _FOLDS
    return np.arange(len(which)) * min(_FOLDS, len(which)) // len(which)


def known_motors(held: Sequence[PredictedRecording]) -> tuple[int, ...]:
    """Motors whose rotation is known in all recordings."""
    known = [np.isfinite(stretch.inputs.velocity).all(axis=0) for one in held for stretch in one.stretches]
    return tuple(np.flatnonzero(np.all(known, axis=0)).tolist())


def pieces(held: PredictedRecording, robot: Robot, motors: Sequence[int]) -> list[LearningWindow]:
    """A recording's windows with what is missing in them; lost predictions are left out."""
    problem = Problem(ParameterSet(robot, ()), held.stretches, held.windows)
    kinds = [KINDS.index(name) for name in ("x", "y", "heading")]
    kinds += [KINDS.index("articulation_yaw")] if robot.articulated else []
    times = [grid(w.t, w.t + span) for w, span in zip(held.windows, problem.durations.tolist(), strict=True)]
    plans = [
        SamplingPlan(np.repeat(t - w.t, len(kinds)), np.tile(kinds, len(t)))
        for t, w in zip(times, held.windows, strict=True)
    ]
    found = []
    looked = problem.sampled(np.empty(0), held.starts, plans)
    for window, t, values, residual in zip(held.windows, times, looked, held.residuals, strict=True):
        table = values.reshape(len(t), -1)
        path = Predicted(t, table[:, :3], table[:, 3] if robot.articulated else np.zeros(len(t)))
        stretch = held.stretches[window.stretch]
        missing = body_rates(t, measured_path(stretch, path)) - body_rates(t, path.pose)
        if np.isfinite(table).all() and np.isfinite(missing).all() and np.isfinite(residual).all():
            turning = MotorSpeeds(stretch.inputs.t, stretch.inputs.velocity[:, list(motors)])
            found.append(LearningWindow(window, residual, path, features(turning, path), missing))
    return found


def measured_path(stretch: Stretch, predicted: Predicted) -> Array:
    """Measured poses (n + 1, 3) at a prediction's instants.

    Where no heading is measured, it is the predicted one at the start, carried on by the measured yaw rate: a heading
    from the course over ground is off by up to some degrees, and all displacements would be turned by that.
    """
    measured = stretch.measured
    pose = measured.along(predicted.t)[:, :3]
    t, rate = measured.yaw_rate()
    if len(measured.yaw()[0]) or len(t) < 2:
        pose[:, 2] = np.unwrap(pose[:, 2])
        return pose
    turned = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t) * (rate[1:, 0] + rate[:-1, 0]))))
    yaw = np.interp(predicted.t, t, turned)
    pose[:, 2] = predicted.pose[0, 2] + yaw - yaw[0]
    return pose


def _errors(squares: Array, mended: Array, seed: int) -> tuple[float, float, tuple[float, float]]:
    """Errors before and after from sums a window, and the interval of their difference from windows drawn anew."""
    before, count = squares.T
    rng, draws = np.random.default_rng(seed), []
    for _ in range(_DRAWS):
        rows = rng.integers(0, len(count), len(count))
        total = max(float(count[rows].sum()), 1.0)
        draws.append(np.sqrt(before[rows].sum() / total) - np.sqrt(mended[rows].sum() / total))
    low, high = np.quantile(draws, (0.025, 0.975)).tolist()
    total = float(count.sum())
    return float(np.sqrt(before.sum() / total)), float(np.sqrt(mended.sum() / total)), (low, high)


assert all(name in CHANNEL_NAMES for name in CHANNELS)
