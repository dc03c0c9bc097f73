"""What pictures are drawn from: recordings as measured and as both models predict them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.commands.series import CommandedLevel
from artibot_sim.diagnose.records import ChannelBaseline, Comparison, ErrorSeries
from artibot_sim.diagnose.remains import COMMANDED
from artibot_sim.diagnose.validation.predictions import PredictionPair
from artibot_sim.estimation.windows import CHANNEL_NAMES, Window
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.measured import Measured, forward_speed
from artibot_sim.identify.validation import PredictedRecording
from artibot_sim.model import MOTORS, Robot

Array = NDArray[np.float64]

_GRID = 0.2
"""s between covariates."""


def comparison(pair: PredictionPair, robot: Robot, in_map: bool = True) -> Comparison:
    """One recording; places and headings mean nothing where its segments are not `in_map` together."""
    experiment, before, after = pair.before.experiment, pair.before, pair.after
    free = [[_path(run.window, run.residual) for run in held.free] for held in (before, after)]
    return Comparison(
        experiment.name, pair.held_out, _measured_path(experiment), _paths(before), _paths(after), tuple(free[0]),
        tuple(free[1]), before.summary.left, after.summary.left, _series(before, after),
        covariates(experiment, robot, in_map),
    )  # fmt: skip


def _measured_path(experiment: Experiment) -> Array:
    parts = []
    for t_start, t_end in experiment.segments:
        t, points = Measured(experiment, t_start, t_end).position()
        parts.append(np.column_stack([t, points]))
    return np.vstack(parts) if parts else np.empty((0, 3))


def _paths(held: PredictedRecording) -> tuple[Array, ...]:
    return tuple(_path(w, r) for w, r in zip(held.windows, held.residuals, strict=True))


def _path(window: Window, residual: Array) -> Array:
    """t, x, y as predicted, shape (m, 3)."""
    predicted, kind = residual * window.sigma + window.value, window.plan.kind
    x, y = kind == 0, kind == 1
    return np.column_stack([window.t + window.plan.t[x], predicted[x], predicted[y]])


def _series(before: PredictedRecording, after: PredictedRecording) -> dict[str, ErrorSeries]:
    found = {}
    for c, name in enumerate(CHANNEL_NAMES):
        rows = [_errors(held, c) for held in (before, after)]
        if not len(rows[0]):
            continue
        noise = before.summary.channels[name].noise / (np.sqrt(2.0) if name == "position" else 1.0)
        order = np.argsort(rows[0][:, 0], kind="stable")
        errors = [table[order, 1:] if name == "position" else table[order, 1] for table in rows]
        found[name] = ErrorSeries(rows[0][order, 0], errors[0], errors[1], float(noise))
    return found


def _errors(held: PredictedRecording, channel: int) -> Array:
    """Times and predicted − measured, SI, shape (n, 2), of positions (n, 3)."""
    parts = []
    for window, residual in zip(held.windows, held.residuals, strict=True):
        mine = window.channel == channel
        t, error = window.t + window.plan.t[mine], (residual * window.sigma)[mine]
        if CHANNEL_NAMES[channel] == "position":
            x, y = (window.plan.kind[mine] == k for k in (0, 1))
            parts.append(np.column_stack([t[x], error[x], error[y]]))
        else:
            parts.append(np.column_stack([t, error]))
    return np.vstack(parts) if parts else np.empty((0, 2))


def with_commands(
    baseline: Mapping[str, ChannelBaseline],
    comparisons: Sequence[Comparison],
    levels: Mapping[str, CommandedLevel],
    series: Mapping[str, ErrorSeries],
) -> tuple[dict[str, ChannelBaseline], list[Comparison]]:
    """Channels and recordings with how the front motors followed their commands, where there are any."""
    channels = dict(baseline) | {
        name: ChannelBaseline(level.unit, level.rmse, level.noise, float("nan")) for name, level in levels.items()
    }
    new = [
        replace(one, channels=dict(one.channels) | {COMMANDED: series[one.name]}) if one.name in series else one
        for one in comparisons
    ]
    return channels, new


def covariates(experiment: Experiment, robot: Robot, in_map: bool) -> dict[str, Array]:
    """What the rover did, on one grid through all segments; NaN for place and heading where these have no one map."""
    rows = [np.empty((0, 7))]
    for t_start, t_end in experiment.segments:
        t = np.arange(t_start, t_end, _GRID)
        motion = Measured(experiment, t_start, t_end).along(t)
        x, y, yaw, _, _, rate, bend, _ = motion.T
        rows.append(np.column_stack([t, forward_speed(motion), rate, yaw, bend, x, y]))
    table = np.vstack(rows)
    names = ("t", "speed", "yaw_rate", "heading", "articulation_yaw", "x", "y")
    found = {name: table[:, i].copy() for i, name in enumerate(names)}
    if not in_map:
        found |= {name: np.full(len(table), np.nan) for name in ("heading", "x", "y")}
    return found | {"load": _load(experiment, robot, found["t"])}


def _load(experiment: Experiment, robot: Robot, t: Array) -> Array:
    """Sum of absolute motor torques, N m; NaN where none is measured."""
    motors = experiment.channels.get("motor_torques")
    total = np.zeros(len(t))
    for motor in robot.motors if robot.articulated else MOTORS[:2]:
        name = f"{motor}.effort"
        times, values = motors.series(name) if motors is not None and name in motors else (np.empty(0), np.empty(0))
        if not len(times):
            return np.full(len(t), np.nan)
        total += np.abs(np.interp(t, times, values))
    return total
