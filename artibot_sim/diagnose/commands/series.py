"""Errors of the front motors' speeds at the instants of their measurements, for tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.commands.data import GUARD, CommandData, H
from artibot_sim.diagnose.commands.limit import Limit
from artibot_sim.diagnose.commands.model import CommandResponse, followed, lagging, left_to_take_up
from artibot_sim.diagnose.records import ErrorSeries
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.inputs import GAP
from artibot_sim.experiment.smoothing import local_fit, noise_of
from artibot_sim.model import MOTORS

Array = NDArray[np.float64]

RESOLUTION = 1e-3
"""Noise of a motor's speed that is taken at least, rad/s: no encoder shows less, also where a recording is exact."""


@dataclass(frozen=True)
class CommandedLevel:
    """How far a channel is from what was commanded.

    Attributes
    ----------
    unit : str
    rmse : float
        As commanded, with what is known of the robot.
    after : float
        With the effects; where a motor is at its limit nothing is predicted, and nothing counted.
    noise : float
        The sensor's.
    """

    unit: str
    rmse: float
    after: float
    noise: float


def series_of(
    recordings: Sequence[Experiment],
    known: CommandResponse,
    response: CommandResponse,
    data: CommandData,
    limit: Limit | None,
) -> dict[str, ErrorSeries]:
    """Errors (predicted − measured, rad/s) of both front motors, by recording; NaN where nothing was commanded."""
    found = {}
    for number, recording in enumerate(recordings):
        motors, commands = recording.channels.get("motor_torques"), recording.channels.get("motor_command")
        if motors is None or commands is None:
            continue
        before, after = np.full((2, len(motors), 2), np.nan)
        noise: list[float] = []
        for i, motor in enumerate(MOTORS[:2]):
            if f"{motor}.velocity" not in commands:
                continue
            speed = _speed(recording, motor)
            t, command = commands.series(f"{motor}.velocity")
            if len(t) < 4 or speed is None:
                continue
            smoothed = f"{motor}.velocity" in motors
            before[:, i], after[:, i] = (
                predicted(t, command, one if smoothed else one._replace(filter=0.0), motors.t) - speed
                for one in (known, response)
            )
            for errors, one in ((before, known), (after, response)):
                if one.droop > 0.0:
                    errors[:, i] -= one.scale * one.droop * _short(data, one, number, i, motors.t)
            if limit is not None:
                after[_held(data, limit, number, i, motors.t), i] = np.nan
            noise.append(noise_of(motors.t, speed))
        if noise:
            found[recording.name] = ErrorSeries(motors.t, before, after, max(float(np.nanmedian(noise)), RESOLUTION))
    return found


def _speed(recording: Experiment, motor: str) -> Array | None:
    """Measured speeds at the stamps of the motors, rad/s."""
    motors = recording.channels["motor_torques"]
    if f"{motor}.velocity" in motors:
        return motors[f"{motor}.velocity"]
    if f"{motor}.position" not in motors:
        return None
    t, angle = motors.series(f"{motor}.position")
    return local_fit(t, angle, motors.t, 0.04)[1]


def predicted(t: Array, command: Array, response: CommandResponse, at: Array) -> Array:
    """Speeds recorded at `at` (m,) of a motor that was commanded at `t` (n,), rad/s; NaN in silences."""
    first = t[0] - GUARD
    grid = first + H * np.arange(int(np.ceil((t[-1] - first) / H)) + 2)
    done = lagging(followed(np.interp(grid, t, command), response), response.filter)
    speed = response.scale * np.interp(at - response.delay, grid, done)
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    silent = (at < t[0] - 1e-6) | (at > t[-1] + 1e-6) | (t[after] - t[after - 1] > GAP)
    return np.where(silent, np.nan, speed)


def _short(data: CommandData, response: CommandResponse, recording: int, motor: int, at: Array) -> Array:
    """What a velocity loop has not taken up of a motor's torque at the instants `at`, N m."""
    rows = (data.recording == recording) & (data.motor == motor)
    short = left_to_take_up(data, response.integral, response.windup)[rows]
    return np.interp(at, data.middle[rows], short) if rows.any() else np.zeros(len(at))


def _held(data: CommandData, limit: Limit, recording: int, motor: int, at: Array) -> NDArray[np.bool_]:
    """Which instants belong to samples that a limit explains."""
    rows = (data.recording == recording) & (data.motor == motor)
    middle, held = data.middle[rows], limit.held[rows]
    if not len(middle):
        return np.zeros(len(at), bool)
    nearest = np.clip(np.searchsorted(middle, at), 1, len(middle) - 1)
    nearest -= (at - middle[nearest - 1] < middle[nearest] - at).astype(int)
    return np.asarray(held[nearest])


def level_of(series: Mapping[str, ErrorSeries]) -> CommandedLevel:
    """Of all recordings together."""
    before = np.concatenate([s.before.ravel() for s in series.values()])
    after = np.concatenate([s.after.ravel() for s in series.values()])
    noise = float(np.median([s.noise for s in series.values()]))
    return CommandedLevel("rad/s", float(np.sqrt(np.nanmean(before**2))), float(np.sqrt(np.nanmean(after**2))), noise)
