"""A diagnosis made of simulations: a rover with an effect, predicted without it and with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from artibot_sim.diagnose.records import (
    Candidate,
    Cause,
    ChannelBaseline,
    ChannelGain,
    Comparison,
    EffectEstimate,
    ErrorSeries,
    NextExperiment,
    Unexplained,
)
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.validation.residuals import places
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.estimation.windows import CHANNEL_NAMES, Window
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.measured import Measured
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.identify.validation import PredictedRecording, hold_out
from artibot_sim.model import MOTORS, Robot, load_robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.planning import Arc, Dwell, Eight, Manoeuvre, Ramp, Slalom, Stop, Straight

TURNS = Manoeuvre(
    "turns",
    (Dwell(0.5), Ramp(speed=0.6), Slalom(curvature=0.45, wavelength=5.0, periods=1.5),
     Arc(radius=1.6, angle=-2.5), Stop()),
    a_max=0.5, blend=0.3,
)  # fmt: skip
EIGHT = Manoeuvre("eight", (Dwell(0.5), Eight(radius=1.8, smooth=True, speed=0.6)), a_max=0.5, blend=0.3)
STRAIGHT = Manoeuvre(
    "out", (Dwell(0.5), Ramp(speed=0.6), Straight(length=4.0), Arc(radius=2.0, angle=1.6), Stop()), a_max=0.5, blend=0.3
)


def with_effect(robot: Robot, effect: str, values: dict[str, float | str]) -> Robot:
    """The robot with one effect."""
    return replace(robot, effects={effect: values})


def drives(robot: Robot, manoeuvres: tuple[Manoeuvre, ...] = (TURNS, EIGHT)) -> list[Experiment]:
    """Recordings of a robot, each with other noise."""
    return [
        synthetic(robot, manoeuvre, kappa=(0.7, 1.0, 0.8)[k % 3], seed=k, name=f"run{k}", duration=25.0)
        for k, manoeuvre in enumerate(manoeuvres)
    ]


def compared(
    experiment: Experiment, before: PredictedRecording, after: PredictedRecording, robot: Robot, held_out: bool
) -> Comparison:
    """A recording with the predictions of two models."""
    motors = experiment.channels["motor_torques"]
    t = np.arange(0.0, experiment.duration, 0.2)
    x, y, yaw, vx, vy, yaw_rate, bend, _ = Measured(experiment, *experiment.segments[0]).along(t).T
    load = sum(np.abs(np.interp(t, motors.t, motors[f"{motor}.effort"])) for motor in MOTORS)
    covariates = {
        "t": t, "speed": np.cos(yaw) * vx + np.sin(yaw) * vy, "yaw_rate": yaw_rate, "heading": yaw,
        "articulation_yaw": bend, "x": x, "y": y, "load": load,
    }  # fmt: skip
    point = experiment.channels["total_station"]
    free = [tuple(_path(run.window, run.residual) for run in held.free) for held in (before, after)]
    return Comparison(
        experiment.name, held_out, np.column_stack([point.t, point["x"], point["y"]]),
        tuple(_path(w, r) for w, r in zip(before.windows, before.residuals, strict=True)),
        tuple(_path(w, r) for w, r in zip(after.windows, after.residuals, strict=True)),
        free[0], free[1], before.summary.left, after.summary.left, _series(before, after), covariates,
    )  # fmt: skip


def _path(window: Window, residual: np.ndarray) -> np.ndarray:
    predicted, kind = residual * window.sigma + window.value, window.plan.kind
    return np.column_stack([window.t + window.plan.t[kind == 0], predicted[kind == 0], predicted[kind == 1]])


def _series(before: PredictedRecording, after: PredictedRecording) -> dict[str, ErrorSeries]:
    found = {}
    for c, name in enumerate(CHANNEL_NAMES):
        if name not in before.summary.channels:
            continue
        tables = [_errors(held, c) for held in (before, after)]
        noise = before.summary.channels[name].noise / (np.sqrt(2.0) if name == "position" else 1.0)
        errors = [table[:, 1:] if name == "position" else table[:, 1] for table in tables]
        found[name] = ErrorSeries(tables[0][:, 0], errors[0], errors[1], noise)
    return found


def _errors(held: PredictedRecording, channel: int) -> np.ndarray:
    parts = []
    for window, residual in zip(held.windows, held.residuals, strict=True):
        error, t = residual * window.sigma, window.t + window.plan.t
        if CHANNEL_NAMES[channel] == "position":
            x, y = window.plan.kind == 0, window.plan.kind == 1
            parts.append(np.column_stack([t[x], error[x], error[y]]))
        else:
            mine = window.channel == channel
            parts.append(np.column_stack([t[mine], error[mine]]))
    table = np.vstack(parts)
    return table[np.argsort(table[:, 0], kind="stable")]


@cache
def simulated(
    effect: str, values: tuple[tuple[str, float | str], ...]
) -> tuple[Robot, list[Comparison], tuple[PredictedRecording, PredictedRecording]]:
    """The rover with an effect, its recordings with both models' predictions, and those of the one held out."""
    robot = load_robot("agriq")
    truth = with_effect(robot, effect, dict(values)) if effect else robot
    comparisons, pairs = comparisons_of(robot, truth, drives(truth))
    return truth, comparisons, pairs[-1]


def comparisons_of(
    robot: Robot, truth: Robot, recordings: list[Experiment]
) -> tuple[list[Comparison], list[tuple[PredictedRecording, PredictedRecording]]]:
    """Recordings of `truth` as predicted by `robot` and by itself; the last one counts as held out."""
    pairs = [(hold_out(e, robot, 5.0), hold_out(e, truth, 5.0)) for e in recordings]
    last = len(recordings) - 1
    comparisons = [
        compared(e, *pair, robot, k == last) for k, (e, pair) in enumerate(zip(recordings, pairs, strict=True))
    ]
    return comparisons, pairs


def case(effect: str, values: dict[str, float | str], verdict: Verdict = Verdict.NAMED) -> Diagnosis:
    """What a diagnosis of a rover with this effect may say: errors and paths are simulated, evidence is made up."""
    robot = load_robot("agriq")
    truth, comparisons, fits = simulated(effect, tuple(values.items()))
    baseline = {
        name: ChannelBaseline(fit.unit, fit.rmse, fit.noise, fits[0].summary.free_run[name].rmse)
        for name, fit in fits[0].summary.channels.items()
    }
    gain = {
        name: ChannelGain(fit.unit, fit.rmse, fits[1].summary.channels[name].rmse, (0.9 * fit.rmse, fit.rmse))
        for name, fit in fits[0].summary.channels.items()
    }
    found = verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    return Diagnosis(
        verdict=verdict, robot=robot, baseline_robot=robot, extended=truth, bags=("run0",), holdout=("run1",),
        horizon=5.0, baseline=baseline, where=places(comparisons, baseline),
        causes=(_cause(effect, values, ("external_force",) if verdict is Verdict.AMBIGUOUS else ()),) if found else (),
        ranking=_ranking(effect, values), gain=gain,
        unexplained=Unexplained("front yaw moment", "yaw rate", "proportional", 12.0, "N m", "in turns, all runs")
        if verdict is Verdict.UNEXPLAINED else None,
        next_experiment=NextExperiment("Drive an eight of 2 m radius.", "eight", (effect, "external_force"), 55.0)
        if verdict is Verdict.AMBIGUOUS else None,
        warnings=("run0: /imu/data is silent for 0.8 s from 3.1 s on",), comparisons=tuple(comparisons), prior_odds=0.5,
        false_alarm_rate=0.02,
        threshold=25.0, seed=3, seconds=41.5, findings=("run0: /imu/data is stamped 0.17 s late",),
    )  # fmt: skip


def _cause(effect: str, values: dict[str, float | str], ties: tuple[str, ...]) -> Cause:
    parameters = {}
    for name, value in values.items():
        if isinstance(value, str):
            parameters[name] = EffectEstimate(value)
        else:
            unit = getattr(EFFECTS[effect].parameters[name].quantity, "unit", "")
            parameters[name] = EffectEstimate(value, unit, (value - 0.05 * abs(value), value + 0.05 * abs(value)))
    return Cause(effect, parameters, 41.2, 0.83, ties)


def _ranking(effect: str, values: dict[str, float | str]) -> tuple[Candidate, ...]:
    others = [name for name in EFFECTS if name != effect]
    best = [Candidate(effect, 41.2, values, fitted=True)] if effect else []
    numbers = [name for name in others if not isinstance(next(iter(EFFECTS[name].parameters.values())).neutral, str)]
    rest = [
        Candidate(name, 6.0 - 1.1 * k, {}, {next(iter(EFFECTS[name].parameters)): 0.1 * (k + 1)}, "", k < 3)
        for k, name in enumerate(numbers)
    ]
    return tuple(best + rest)
