"""`diagnose`: from recordings and a robot to a :class:`Diagnosis`, stage by stage."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from artibot_sim.cluster import identity
from artibot_sim.diagnose.assessment import Assessment, Assessor, Parameters
from artibot_sim.diagnose.commands.view import CommandView, command_view
from artibot_sim.diagnose.conclusion import AboutMotion, Conclusion, Withdrawal, concluded
from artibot_sim.diagnose.extended import with_effects_of
from artibot_sim.diagnose.holdout import distinctly_named, split
from artibot_sim.diagnose.next_experiment.choice import next_experiment, next_for_force, one_by_one, repeated
from artibot_sim.diagnose.records import (
    BASELINE,
    DECADE,
    EXTENDED,
    GIVEN,
    UNNAMED,
    Cause,
    ChannelBaseline,
    NextExperiment,
    Options,
    Unexplained,
)
from artibot_sim.diagnose.remains import (
    COMMANDED,
    beyond_noise,
    far_beyond_noise,
    leaves_more_than_noise,
    remains,
    shows_forces,
)
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.selection.decision import Decision
from artibot_sim.diagnose.selection.every_window import EveryWindow, affordable, every_window
from artibot_sim.diagnose.selection.ranking import ranking
from artibot_sim.diagnose.selection.stepwise import StepwiseSelection
from artibot_sim.diagnose.timetable import StageReport, Task, TimeLimit, Timetable
from artibot_sim.diagnose.unlisted.finding import unexplained_of
from artibot_sim.diagnose.unlisted.fitting import law_of
from artibot_sim.diagnose.validation.error_budget import error_budget
from artibot_sim.diagnose.validation.explainable import FEWEST, explainable, model_of
from artibot_sim.diagnose.validation.predictions import Worth
from artibot_sim.diagnose.validation.predictors import best_of, predictors, refusals
from artibot_sim.diagnose.validation.residuals import places
from artibot_sim.diagnose.verdict import Reason, Verdict
from artibot_sim.diagnose.words import besides, differing, doubt, partly, refutation, refuted_beside, shortfall
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.alignment import Aligned, on_one_clock, stream_table, what_is_wrong, with_faults
from artibot_sim.estimation.boosting import MISSING, can_grow
from artibot_sim.estimation.checks.recordings import data_warnings, require_usable
from artibot_sim.estimation.measurements import missing
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.experiment import Experiment
from artibot_sim.identify.judgement import excitation
from artibot_sim.identify.validation import PredictedRecording
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.progress import told_of_compiling

# ----------------------------------------------------------------------
# The stages, in their order.
# ----------------------------------------------------------------------


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
        Called with the share that is done, as far as it is known, with what is being done, and with the time left.

    Raises
    ------
    ArtibotError
        For recordings that lack what is needed.
    """
    ticks = Timetable(progress)
    with told_of_compiling(ticks.compiling):
        return _diagnosed(recordings, robot, holdout, options or Options(), ticks)


def _diagnosed(
    recordings: Sequence[Experiment], robot: Robot, holdout: Sequence[Experiment], options: Options, ticks: Timetable
) -> Diagnosis:
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
    problem, fit = parts.once("soil identified", lambda: every.soil(ticks))
    predicted = sum(int(one.duration / options.horizon) for one in (*fitted, *held))
    ticks.leave_out(*_nothing_to_do(every, problem, fit, predicted))
    assessor = Assessor(robot, fitted, held, options, ticks, view)
    about = AboutMotion(assessor.worth, ticks, time.perf_counter() + options.for_search)
    selection = StepwiseSelection(
        problem, fit, options, ticks, view, every if every.times > 1.0 else None,
        lambda some: about(some).laws_explain(),
    )  # fmt: skip
    decision = selection.decide()
    found = concluded(decision, view, assessor.worth, about, selection.without)
    assessed = assessor(found.decision)
    result = result_of(robot, fitted, held, found, assessed, options, view)
    given = TimeLimit(lambda: options.left, found.decision.untried)
    ticks.begin(Task.MODELS)
    models, known = _models(robot, result, decision), assessor.held_out(assessed)
    result = _with_predictors(result, held, models, decision, known, options, given)
    ticks.begin(Task.EXPLAINABLE)
    result = _with_explainable(result, assessed, options, given)
    ticks.begin(Task.ERRORS)
    result = _with_budget(result, assessed, given)
    result = replace(
        _with_sensors(result, timed), findings=what_is_wrong(timed, later), streams=stream_table([*timed, *later]),
        search=fit.report, warnings=(*_fewer(len(every.rows), usual), *_untried(given), *result.warnings),
    )  # fmt: skip
    ticks.done()
    return replace(result, seconds=parts.elapsed)


def _nothing_to_do(every: EveryWindow, problem: Problem, fit: Fit, predicted: int) -> Iterator[Task]:
    """Stages of which it is known beforehand that there are none, with so many windows to be `predicted`."""
    if every.times <= 1.0:
        yield Task.WINDOWS
    if not leaves_more_than_noise(remains(problem, fit.point)):
        yield Task.FORCES
    if predicted < FEWEST or not can_grow():
        yield Task.EXPLAINABLE


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


# ----------------------------------------------------------------------
# What a diagnosis says of a decision: causes, what is left, what to measure next, warnings.
# ----------------------------------------------------------------------


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
        holdout_likelier=_decades(assessed.worth.likelier),
        next_experiment=_next(decision, channels),
        warnings=(
            *map(_withdrawn, found.withdrawn),
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


def _decades(nats: tuple[float, float] | None) -> tuple[float, float] | None:
    return None if nats is None else (nats[0] / DECADE, nats[1] / DECADE)


def _causes(decision: Decision, effects: Parameters, gained: Mapping[str, Worth]) -> tuple[Cause, ...]:
    """The named effects, most probable first."""
    found = []
    for named in decision.ordered:
        worth = gained[named.effect]
        evidence = named.nats / DECADE, worth.share, named.ties, worth.nats / DECADE
        found.append(Cause(named.effect, effects[named.effect], *evidence))
    return tuple(found)


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
    first = decision.unexplained.chosen[0]
    if law_of(first, len(decision.problem.parameters.robot.modules)) is not None:  # as it is in the model
        law, form = laws[next(iter(spans))], first.form
        fitted = law["offset" if form.edge is not None else "times_scale" if form.times else "scale"]
        size = float(f"{law['size'].value:.3g}")
        said = unexplained_of(decision.unexplained.as_large(size))
        said = replace(said, size=size, form=form.name_at(float(fitted.value)))
    residuals = {name: tuple(map(tuple, rows.tolist())) for name, rows in assessed.laws.residuals.items()}
    return replace(said, laws=laws, log10_bayes_factor=nats / DECADE, spans=spans, residuals=residuals)


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


def _withdrawn(one: Withdrawal) -> str:
    """Why what explains the fitted recordings best is not named."""
    if one.reason is Reason.DOUBT:
        return doubt(one.effects, far_beyond_noise(one.left) or beyond_noise(one.left))
    if one.beside is not None:
        worth = one.beside.worth
        grown = worth.after / worth.before - 1.0 if worth.before > 0.0 else np.nan
        return refuted_beside(one.effects[0], one.beside.effects, grown)
    return (refutation if one.reason is Reason.REFUTED else shortfall)(one.effects, one.gain)


def _contradiction(decision: Decision) -> list[str]:
    """That the recordings contradict each other, where the answer itself does not say so."""
    alone = decision.by_recording
    if alone is None:
        return []
    if decision.verdict is not Verdict.UNEXPLAINED:
        said = f"{differing(alone.words)}; one soil was fitted to all of them"
        if not alone.sizes:
            return [said]
        means = "the means of" if alone.sufficient else "a compromise between"
        return [f"{said}, and sizes are {means} what they ask for by themselves: {alone.size_words}"]
    return partly(alone.names, alone.unexplained_alone)


def _besides(found: Conclusion) -> list[str]:
    """That more is left than noise with all that is named, where several soils are no reason for it."""
    decision, channels = found.decision, beyond_noise(found.decision.left)
    if decision.by_recording is not None:
        channels = tuple(name for name in channels if name == COMMANDED)
    if decision.verdict is Verdict.UNEXPLAINED or not (decision.named and channels):
        return []
    return [besides([one.effect for one in decision.ordered], channels, shows_forces(decision.problem))]


def _fewer(searched: int, usual: int) -> list[str]:
    """That fewer windows were searched than would have been, if so."""
    return [f"only {searched} windows of {usual} were searched in the time given"] if searched < usual else []


# ----------------------------------------------------------------------
# What is added to it: models side by side, sensors, where errors come from; as far as there is time.
# ----------------------------------------------------------------------


def _untried(given: TimeLimit) -> list[str]:
    """What was not tried, in one line, if there is any of it."""
    return [f"not tried in the time given: {'; '.join(given.untried)}"] if given.untried else []


def _models(robot: Robot, result: Diagnosis, found: Decision) -> dict[str, Robot]:
    """The models that may predict best, the simplest first; the last one has all that fitted best, named or not."""
    models = {GIVEN: robot, BASELINE: result.baseline_robot, EXTENDED: result.extended}
    if not found.named or len(found.named) == len(result.causes):
        return models
    unnamed = found.problem.parameters.robot_at(found.fit.point.coordinates)
    stated = {one.effect: {name: value.value for name, value in one.found.items()} for one in found.named if one.found}
    return models | {UNNAMED: replace(unnamed, effects={**unnamed.effects, **stated})}


def _with_predictors(
    result: Diagnosis, held: Sequence[Experiment], models: Mapping[str, Robot], decision: Decision,
    known: Sequence[tuple[Robot, Sequence[PredictedRecording]]], options: Options, given: TimeLimit,
) -> Diagnosis:  # fmt: skip
    """Add how well the models predict held-out recordings, if there is time."""
    found = given.within(
        "held-out errors of the models side by side",
        lambda: predictors(held, models, decision.neutral_problem, options.horizon, options.workers, known),
    )
    if found is None:
        return result
    best = best_of(found)
    commanded = {one.effect for one in decision.named if one.found}
    result = replace(result, predictors=found, best=best.name if best is not None else "")
    return with_refusals(result, models, commanded)


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


def _with_explainable(result: Diagnosis, assessed: Assessment, options: Options, given: TimeLimit) -> Diagnosis:
    """Add how much is explainable at all, if there is time, and what was learned where `residual` asks for it."""
    noise = {name: one.noise for name, one in assessed.channels.items()}
    learned = given.within(
        "how much any model could explain",
        lambda: explainable(assessed.extended_predictions, assessed.extended, noise, result.seed),
    )
    if learned is None:
        return result
    (found, some), model = learned, None
    if options.residual and any(one.better for one in found.values()):
        model = model_of(some, assessed.extended_predictions, assessed.extended, result.horizon, result.seed)
    return replace(result, explainable=found, residual=model)


def _with_sensors(result: Diagnosis, timed: Sequence[Aligned]) -> Diagnosis:
    """Add to the robots of a result by how much streams were stamped late in the fitted recordings."""

    def with_their_faults(robot: Robot) -> Robot:
        return with_faults(robot, timed, "diagnosed")

    predictors = [
        one if one.robot is None else replace(one, robot=with_their_faults(one.robot)) for one in result.predictors
    ]
    baseline, extended = with_their_faults(result.baseline_robot), with_their_faults(result.extended)
    return replace(result, baseline_robot=baseline, extended=extended, predictors=tuple(predictors))


def _with_budget(result: Diagnosis, assessed: Assessment, given: TimeLimit) -> Diagnosis:
    """Add which part of the error on held-out recordings is what, and what varies, if there is time."""
    held = [one for one in assessed.extended_predictions if one.experiment.name in result.holdout]
    found = given.within(
        "which part of the error is what",
        lambda: error_budget(*assessed.whole, held, result.gain, result.explainable, result.seed),
    )
    return result if found is None else replace(result, error_budget=found[0], varies=found[1])
