"""A recording that was not fitted: predicted window by window, and run freely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment import Experiment
from artibot_sim.identify.gauss_newton import Point, evaluate, step
from artibot_sim.identify.identification import ChannelFit, Prediction
from artibot_sim.identify.parameters import ParameterSet
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.quality import channel_fits, deviations, outliers
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.search import awake
from artibot_sim.identify.sensing import HALF_WIDTH, Stretch, noise_levels, stretches
from artibot_sim.identify.skid import Kinematic
from artibot_sim.identify.windows import CHANNEL_NAMES, Window, cut, predecessors, window_at
from artibot_sim.model import Robot
from artibot_sim.model.windows import KINDS, Plan

Array = NDArray[np.float64]

_STEPS = 4
_OTHER = 0.3
"""s during which other wheels slide than in the measured run, before the branch counts as left."""
_LOOK = 0.02
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
class Held:
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
    """

    experiment: Experiment
    windows: list[Window]
    residuals: list[Array]
    free: list[Free]
    summary: Prediction
    stretches: Sequence[Stretch] = ()
    rivals: Mapping[str, list[Array]] = field(default_factory=dict)


def hold_out(
    experiment: Experiment,
    robot: Robot,
    horizon: float,
    workers: int | None = None,
    rivals: Sequence[Kinematic] = (),
    steps: int = _STEPS,
    half_width: float = HALF_WIDTH,
    seen: Sequence[Stretch] = (),
) -> Held:
    """Predict a recording with a robot as it is; `rivals` predict it as well.

    Every window of `horizon` s starts from what the window before it measured: the start of that one is estimated
    from its own samples, and the model carries it to its end. Where there is none before (the first of a stretch,
    or a stretch no longer than a window) a prediction starts from the measured pose, rolling as its wheels say.
    Starts are estimated by so many `steps`, motors smoothed over `half_width` s, unless the recording's stretches were
    `seen` already.
    """
    found = list(seen) or stretches(experiment, robot, half_width)
    windows = cut(found, robot, horizon)
    problem = Problem(ParameterSet(robot, ()), found, windows, workers)
    here = np.empty(0)
    point = fitted_starts(problem, steps)
    carried = problem.carried(here, point.starts)
    followed = [before is not None for before in predecessors(windows)]
    alone = [i for i in range(len(windows)) if not followed[i]]
    short = len(alone) > len(windows) // 2
    chosen = list(range(len(windows))) if short else [i for i in range(len(windows)) if followed[i]]
    if short:
        carried[alone] = problem.starts[alone]
    residuals = problem.residuals([here], carried)[0]
    noise = noise_levels(found)
    free = _free_runs(problem, point, found, robot, workers)
    predicted = [windows[i] for i in chosen]
    errors = [residuals[i] for i in chosen]
    rolled = {m.name: m.predict(problem, carried) for m in rivals}
    others = {name: [own[i] for i in chosen] for name, own in rolled.items()}
    left = next((run.left for run in free if run.left is not None), None)
    summary = Prediction(
        experiment.name, horizon, len(chosen), channel_fits(predicted, errors, noise),
        channel_fits(predicted, errors, noise, last=True),
        channel_fits([run.window for run in free], [run.residual for run in free], noise), left,
        "windows are separate: each starts from its measured pose" if short else "",
        {name: _ends(predicted, own, noise) for name, own in others.items()},
        outliers(predicted, errors) if short else (),
    )  # fmt: skip
    return Held(experiment, predicted, errors, free, summary, found, others)


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
        point = awake(problem, loss, point)
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
    followed = problem.look(np.empty(0), point.starts, [Plan(x, np.full(len(x), sliding)) for x in times])
    at = np.concatenate([problem.windows[i].t + times[i] for i in mine])
    patterns = np.concatenate([followed[i] for i in mine])
    free = alone.look(np.empty(0), start, [Plan(np.maximum(at - whole.t, 0.0), np.full(len(at), sliding))])[0]
    other = patterns != free
    need = round(_OTHER / _LOOK)
    for k in np.flatnonzero(other):
        if other[k : k + need].mean() > 0.9 and len(other[k : k + need]) == need:
            after = error[t >= at[k] - whole.t]
            if len(after) and after.max() > _FAR * whole.sigma[whole.channel == 0][0]:
                return float(at[k])
    return None
