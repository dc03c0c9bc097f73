"""A recording that was not fitted: predicted window by window, run freely, and held against kinematic models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.kinematic import TIMED, UNTIMED, Kinematic
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.measurements import CHANNEL_UNITS, HALF_WIDTH, Stretch, noise_levels, stretches
from artibot_sim.estimation.parameters import ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import restarted_windows
from artibot_sim.estimation.solver import Point, evaluate, step
from artibot_sim.estimation.windows import CHANNEL_NAMES, HEADINGS, START, Window, cut, predecessors, window_at
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.resimulate import StartedWindow
from artibot_sim.experiment.smoothing import fresh
from artibot_sim.identify.result import ChannelFit, Prediction, spaced
from artibot_sim.model import Robot, initial_state
from artibot_sim.model.simulate.state import from_memory
from artibot_sim.model.simulate.window_inputs import KINDS, SamplingPlan

# ----------------------------------------------------------------------
# How far predictions are from measurements, channel by channel.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


def deviations(window: Window, residual: Array, channel: int) -> tuple[Array, Array]:
    """Times (m,) after the window's start and absolute errors (m,) in SI units; of positions the distance."""
    mine = window.channel == channel
    t, error, kind = window.plan.t[mine], (residual * window.sigma)[mine], window.plan.kind[mine]
    if CHANNEL_NAMES[channel] != "position":
        return t, np.abs(error)
    x, y = kind == 0, kind == 1
    return t[x], np.hypot(error[x], error[y])


def channel_fits(
    windows: Sequence[Window], residuals: Sequence[Array], noise: Mapping[str, float], last: bool = False
) -> dict[str, ChannelFit]:
    """Sizes of all errors (or, with `last`, of each window's last one) by channel; `noise` is of one coordinate."""
    found = {}
    for c, name in enumerate(CHANNEL_NAMES):
        parts = [deviations(w, r, c)[1] for w, r in zip(windows, residuals, strict=True)]
        parts = [part[-1:] if last else part for part in parts if len(part)]
        if not parts:
            continue
        error = np.concatenate(parts)
        level = noise[name] * (np.sqrt(2.0) if name == "position" else 1.0)
        means = [float(np.sqrt(np.mean(part**2))) for part in parts]
        found[name] = ChannelFit(
            CHANNEL_UNITS[name], float(level), float(np.sqrt(np.mean(error**2))), float(np.median(error)),
            float(np.quantile(error, 0.9)), len(error), float(np.median(means) / level),
        )  # fmt: skip
    return found


_WORST = 0.05
"""Share of windows that are named."""
_LEAP = 2.0
"""m/s from one measured position to the next, faster than any rover here drives."""
_FEWEST = 20
"""Windows without which none is named."""
_GAINS = 0.9
"""RMSE of a kinematic model with a delay of the poses over that without, from which on the delay counts."""


def end_errors(windows: Sequence[Window], residuals: Sequence[Array], name: str) -> Array:
    """Absolute errors of a channel at the windows' ends, shape (windows,), SI; NaN where it was not measured."""
    ends = [deviations(w, r, CHANNEL_NAMES.index(name))[1][-1:] for w, r in zip(windows, residuals, strict=True)]
    return np.array([end[0] if len(end) else np.nan for end in ends])


def worst_of(error: Array) -> NDArray[np.int64]:
    """Which windows are named as the worst, the worst first."""
    return np.argsort(-error)[: round(_WORST * len(error))]


def outliers(windows: Sequence[Window], residuals: Sequence[Array]) -> tuple[str, ...]:
    """Sentences that name the windows with the largest errors at their ends, and whether their positions leap."""
    if len(windows) < _FEWEST:
        return ()
    said = []
    for name in ("position", "yaw"):
        error = end_errors(windows, residuals, name)
        if not np.isfinite(error).all():
            continue
        worst = worst_of(error).tolist()
        share = float((error[worst] ** 2).sum() / max(float((error**2).sum()), 1e-300))
        listed = ", ".join(f"{error[i]:.2f} at {windows[i].t:.0f} s{'*' if _leaps(windows[i]) else ''}" for i in worst)
        said.append(
            f"the worst {len(worst)} of {len(windows)} windows hold {100 * share:.0f} % of the squared error of {name} "
            f"at the ends: {listed} ({spaced(CHANNEL_UNITS[name])})"
        )
    if any("*" in sentence for sentence in said):
        said.append(f"*: measured positions leap there, by more than {_LEAP:g} m/s from one to the next")
    return tuple(said)


def _leaps(window: Window) -> bool:
    """Whether measured positions are further apart than a rover gets; held ones are left out."""
    x, y, _ = window.places
    points, t = np.column_stack([window.value[x], window.value[y]]), window.plan.t[x]
    new = fresh(points)
    away = np.hypot(*np.diff(points[new], axis=0).T)
    return bool((away > _LEAP * np.maximum(np.diff(t[new]), 1e-3)).any())


def late_poses(predictions: Sequence[Prediction], rivals: Mapping[str, Kinematic]) -> tuple[str, ...]:
    """A sentence for each prediction that a delay of the poses would better, as a kinematic model that has one shows.

    A delay that streams do not tell by themselves (no gyroscope, wheels at 1 to 3 Hz) is not mended beforehand.
    """
    said = []
    for one in predictions:
        timed, plain = one.rivals.get(TIMED, {}), one.rivals.get(UNTIMED, {})
        better = [
            words
            for words, name in (("position", "position"), ("heading", "yaw"))
            if name in timed and timed[name].rmse < min(_GAINS * plain[name].rmse, one.final[name].rmse)
        ]
        if better:
            late = rivals[TIMED].delay
            said.append(
                f"{one.name}: {TIMED} predicts {' and '.join(better)} better than this model. It has poses "
                f"{abs(late):.2f} s {'later' if late > 0.0 else 'earlier'} than rotations; add timing to --fit to fit "
                "that delay here as well"
            )
    return tuple(said)


def kinematic_residuals(model: Kinematic, problem: Problem, starts: Array) -> list[Array]:
    """Residuals of position and yaw of every window by a kinematic model, in units of noise; 0 of other channels."""
    every = []
    for window, (at, pose) in zip(problem.windows, _kinematic_paths(model, problem, starts), strict=True):
        predicted = window.value.copy()
        for column, kinds in zip(pose, ((0,), (1,), HEADINGS), strict=True):
            mine = np.isin(window.plan.kind, kinds)
            predicted[mine] = np.interp(window.plan.t[mine], at, column)
        every.append(predicted)
    return list(problem.parts(problem.compare(np.concatenate(every)[None])[0]))


def _kinematic_paths(model: Kinematic, problem: Problem, starts: Array) -> list[tuple[Array, Array]]:
    """Times (n,) after each window's start, s, and poses (3, n) from its start on, m and rad."""
    found = []
    for window, start in zip(problem.windows, starts, strict=True):
        inputs = problem.stretches[window.stretch].inputs
        at = inputs.t[window.first : window.first + window.knots + 1]
        forward, left, turned = model.path(at, inputs.t, inputs.velocity[:, :2]).T
        c, s = np.cos(start[2]), np.sin(start[2])
        pose = start[0] + c * forward - s * left, start[1] + s * forward + c * left, start[2] + turned
        found.append((at - at[0], np.array(pose)))
    return found


def _kinematic_starts(model: Kinematic, problem: Problem) -> Array:
    """Starts whose poses are what a kinematic model says that fits the window before: where there is one."""
    residuals = np.concatenate(kinematic_residuals(model, problem, problem.starts))
    (fitted,), _ = problem.aligned(residuals[None], problem.starts[None])
    paths, starts = _kinematic_paths(model, problem, fitted), problem.starts.copy()
    for i, before in enumerate(predecessors(problem.windows)):
        if before is not None:
            at, pose = paths[before]
            t = problem.windows[i].t - problem.windows[before].t
            starts[i, :3] = [np.interp(t, at, column) for column in pose]
    return starts


# ----------------------------------------------------------------------
# A recording that was not fitted: predicted window by window, and run freely.
# ----------------------------------------------------------------------


_STEPS = 4
_OTHER = 0.3
"""s during which other wheels slide than in the measured run, before the branch counts as left."""
_LOOK = 0.02
"""s between instants at which it is asked which wheels slide."""
_FAR = 4.0
"""Distance, in the sensor's noise, that a run which has left its branch must reach."""


@dataclass(frozen=True)
class Free:
    """One simulation of a whole stretch.

    Attributes
    ----------
    window : Window
        All of the stretch.
    residual : array, shape (n,)
        In units of noise.
    left : float or None
        s of the recording.
    """

    window: Window
    residual: Array
    left: float | None


@dataclass(frozen=True)
class PredictedRecording:
    """Predictions of a held-out recording, in detail (for pictures); `summary` is what counts.

    Attributes
    ----------
    experiment : Experiment
    windows : list of Window
        Those that were predicted.
    residuals : list of array
        In units of noise, (n,) each.
    free : list of Free
    summary : Prediction
    stretches : sequence of Stretch
        What the windows are of.
    rivals : mapping of str to list of array
        Residuals of position and yaw by kinematic models.
    starts : array, shape (windows, 8 or 6)
        What predictions began with, in the order of `windows.START`.
    """

    experiment: Experiment
    windows: list[Window]
    residuals: list[Array]
    free: list[Free]
    summary: Prediction
    stretches: Sequence[Stretch] = ()
    rivals: Mapping[str, list[Array]] = field(default_factory=dict)
    starts: Array = field(default_factory=lambda: np.empty((0, len(START))))


def hold_out(
    experiment: Experiment,
    robot: Robot,
    horizon: float,
    workers: int | None = None,
    rivals: Mapping[str, Kinematic] = MappingProxyType({}),
    steps: int = _STEPS,
    half_width: float = HALF_WIDTH,
    seen: Sequence[Stretch] = (),
) -> PredictedRecording:
    """Predict a recording with a robot as it is; kinematic `rivals` predict it as well.

    Every window of `horizon` s starts from the pose that was measured there, where headings were measured with the
    positions. All else of a start is what the window before it says: the start of that one is estimated from its own
    samples, and the model carries it to its end; a rival carries poses, too, where they were not measured. So no model
    begins where another one led. Where there is no window before (the first of a stretch, or a stretch no longer than
    a window) a prediction starts from the measured pose, rolling as its wheels say. Starts are estimated by so many
    `steps`, motors smoothed over `half_width` s, unless the recording's stretches were `seen` already.
    """
    found = list(seen) or stretches(experiment, robot, half_width)
    ahead = _begin(found, robot, horizon, workers, steps)
    windows, problem, carried = ahead.problem.windows, ahead.problem, ahead.starts
    chosen = np.flatnonzero(ahead.counted).tolist()
    here = np.empty(0)
    residuals = problem.residuals([here], carried)[0]
    noise = noise_levels(found)
    free = _free_runs(problem, ahead.point, found, robot, workers)
    predicted = [windows[i] for i in chosen]
    errors = [residuals[i] for i in chosen]
    rolled = {name: kinematic_residuals(rival, problem, _rival_starts(rival, ahead)) for name, rival in rivals.items()}
    others = {name: [own[i] for i in chosen] for name, own in rolled.items()}
    left = next((run.left for run in free if run.left is not None), None)
    summary = Prediction(
        experiment.name, horizon, len(chosen), channel_fits(predicted, errors, noise),
        channel_fits(predicted, errors, noise, last=True),
        channel_fits([run.window for run in free], [run.residual for run in free], noise), left,
        "windows are separate: each starts from its measured pose" if ahead.separate else "",
        {name: _ends(predicted, own, noise) for name, own in others.items()},
        outliers(predicted, errors) if ahead.separate else (),
    )  # fmt: skip
    return PredictedRecording(experiment, predicted, errors, free, summary, found, others, carried[chosen])


@dataclass(frozen=True)
class _Ahead:
    """How the windows of a recording begin when they are predicted.

    Attributes
    ----------
    problem : Problem
        All windows.
    point : Point
        Starts that explain the windows themselves best.
    starts : array, shape (windows, 8 or 6)
        What predictions begin with.
    measured : array of bool, shape (windows, 8 or 6)
        What of that is as measured, and not what the window before says.
    counted : array of bool, shape (windows,)
        Whether a window is a prediction to be counted.
    separate : bool
        Whether hardly any window follows another, so that starts are as measured.
    """

    problem: Problem
    point: Point
    starts: Array
    measured: NDArray[np.bool_]
    counted: NDArray[np.bool_]
    separate: bool


def _begin(found: Sequence[Stretch], robot: Robot, horizon: float, workers: int | None, steps: int) -> _Ahead:
    """The windows of `horizon` s in stretches, and with what they begin: see `hold_out`."""
    windows = cut(found, robot, horizon)
    problem = Problem(ParameterSet(robot, ()), found, windows, workers)
    point = fitted_starts(problem, steps)
    carried = problem.carried(np.empty(0), point.starts)
    followed = np.array([before is not None for before in predecessors(windows)])
    separate = int((~followed).sum()) > len(windows) // 2
    measured = np.repeat(~followed[:, None], problem.size, axis=1)
    measured[:, :3] |= np.array([window.start.late for window in windows])[:, None]
    carried[measured] = problem.starts[measured]
    return _Ahead(problem, point, carried, measured, followed | separate, separate)


def _rival_starts(rival: Kinematic, ahead: _Ahead) -> Array:
    """What a kinematic model's predictions begin with: poses are its own where they are not measured."""
    if ahead.measured[:, :3].all():
        return ahead.starts
    return np.where(ahead.measured, ahead.starts, _kinematic_starts(rival, ahead.problem))


def windows_to_resimulate(
    experiment: Experiment, robot: Robot, horizon: float
) -> tuple[list[StartedWindow], dict[str, float]]:
    """The windows of a recording as `hold_out` predicts them, for a simulation; and the noise of each channel.

    Raises
    ------
    ArtibotError
        As `stretches`; and where no window holds enough positions.
    """
    found = stretches(experiment, robot)
    if not cut(found, robot, horizon):
        raise ArtibotError(
            f"{experiment.path}: no window of {horizon:g} s holds four positions; give a longer --horizon, or none"
        )
    ahead = _begin(found, robot, horizon, None, _STEPS)
    items = ahead.problem.items_from(robot, ahead.starts)
    rest, windows = initial_state(robot), []
    for i, window in enumerate(ahead.problem.windows):
        state = replace(rest, t=window.t, q=items.q[i], v=items.v[i])
        if items.memory is not None:
            lateral, bristles, windup = from_memory(items.memory[i])
            state = replace(state, lateral=lateral, bristles=bristles, windup=windup)
        stretch, last = found[window.stretch], window.first + window.knots
        windows.append(StartedWindow(stretch.inputs, window.first, last, state, bool(ahead.counted[i])))
    return windows, noise_levels(found)


def _ends(windows: Sequence[Window], residuals: Sequence[Array], noise: Mapping[str, float]) -> dict[str, ChannelFit]:
    """Errors of a kinematic model at the ends of predictions."""
    fits = channel_fits(windows, residuals, noise, last=True)
    return {name: fit for name, fit in fits.items() if name in ("position", "yaw")}


def fitted_starts(problem: Problem, steps: int = _STEPS) -> Point:
    """Starts that explain their windows best, the parameters as they are."""
    here = np.zeros(len(problem.parameters))
    loss = Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    point = evaluate(problem, loss, [here], problem.starts)[0]
    for _ in range(steps):
        point = restarted_windows(problem, loss, point)
        point, _, _ = step(problem, loss, point, ())
    return point


def _free_runs(
    problem: Problem, point: Point, found: Sequence[Stretch], robot: Robot, workers: int | None
) -> list[Free]:
    """Every stretch of several windows in one go, from the start that its first window was given."""
    runs = []
    for number, stretch in enumerate(found):
        mine = [i for i, w in enumerate(problem.windows) if w.stretch == number]
        if len(mine) < 2:
            continue
        first = problem.windows[mine[0]]
        whole = window_at(stretch, number, robot, first.first, len(stretch.inputs.t) - 1 - first.first)
        alone = Problem(ParameterSet(robot, ()), found, [whole], workers)
        start = point.starts[mine[0]][None]
        residual = alone.residuals([np.empty(0)], start)[0][0]
        runs.append(Free(whole, residual, _left(problem, point, mine, alone, start, residual)))
    return runs


def _left(
    problem: Problem, point: Point, mine: Sequence[int], alone: Problem, start: Array, residual: Array
) -> float | None:
    """When other wheels slide than in the windows that follow the measurements, and the run goes astray for it."""
    whole = alone.windows[0]
    t, error = deviations(whole, residual, CHANNEL_NAMES.index("position"))
    if not len(t) or error.max() < _FAR * whole.sigma[whole.channel == 0][0]:
        return None
    sliding = KINDS.index("sliding")
    times = [np.arange(0.0, duration, _LOOK) for duration in problem.durations]
    followed = problem.sampled(np.empty(0), point.starts, [SamplingPlan(x, np.full(len(x), sliding)) for x in times])
    at = np.concatenate([problem.windows[i].t + times[i] for i in mine])
    patterns = np.concatenate([followed[i] for i in mine])
    free = alone.sampled(np.empty(0), start, [SamplingPlan(np.maximum(at - whole.t, 0.0), np.full(len(at), sliding))])[
        0
    ]
    other = patterns != free
    need = round(_OTHER / _LOOK)
    for k in np.flatnonzero(other):
        if other[k : k + need].mean() > 0.9 and len(other[k : k + need]) == need:
            after = error[t >= at[k] - whole.t]
            if len(after) and after.max() > _FAR * whole.sigma[whole.channel == 0][0]:
                return float(at[k])
    return None
