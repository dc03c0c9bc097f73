"""`diagnose`: from recordings and a robot to a :class:`Diagnosis`, stage by stage."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.cluster import identity
from artibot_sim.diagnose.candidates.patches import disc_place
from artibot_sim.diagnose.commands.view import CommandView, command_view, view_with
from artibot_sim.diagnose.conclusion import Conclusion, HeldOut, Without, concluded, shows_forces
from artibot_sim.diagnose.extended import found_parameters, robot_of, with_effects_of
from artibot_sim.diagnose.intervals import Uncertain, judged
from artibot_sim.diagnose.next_experiment.choice import next_experiment, next_for_force, one_by_one, repeated
from artibot_sim.diagnose.policy import TRUST
from artibot_sim.diagnose.records import (
    BASELINE,
    EXTENDED,
    GIVEN,
    HALF_WIDTH,
    LAST_THIRD,
    UNNAMED,
    Cause,
    ChannelBaseline,
    Comparison,
    Estimate,
    NextExperiment,
    Options,
    Unexplained,
)
from artibot_sim.diagnose.remains import COMMANDED, beyond_noise, far_beyond_noise
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.selection.decision import Decision
from artibot_sim.diagnose.selection.every_window import EveryWindow
from artibot_sim.diagnose.selection.evidence import DECADE
from artibot_sim.diagnose.selection.ranking import ranking
from artibot_sim.diagnose.selection.stepwise import Naming
from artibot_sim.diagnose.timetable import StageReport, Task, Timetable
from artibot_sim.diagnose.unlisted.finding import unexplained_of
from artibot_sim.diagnose.unlisted.fitting import FittedLaws
from artibot_sim.diagnose.validation.error_budget import error_budget
from artibot_sim.diagnose.validation.explainable import explainable, model_of
from artibot_sim.diagnose.validation.predictions import (
    Pair,
    Worth,
    baseline_levels,
    gains,
    improvements,
    predict,
)
from artibot_sim.diagnose.validation.predictors import best_of, predictors, refusals
from artibot_sim.diagnose.validation.residuals import places
from artibot_sim.diagnose.validation.series import comparison, with_commands
from artibot_sim.diagnose.validation.varying_ground import beside_varying_ground
from artibot_sim.diagnose.verdict import Reason, Verdict
from artibot_sim.diagnose.words import besides, differing, doubt, partly, refutation, refuted_beside, shortfall
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.alignment import Aligned, on_one_clock, stream_table, what_is_wrong, with_faults
from artibot_sim.estimation.boosting import MISSING, can_grow
from artibot_sim.estimation.checks.common_map import in_common_map
from artibot_sim.estimation.checks.recordings import data_warnings, require_usable
from artibot_sim.estimation.measurements import Stretch, missing, stretches
from artibot_sim.estimation.parallel import TimeIsUp, side_by_side, until
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Effort, Fit, Tick
from artibot_sim.estimation.surroundings import surroundings
from artibot_sim.experiment import Experiment
from artibot_sim.identify.judgement import excitation
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.run import best_fit, problem_of
from artibot_sim.identify.validation import PredictedRecording
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS

# ----------------------------------------------------------------------
# A decision as a :class:`Diagnosis`: intervals, what it is worth on held-out data, pictures and warnings.
# ----------------------------------------------------------------------


Parameters = Mapping[str, Mapping[str, Estimate]]


@dataclass(frozen=True)
class Assessment:
    """A decision's models, and their predictions of all recordings.

    Attributes
    ----------
    baseline, extended : Robot
        The paper's model with its soil identified, and with all that is named.
    effects : mapping of str to mapping of str to Estimate
        The named effects' parameters.
    channels : mapping of str to ChannelBaseline
    comparisons : list of Comparison
        What pictures are drawn from.
    neutral : tuple of Held
        All recordings by the paper's model.
    predicted : tuple of Held
        By the extended model.
    worth : HeldOut
        Of all that is named, or of the laws.
    whole : (Problem, Fit)
        The model that was extended, with laws where `extended` has them.
    laws : FittedLaws or None
        Forces on no list as terms of the model: `extended` and `effects` have them.
    """

    baseline: Robot
    extended: Robot
    effects: Parameters
    channels: Mapping[str, ChannelBaseline]
    comparisons: list[Comparison]
    neutral: tuple[PredictedRecording, ...]
    predicted: tuple[PredictedRecording, ...]
    worth: HeldOut
    whole: tuple[Problem, Fit]
    laws: FittedLaws | None = None


def _models(robot: Robot, result: Diagnosis, found: Decision) -> dict[str, Robot]:
    """The models that may predict best, the simplest first; the last one has all that fitted best, named or not."""
    models = {GIVEN: robot, BASELINE: result.baseline_robot, EXTENDED: result.extended}
    if not found.named or len(found.named) == len(result.causes):
        return models
    unnamed = found.problem.parameters.robot_at(found.fit.point.coordinates)
    stated = {one.effect: {name: value.value for name, value in one.found.items()} for one in found.named if one.found}
    return models | {UNNAMED: replace(unnamed, effects={**unnamed.effects, **stated})}


def with_refusals(result: Diagnosis, models: Mapping[str, Robot], commanded: Collection[str]) -> Diagnosis:
    """A result in which robots stand that predict held-out recordings better, where fitted ones are refused.

    Effects that only commands show do not act on such predictions, and stay.

    Parameters
    ----------
    result : Diagnosis
        With its predictors.
    models : mapping of str to Robot
        What these were made of.
    commanded : collection of str
        Named effects that only commands show.
    """
    noise = {name: one.noise for name, one in result.baseline.items() if np.isfinite(one.noise)}
    refused = refusals(result.predictors, models, noise)
    for one in refused:
        if one.holds == one.model:
            continue
        if one.model == BASELINE:
            result = replace(result, baseline_robot=models[one.holds])
        else:
            result = replace(result, extended=with_effects_of(models[one.holds], result.extended, commanded))
    said = [one.why for one in refused]
    return replace(result, refused=tuple(refused), warnings=(*said, *result.warnings))


class Assessor:
    """Predicts recordings with what decisions name; each is made once. What commands show was found in the fitted."""

    def __init__(
        self,
        robot: Robot,
        fitted: Sequence[Experiment],
        held: Sequence[Experiment],
        options: Options,
        ticks: Timetable,
        view: CommandView,
    ) -> None:
        self._robot, self._fitted, self._held, self._options, self._ticks = robot, fitted, held, options, ticks
        self._view = view_with(view, [*fitted, *held], robot)
        self._in_map = in_common_map([*fitted, *held])
        self._made: dict[tuple[tuple[str, ...], bool], Assessment] = {}

    def __call__(self, decision: Decision) -> Assessment:
        """The assessment of what a decision names."""
        key = tuple(one.effect for one in decision.named), decision.laws is not None
        if key not in self._made:
            self._made[key] = self._assessed(decision)
        return self._made[key]

    def worth(self, decision: Decision) -> HeldOut:
        """What is named is worth this on held-out recordings."""
        return self(decision).worth

    def _assessed(self, decision: Decision) -> Assessment:
        found = self._predicted(decision)
        if decision.fitted or found.worth.laws_hold:  # beside effects, tables decide about laws
            return found
        return self._predicted(replace(decision, laws=None))

    def _predicted(self, decision: Decision) -> Assessment:
        """All recordings predicted with all that was found."""
        options, view = self._options, self._view
        names = [one.name for one in self._fitted]
        self._ticks.begin(Task.INTERVALS)
        baseline, extended, effects = _robots(names, decision, options.seed, self._ticks)
        self._ticks.begin(Task.PREDICTIONS)
        pairs = _predictions(self._fitted, self._held, baseline, extended, options, self._ticks)
        levels, comparisons = baseline_levels(pairs), [comparison(pair, self._robot, self._in_map) for pair in pairs]
        channels, comparisons = with_commands(levels, comparisons, *view.for_robot(extended))
        held_out = [pair for pair in pairs if pair.held_out]
        driven = [one.channels[COMMANDED] for one in comparisons if one.held_out and COMMANDED in one.channels]
        gained = improvements(decision, held_out, extended, view, options)
        gain = gains(held_out, driven if view.followed else [], options.seed)
        worth = HeldOut(gained, gain, _beside_varying(decision, held_out, options))
        before, after = (tuple(getattr(pair, name) for pair in pairs) for name in ("before", "after"))
        return Assessment(
            baseline, extended, effects, channels, comparisons, before, after, worth, decision.whole, decision.laws
        )  # fmt: skip

    def held_out(self, assessed: Assessment) -> list[tuple[Robot, list[PredictedRecording]]]:
        """An assessment's models, and their predictions of the held-out recordings."""
        models = ((assessed.baseline, assessed.neutral), (assessed.extended, assessed.predicted))
        return [(robot, list(runs[len(self._fitted) :])) for robot, runs in models]


def _beside_varying(decision: Decision, pairs: Sequence[Pair], options: Options) -> tuple[float, float] | None:
    """What effects say more of held-out windows than varying ground does; None where forces are measured, or none is.

    Forces tell varying ground from effects by themselves.
    """
    if not (decision.fitted and pairs) or shows_forces(decision):
        return None
    without = decision.neutral_problem, decision.neutral_fit, [pair.before for pair in pairs]
    with_them = decision.problem, decision.fit, [pair.after for pair in pairs]
    return beside_varying_ground(without, with_them, options.seed, options.false_alarm_rate)


def result_of(
    robot: Robot,
    fitted: Sequence[Experiment],
    held: Sequence[Experiment],
    found: Conclusion,
    assessed: Assessment,
    options: Options,
    view: CommandView,
) -> Diagnosis:
    """The diagnosis that a conclusion comes to."""
    decision, channels = found.decision, assessed.channels
    return Diagnosis(
        verdict=decision.verdict,
        robot=robot,
        baseline_robot=assessed.baseline,
        extended=assessed.extended,
        bags=tuple(e.name for e in fitted),
        holdout=tuple(e.name for e in held),
        horizon=float(options.horizon),
        baseline=channels,
        where=places(assessed.comparisons, channels),
        causes=_causes(decision, assessed.effects, assessed.worth.gained),
        ranking=ranking(decision, options.thresholds),
        unexplained=_unexplained(decision, assessed),
        gain=assessed.worth.gain,
        next_experiment=_next(decision, channels),
        warnings=(
            *_untried(decision),
            *map(_withdrawn, found.without),
            *_contradiction(decision),
            *_besides(found),
            *([] if view.plausible else [view.why]),
            *data_warnings(fitted, robot, held, ()),
            *excitation(decision.neutral_problem, decision.neutral_fit.point),
        ),
        comparisons=tuple(assessed.comparisons),
        prior_odds=float(options.prior_odds),
        false_alarm_rate=float(options.false_alarm_rate),
        threshold=decision.least,
        seed=options.seed,
        left=decision.left,
    )


def with_explainable(result: Diagnosis, assessed: Assessment, options: Options) -> Diagnosis:
    """Add to a result how much is explainable at all, and what was learned where `residual` asks for it."""
    noise = {name: one.noise for name, one in assessed.channels.items()}
    try:
        with until(time.perf_counter() + options.left):
            found, some = explainable(assessed.predicted, assessed.extended, noise, result.seed)
    except TimeIsUp:
        return _without(result, "how much any model could explain")
    model = None
    if options.residual and any(one.better for one in found.values()):
        model = model_of(some, assessed.predicted, assessed.extended, result.horizon, result.seed)
    return replace(result, explainable=found, residual=model)


def with_sensors(result: Diagnosis, timed: Sequence[Aligned]) -> Diagnosis:
    """Add to the robots of a result by how much streams were stamped late in the fitted recordings."""

    def with_their_faults(robot: Robot) -> Robot:
        return with_faults(robot, timed, "diagnosed")

    predictors = [
        one if one.robot is None else replace(one, robot=with_their_faults(one.robot)) for one in result.predictors
    ]
    baseline, extended = with_their_faults(result.baseline_robot), with_their_faults(result.extended)
    return replace(result, baseline_robot=baseline, extended=extended, predictors=tuple(predictors))


def with_budget(result: Diagnosis, decision: Decision, assessed: Assessment, options: Options) -> Diagnosis:
    """Add to a result which part of the error on held-out recordings is what, and what varies."""
    held = [one for one in assessed.predicted if one.experiment.name in result.holdout]
    try:
        with until(time.perf_counter() + options.left):
            budget, varies = error_budget(*assessed.whole, held, result.gain, result.explainable, result.seed)
    except TimeIsUp:
        return _without(result, "which part of the error is what")
    return replace(result, error_budget=budget, varies=varies)


def _untried(decision: Decision) -> list[str]:
    """What there was no time for."""
    return [_not_tried(decision.untried)] if decision.untried else []


_NOT_TRIED = "not tried in the time given: "
"""How the warning begins that lists what there was no time for."""


def _not_tried(what: Sequence[str]) -> str:
    return f"{_NOT_TRIED}{'; '.join(what)}"


def _withdrawn(without: Without) -> str:
    """Why what explains the fitted recordings best is not named."""
    if without.reason is Reason.DOUBT:
        return doubt(without.effects, far_beyond_noise(without.left) or beyond_noise(without.left))
    if without.beside is not None:
        worth = without.beside.worth
        grown = worth.after / worth.before - 1.0 if worth.before > 0.0 else np.nan
        return refuted_beside(without.effects[0], without.beside.effects, grown)
    return (refutation if without.reason is Reason.REFUTED else shortfall)(without.effects, without.gain)


def _robots(
    names: Sequence[str], decision: Decision, seed: int, tick: Callable[[], None]
) -> tuple[Robot, Robot, Parameters]:
    """The paper's model and the extended one, and the parameters of the named effects and of laws.

    What commands say weighs with fits.
    """
    fits = [(decision.neutral_problem, decision.neutral_fit), decision.whole]
    extends = bool(decision.named) or decision.laws is not None
    around = surroundings(fits, tick, decision.others) if extends else surroundings(fits[:1], tick)
    neutral = judged(*fits[0], around[0])
    baseline = robot_of(decision.neutral_problem, neutral, {}, names)
    if not extends:
        return baseline, baseline, {}
    from_commands = {effect: other.found for effect, other in decision.other.items()}
    after = judged(*fits[1], around[1], from_commands)
    effects = dict(_parameters(decision, after, seed))
    return baseline, robot_of(fits[1][0], after, effects, names), effects


def _predictions(
    fitted: Sequence[Experiment],
    held: Sequence[Experiment],
    baseline: Robot,
    extended: Robot,
    options: Options,
    tick: Callable[[], None],
) -> list[Pair]:
    """All recordings by both models."""
    return side_by_side(
        lambda one: predict(*one, baseline, extended, options.horizon, options.workers),
        [*((e, False) for e in fitted), *((e, True) for e in held)], options.workers, tick,
    )  # fmt: skip


def _parameters(decision: Decision, after: Uncertain, seed: int) -> dict[str, Mapping[str, Estimate]]:
    """Parameters of all named effects, and of laws, with their intervals."""
    problem, fit = decision.whole
    found: dict[str, Mapping[str, Estimate]] = {}
    for which, part in enumerate(problem.parameters.places):
        extension = problem.parameters.extensions[which]
        where = disc_place(problem, fit, which, seed)
        found[extension.id] = found_parameters(extension, after.coordinates[part], after.covariance[part, part], where)
    return found | {named.effect: named.found for named in decision.named if named.found}


def _unexplained(decision: Decision, assessed: Assessment) -> Unexplained | None:
    """What is on no list, in words, and as terms of the model where it could be fitted."""
    if decision.several_soils is not None:
        return decision.several_soils.unexplained
    if decision.unexplained is None:
        return None
    said = unexplained_of(decision.unexplained)
    if assessed.laws is None:
        return said
    nats, spans = assessed.laws.nats, assessed.laws.spans
    laws = {name: assessed.effects[name] for name in spans}
    return replace(said, laws=laws, log10_bayes_factor=nats / DECADE, spans=spans)


def _contradiction(decision: Decision) -> list[str]:
    """That the recordings contradict each other, where the answer itself does not say so."""
    alone = decision.by_recording
    if alone is None:
        return []
    if decision.verdict is not Verdict.UNEXPLAINED:
        own = f"; by themselves they ask for {alone.size_words}" if alone.sizes else ""
        return [f"{differing(alone.words)}; one soil was fitted to all of them, so sizes are a compromise{own}"]
    return partly(alone.names, alone.unexplained_alone)


def _besides(found: Conclusion) -> list[str]:
    """That more is left than noise with all that is named, where several soils are no reason for it."""
    decision, channels = found.decision, beyond_noise(found.decision.left)
    if decision.by_recording is not None:
        channels = tuple(name for name in channels if name == COMMANDED)
    if decision.verdict is Verdict.UNEXPLAINED or not (decision.named and channels):
        return []
    return [besides([one.effect for one in decision.ordered], channels, shows_forces(decision))]


def _next(decision: Decision, channels: Mapping[str, ChannelBaseline]) -> NextExperiment | None:
    """What would tell the first cause that ties from those that tie with it, or what a force on no list is."""
    noise = {name: one.noise / (2.0**0.5 if name == "position" else 1.0) for name, one in channels.items()}
    if decision.verdict is Verdict.UNEXPLAINED:
        problem, force = decision.neutral_problem, decision.unexplained
        if decision.several_soils is not None:
            return one_by_one(decision.several_soils.names)
        advice = None if force is None else next_for_force(problem, force, noise)
        return advice or repeated(missing(problem.stretches, problem.parameters.robot))
    first = next((one for one in decision.ordered if one.ties), None)
    if first is None:
        return None
    at = decision.stage_of(first.effect)  # neither has what was found later, which would tell them apart
    fitted = {rival.id: rival for rival in at.rivals}
    robots = {}
    for effect in (first.effect, *first.ties):
        if effect in fitted:
            rival = fitted[effect]
            robots[effect] = rival.problem.parameters.robot_at(rival.fit.point.coordinates)
        elif effect in decision.other:
            values = {name: found.value for name, found in decision.other[effect].found.items()}
            without = at.problem.parameters.robot_at(at.fit.point.coordinates)
            robots[effect] = replace(without, effects=dict(without.effects) | {effect: values})
    return next_experiment(robots, noise)


def _causes(decision: Decision, effects: Parameters, gained: Mapping[str, Worth]) -> tuple[Cause, ...]:
    """The named effects, most probable first."""
    found = []
    for named in decision.ordered:
        worth = gained[named.effect]
        evidence = named.nats / DECADE, worth.share, named.ties, worth.nats / DECADE
        found.append(Cause(named.effect, effects[named.effect], *evidence))
    return tuple(found)


# ----------------------------------------------------------------------
# `diagnose`: from recordings and a robot to a :class:`Diagnosis`.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

_FEWEST = 12
"""Positions of a recording, without which its last third is too little to be held out."""
ENOUGH, ENOUGH_APART = 240.0, 90.0
"""s of windows that are searched, about: of recordings in one map, and of others. All count for what is held out, for
evidence that is too little in the searched ones, and for the sizes of what is named."""
LEAST = 45.0
"""s of windows that are searched whatever the time, about: fewer (8 windows of 2 s of a Husky) showed forces on no list
where all of them name a lever arm."""
SEARCH, END = 10_000, 600
"""Predictions of every searched window that the baseline and one search for an effect take, and of every window that
intervals and predictions take after that, about: 6000 to 10 000 (Husky, 2 s; Agri.q, 5 s), and 400 to 600."""
COMMANDS = 5.0
"""Times that the first command view takes, in which it is asked for evidence and others are made, about (Husky)."""
_PILOT = 3
"""Predictions by which their time is measured."""


def diagnose(
    recordings: Sequence[Experiment],
    robot: Robot,
    *,
    holdout: Sequence[Experiment] = (),
    options: Options | None = None,
    progress: StageReport | None = None,
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
    options : Options, optional
        Horizon, seed, thresholds, time and the like.
    progress : callable
        Called with the share that is done, as far as it is known, and with what is being done.

    Raises
    ------
    ArtibotError
        For recordings that lack what is needed.
    """
    ticks, options = Timetable(progress), options or Options()
    parts, seed = options.parts, options.seed
    _check([*recordings, *holdout], robot, options)
    named = distinctly_named(recordings, holdout)
    timed, later = (on_one_clock(some, robot, seed, poses="pose_delay" in robot.effects or None) for some in named)
    fitted, held = split([one.experiment for one in timed], [one.experiment for one in later], robot)
    begun = parts.elapsed
    ticks.begin(Task.COMMANDS)
    view = command_view(fitted, robot, needed=options.least)
    view_took = parts.elapsed - begun
    every = every_window(fitted, robot, options)
    parts.begin(_key(fitted, held, robot, options), every.problem.stretches)
    usual = len(every.rows)
    every, options = affordable(every, options, view_took)
    ticks.begin(Task.SOIL)
    problem, fit = parts.once(
        "soil identified", lambda: best_fit(every.problem.part(every.rows), Effort(), ticks, TRUST)
    )
    naming = Naming(problem, fit, options, ticks, view, every if every.times > 1.0 else None)
    decision = naming.decide()
    assessor = Assessor(robot, fitted, held, options, ticks, view)
    latest = time.perf_counter() + options.for_search
    found = concluded(decision, view, assessor.worth, ticks, latest, naming.without)
    assessed = assessor(found.decision)
    result = result_of(robot, fitted, held, found, assessed, options, view)
    known = assessor.held_out(assessed)
    ticks.begin(Task.MODELS)
    result = _with_predictors(result, held, _models(robot, result, decision), decision, known, options)
    ticks.begin(Task.EXPLAINABLE)
    result = with_explainable(result, assessed, options)
    ticks.begin(Task.ERRORS)
    result = with_budget(result, found.decision, assessed, options)
    fewer = _fewer(len(every.rows), usual)
    result = replace(
        with_sensors(result, timed), findings=what_is_wrong(timed, later), streams=stream_table([*timed, *later]),
        search=fit.report, warnings=(*fewer, *result.warnings),
    )  # fmt: skip
    ticks.done()
    return replace(result, seconds=parts.elapsed)


def _key(fitted: Sequence[Experiment], held: Sequence[Experiment], robot: Robot, options: Options) -> str:
    """A text that is the same where version, recordings, robot and options are: then parts made earlier hold."""
    digest = hashlib.blake2b(digest_size=16)
    stated = (options.horizon, options.seed, options.prior_odds, options.false_alarm_rate, options.thresholds)
    for word in (identity(), robot, sorted(EFFECTS), stated, options.budget):
        digest.update(repr(word).encode())
    for experiment in (*fitted, None, *held):
        if experiment is None:
            digest.update(b"held out")
            continue
        digest.update(repr((experiment.name, str(experiment.path), experiment.segments)).encode())
        for name, channel in sorted(experiment.channels.items()):
            digest.update(name.encode())
            for values in (channel.t_ns, *(channel[column] for column in sorted(channel.columns))):
                digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def affordable(every: EveryWindow, options: Options, view_took: float) -> tuple[EveryWindow, Options]:
    """As many searched windows as there is time for, and what has to be left of it in the end.

    Parameters
    ----------
    view_took : float
        s of the command view, which judges the held-out recordings, and all of them, again.
    """
    if not np.isfinite(options.budget):
        return every, options

    def searched() -> tuple[int, float]:
        problem, total = every.problem, float(every.problem.durations.sum())
        robots, which = [problem.parameters.robot], np.zeros((1, len(problem)), np.int64)
        for _ in range(1 + _PILOT):  # the first one compiles
            begun = options.parts.elapsed
            problem.predictions(robots, which, problem.starts[None])
            took = options.parts.elapsed - begun
        reserve = COMMANDS * view_took + END * took
        seconds = max(0.0, options.left - reserve) / (SEARCH * took) * total
        step = max(round(every.times), round(total / max(seconds, 1e-3)))
        return max(1, min(step, int(total / LEAST))), reserve

    step, reserve = options.parts.once("windows that there is time for", searched)
    return replace(every, rows=range(0, len(every.problem), step)), replace(options, reserve=reserve)


def _with_predictors(
    result: Diagnosis, held: Sequence[Experiment], models: Mapping[str, Robot], decision: Decision,
    known: Sequence[tuple[Robot, Sequence[PredictedRecording]]], options: Options,
) -> Diagnosis:  # fmt: skip
    """Add how well the models predict held-out recordings, if there is time."""
    try:
        with until(time.perf_counter() + options.left):
            seen = predictors(held, models, decision.neutral_problem, options.horizon, options.workers, known)
    except TimeIsUp:
        return _without(result, "held-out errors of the models side by side")
    best = best_of(seen)
    commanded = {one.effect for one in decision.named if one.found}
    result = replace(result, predictors=seen, best=best.name if best is not None else "")
    return with_refusals(result, models, commanded)


def _fewer(searched: int, usual: int) -> list[str]:
    """That fewer windows were searched than would have been, if so."""
    return [f"only {searched} windows of {usual} were searched in the time given"] if searched < usual else []


def _without(result: Diagnosis, what: str) -> Diagnosis:
    """The result with one more thing that there was no time for, in the one warning that lists them all."""
    if result.warnings and result.warnings[0].startswith(_NOT_TRIED):
        return replace(result, warnings=(f"{result.warnings[0]}; {what}", *result.warnings[1:]))
    return replace(result, warnings=(_not_tried([what]), *result.warnings))


def _check(recordings: Sequence[Experiment], robot: Robot, options: Options) -> None:
    if not options.budget > 0.0:
        raise ArtibotError(f"budget: {options.budget} s; expected more than 0 s")
    if options.residual and not can_grow():
        raise ArtibotError(f"residual: {MISSING}, or do without")
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


def distinctly_named(
    recordings: Sequence[Experiment], holdout: Sequence[Experiment]
) -> tuple[list[Experiment], list[Experiment]]:
    """Recordings under names of their own: `monday/run0` and `tuesday/run0` are both `run0` in their bags."""
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
    for name, a, b in (("", begin, border), (LAST_THIRD, border, end)):
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
    every = every_window(fitted, robot, options)
    return best_fit(every.problem.part(every.rows), Effort(), tick, TRUST)


def every_window(fitted: Sequence[Experiment], robot: Robot, options: Options) -> EveryWindow:
    """All windows of recordings, and those in turn that are searched where all are more than that takes.

    What is bound to a place may be met in few windows of a recording; without a common map there is no such thing.
    """
    problem = problem_of(fitted, parameter_set(robot, SOIL), options.horizon, options.workers, HALF_WIDTH, options.seed)
    enough = ENOUGH if in_common_map(fitted) else ENOUGH_APART
    step = max(1, round(float(problem.durations.sum()) / enough))
    return EveryWindow(problem, range(0, len(problem), step))
