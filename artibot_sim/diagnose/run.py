"""`diagnose`: from recordings and a robot to a :class:`Diagnosis`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from artibot_sim.diagnose.command_view import command_view
from artibot_sim.diagnose.decision import Decision, decide
from artibot_sim.diagnose.diagnosis import Cause, Diagnosis, Found
from artibot_sim.diagnose.extended import found_parameters, robot_of, uncertain
from artibot_sim.diagnose.looks import look
from artibot_sim.diagnose.predictions import Pair, baseline_levels, gains, improvement, predict
from artibot_sim.diagnose.ranking import ranking
from artibot_sim.diagnose.thresholds import THRESHOLDS, Thresholds
from artibot_sim.errors import ArtibotError
from artibot_sim.experiment import Experiment
from artibot_sim.identify.parameters import SOIL, parameter_set
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import channel_levels
from artibot_sim.identify.run import WINDOW, Trust, best_fit, problem_of
from artibot_sim.identify.search import Effort, Fit
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.progress import Report

HORIZON = 5.0
"""s over which predictions are judged."""
PRIOR_ODDS = 1.0
"""Of an effect being there, before anything was measured: whoever asks for a diagnosis has a reason."""
FALSE_ALARM_RATE = 0.01
"""Share of the cases with nothing hidden in which something is named."""
TRUST = Trust(level=1.6, thinning=4.0)
"""Of residuals to be noise, before anything is known of what is missing: as slow and large as a total station errs."""
_TICKS = 130
"""About how many parts of equal length a diagnosis has."""


@dataclass(frozen=True)
class Options:
    """How a diagnosis is made; see `diagnose`."""

    horizon: float = HORIZON
    seed: int = 0
    workers: int | None = None
    prior_odds: float = PRIOR_ODDS
    false_alarm_rate: float = FALSE_ALARM_RATE
    thresholds: Thresholds = THRESHOLDS


class _Ticks:
    """Counts parts of the work."""

    def __init__(self, report: Report | None) -> None:
        self._report, self._count = report or (lambda _: None), 0

    def __call__(self) -> None:
        self._count += 1
        self._report(self._count / (self._count + _TICKS) if self._count > _TICKS else 0.5 * self._count / _TICKS)

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
) -> Diagnosis:
    """What the simulation of these recordings gets wrong, and why.

    Soil is identified first, so that an effect only counts for what no soil explains. Every effect of
    `model.effects` is then tried beside it: screened, the promising ones fitted together with the soil, and the best
    one added as long as that is worth it. See docs/diagnosis.md.

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
        Length of the predictions that gains are judged by, s.
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

    Raises
    ------
    ArtibotError
        For recordings that lack what is needed.
    """
    begun, ticks = time.perf_counter(), _Ticks(progress)
    options = Options(horizon, seed, workers, prior_odds, false_alarm_rate, thresholds)
    _check(recordings, options)
    fitted, held = split(recordings, holdout)
    problem, fit = _baseline(fitted, robot, options, ticks)
    view = command_view(fitted, robot, seed=options.seed)
    decision = decide(problem, fit, options, ticks, view)
    result = _result(robot, fitted, held, decision, options, ticks)
    ticks.done()
    return replace(result, seconds=time.perf_counter() - begun)


def _check(recordings: Sequence[Experiment], options: Options) -> None:
    if not recordings:
        raise ArtibotError("diagnose: no recording; give at least one")
    if not (np.isfinite(options.horizon) and options.horizon >= 0.5):
        raise ArtibotError(f"horizon: {options.horizon} s; expected at least 0.5 s")
    if not (np.isfinite(options.prior_odds) and options.prior_odds > 0.0):
        raise ArtibotError(f"prior_odds: {options.prior_odds}; expected a number greater than 0, such as 1")
    if not 0.0 < options.false_alarm_rate < 1.0:
        raise ArtibotError(f"false_alarm_rate: {options.false_alarm_rate}; expected a share between 0 and 1")


def split(recordings: Sequence[Experiment], holdout: Sequence[Experiment]) -> tuple[list[Experiment], list[Experiment]]:
    """Recordings to fit and to hold out, in an order that does not depend on theirs."""
    fitted, held = sorted(recordings, key=_order), sorted(holdout, key=_order)
    if not held and len(fitted) > 1:
        return fitted[:-1], fitted[-1:]
    if not held:
        return first_part(fitted[0])
    return fitted, held


def first_part(experiment: Experiment) -> tuple[list[Experiment], list[Experiment]]:
    """The first two thirds of a recording, and the rest."""
    begin, end = experiment.segments[0][0], experiment.segments[-1][1]
    border = begin + 2.0 / 3.0 * (end - begin)
    parts = []
    for name, a, b in (("", begin, border), (" (last third)", border, end)):
        segments = tuple((max(s, a), min(e, b)) for s, e in experiment.segments if max(s, a) < min(e, b))
        channels = {key: channel.between(a, b) for key, channel in experiment.channels.items()}
        channels = {key: channel for key, channel in channels.items() if len(channel)}
        parts.append(replace(experiment, name=experiment.name + name, channels=channels, segments=segments))
    return parts[:1], parts[1:]


def _order(experiment: Experiment) -> tuple[str, int, float, float]:
    """What recordings are sorted by: their names, then what is in them."""
    motors = experiment.channels.get("motor_torques")
    total = sum(float(np.nansum(column)) for column in motors.columns.values()) if motors is not None else 0.0
    return experiment.name, experiment.start_ns, experiment.duration, total


def _baseline(fitted: Sequence[Experiment], robot: Robot, options: Options, ticks: _Ticks) -> tuple[Problem, Fit]:
    """The paper's model with its soil identified; all windows keep their say, for local effects hide in bad ones."""
    problem = problem_of(fitted, parameter_set(robot, SOIL), WINDOW, options.workers)
    return best_fit(problem, Effort(seed=options.seed), ticks, TRUST)


def _result(
    robot: Robot, fitted: Sequence[Experiment], held: Sequence[Experiment], decision: Decision, options: Options,
    ticks: _Ticks,
) -> Diagnosis:  # fmt: skip
    """The decision as a diagnosis, with what it is worth on held-out data."""
    names = [e.name for e in fitted]
    before = uncertain(decision.neutral_problem, decision.neutral_fit, options.seed)
    baseline = robot_of(decision.neutral_problem, before, {}, names)
    problem, after = decision.problem, uncertain(decision.problem, decision.fit, options.seed)
    effects: dict[str, Mapping[str, Found]] = {}
    place = len(problem.parameters.parameters)
    for extension in problem.parameters.extensions:
        part = slice(place, place + len(extension))
        effects[extension.id] = found_parameters(extension, after.point.coordinates[part], after.covariance[part, part])
        place += len(extension)
    effects |= {named.effect: named.found for named in decision.named if named.found}
    extended = robot_of(problem, after, effects, names) if effects else baseline
    pairs = []
    for experiment, out in [*((e, False) for e in fitted), *((e, True) for e in held)]:
        pairs.append(predict(experiment, out, baseline, extended, options.horizon, options.workers))
        ticks()
    causes = _causes(decision, effects, pairs, problem)
    return Diagnosis(
        verdict=decision.verdict, robot=robot, baseline_robot=baseline, extended=extended, bags=tuple(names),
        holdout=tuple(e.name for e in held), horizon=options.horizon, baseline=baseline_levels(pairs), where=(),
        causes=causes, ranking=ranking(decision), unexplained=None,
        gain=gains([p for p in pairs if p.held_out], options.seed), next_experiment=None,
        looks=tuple(look(pair, robot) for pair in pairs), prior_odds=options.prior_odds,
        threshold=decision.least, seed=options.seed,
    )  # fmt: skip


def _causes(
    decision: Decision, effects: Mapping[str, Mapping[str, Found]], pairs: Sequence[Pair], problem: Problem
) -> tuple[Cause, ...]:
    """The named effects, most probable first."""
    levels = channel_levels(problem.windows, decision.fit.point.residuals)
    gained = improvement([p for p in pairs if p.held_out], levels)
    found = [
        Cause(named.effect, effects[named.effect], named.nats / np.log(10.0), gained, named.ties)
        for named in decision.named
        if named.effect in effects and named.effect in EFFECTS
    ]
    return tuple(sorted(found, key=lambda cause: -cause.log10_bayes_factor))
