"""`diagnose`: from recordings and a robot to a :class:`Diagnosis`."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.command_view.view import command_view
from artibot_sim.diagnose.data_check.check import require_usable
from artibot_sim.diagnose.diagnosis import Diagnosis
from artibot_sim.diagnose.naming import decide
from artibot_sim.diagnose.options import FALSE_ALARM_RATE, HALF_WIDTH, HORIZON, PRIOR_ODDS, Options
from artibot_sim.diagnose.result import result_of
from artibot_sim.diagnose.thresholds import THRESHOLDS, TRUST, Thresholds
from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment
from artibot_sim.identify.parameters import SOIL
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.run import best_fit, problem_of
from artibot_sim.identify.search import Effort, Fit, Tick
from artibot_sim.identify.sensing import Stretch, stretches
from artibot_sim.model import Robot
from artibot_sim.progress import Report

Array = NDArray[np.float64]

_FEWEST = 12
"""Positions of a recording, without which its last third is too little to be held out."""
_TICKS = 60
"""Parts of the work after which half of the bar is drawn: how many there will be is not known beforehand."""


class _Ticks:
    """Counts parts of the work."""

    def __init__(self, report: Report | None) -> None:
        self._report, self._count = report or (lambda _: None), 0

    def __call__(self) -> None:
        self._count += 1
        self._report(self._count / (self._count + _TICKS))

    def done(self) -> None:
        """All of it is over."""
        self._report(1.0)


def diagnose(
    recordings: Sequence[Experiment],
    robot: Robot,
    *,
    holdout: Sequence[Experiment] = (),
    horizon: float = HORIZON,
    seed: int = 0,
    workers: int | None = None,
    progress: Report | None = None,
    prior_odds: float = PRIOR_ODDS,
    false_alarm_rate: float = FALSE_ALARM_RATE,
    thresholds: Thresholds = THRESHOLDS,
    scheduler: str | None = None,
) -> Diagnosis:
    """What the simulation of these recordings gets wrong, and why.

    Soil is identified first, so that an effect only counts for what no soil explains. Every effect of
    `model.effects` is then tried beside it: screened, the promising ones fitted together with the soil, and the best
    one added as long as that is worth it. See docs/diagnosis_method.md.

    Parameters
    ----------
    recordings : sequence of Experiment
        What `read_bag` gives. Their order does not matter.
    robot : Robot
        The effects that it has are taken to be known.
    holdout : sequence of Experiment
        Recordings that take no part in the fit; without any the last of several recordings is held out, or the last
        third of a single one.
    horizon : float
        Length of the predictions that fits, evidence and gains rest on, s.
    seed : int
        The same data and seed give the same diagnosis.
    workers : int, optional
        Threads; as many as cores by default. The result does not depend on it.
    progress : callable
        Hears the share that is done.
    prior_odds : float
        Of some effect being there beforehand.
    false_alarm_rate : float
        Share of the cases with nothing hidden in which something may be named.
    scheduler : str, optional
        Address of a Dask scheduler (:mod:`artibot_sim.cluster`) whose workers fit one effect each; the rest of the
        work stays here, and the result is the same.

    Raises
    ------
    ArtibotError
        For recordings that lack what is needed.
    """
    begun, ticks = time.perf_counter(), _Ticks(progress)
    options = Options(horizon, seed, workers, prior_odds, false_alarm_rate, thresholds, scheduler)
    _check([*recordings, *holdout], robot, options)
    fitted, held = split(*told_apart(recordings, holdout), robot)
    problem, fit = baseline(fitted, robot, options, ticks)
    view = command_view(fitted, robot, needed=options.least)
    decision = decide(problem, fit, options, ticks, view)
    result = result_of(robot, fitted, held, decision, options, ticks)
    ticks.done()
    return replace(result, seconds=time.perf_counter() - begun)


def _check(recordings: Sequence[Experiment], robot: Robot, options: Options) -> None:
    require_usable(recordings, robot)
    if not (np.isfinite(options.horizon) and options.horizon >= 0.5):
        raise ArtibotError(f"horizon: {options.horizon} s; expected at least 0.5 s")
    if not (np.isfinite(options.prior_odds) and options.prior_odds > 0.0):
        raise ArtibotError(f"prior_odds: {options.prior_odds}; expected a number greater than 0, such as 1")
    if not 0.0 < options.false_alarm_rate < 1.0:
        raise ArtibotError(f"false_alarm_rate: {options.false_alarm_rate}; expected a share between 0 and 1")


def split(
    recordings: Sequence[Experiment], holdout: Sequence[Experiment], robot: Robot
) -> tuple[list[Experiment], list[Experiment]]:
    """Recordings to fit and to hold out, in an order that does not depend on theirs."""
    fitted, held = sorted(recordings, key=_order), sorted(holdout, key=_order)
    if not held and len(fitted) > 1:
        return fitted[:-1], fitted[-1:]
    if not held:
        return first_part(fitted[0], robot)
    return fitted, held


def told_apart(
    recordings: Sequence[Experiment], holdout: Sequence[Experiment]
) -> tuple[list[Experiment], list[Experiment]]:
    """The same with names of their own: `monday/run0` and `tuesday/run0` are both `run0` in their bags."""
    every, seen = sorted([*recordings, *holdout], key=_order), Counter[str]()
    names: dict[int, str] = {}
    for one in every:
        seen[one.name] += 1
        names[id(one)] = one.name if seen[one.name] == 1 else f"{one.name} ({seen[one.name]})"
    fitted, held = ([replace(one, name=names[id(one)]) for one in group] for group in (recordings, holdout))
    return fitted, held


def first_part(experiment: Experiment, robot: Robot) -> tuple[list[Experiment], list[Experiment]]:
    """The first two thirds of what a recording measured of positions while its motors were, and the rest.

    Raises
    ------
    ArtibotError
        Where that is too little to be held out.
    """
    begin, end = experiment.segments[0][0], experiment.segments[-1][1]
    times = np.sort(np.concatenate([_measured(stretch) for stretch in stretches(experiment, robot)]))
    if len(times) < _FEWEST:
        raise ArtibotError(
            f"{experiment.path}: {len(times)} positions are measured while its motors are: too few to hold some out, "
            f"expected at least {_FEWEST}; record longer, or give another recording with --holdout"
        )
    border = float(times[2 * len(times) // 3])
    parts = []
    for name, a, b in (("", begin, border), (" (last third)", border, end)):
        segments = tuple((max(s, a), min(e, b)) for s, e in experiment.segments if max(s, a) < min(e, b))
        channels = {key: channel.between(a, b) for key, channel in experiment.channels.items()}
        channels = {key: channel for key, channel in channels.items() if len(channel)}
        parts.append(replace(experiment, name=experiment.name + name, channels=channels, segments=segments))
    return parts[:1], parts[1:]


def _measured(stretch: Stretch) -> Array:
    """Times of a stretch's positions, s."""
    t = next(series.t for series in stretch.series if series.channel == "position")
    return t[(t >= stretch.inputs.t[0]) & (t <= stretch.inputs.t[-1])]


def _order(experiment: Experiment) -> tuple[str, int, float, float]:
    """What recordings are sorted by: their names, then what is in them."""
    motors = experiment.channels.get("motor_torques")
    total = sum(float(np.nansum(column)) for column in motors.columns.values()) if motors is not None else 0.0
    return experiment.name, experiment.start_ns, experiment.duration, total


def baseline(
    fitted: Sequence[Experiment], robot: Robot, options: Options, tick: Tick = lambda: None
) -> tuple[Problem, Fit]:
    """The paper's model with its soil identified; all windows keep their say, for local effects hide in bad ones."""
    problem = problem_of(fitted, parameter_set(robot, SOIL), options.horizon, options.workers, HALF_WIDTH)
    return best_fit(problem, Effort(seed=options.seed), tick, TRUST)
