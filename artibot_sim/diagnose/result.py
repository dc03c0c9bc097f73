"""A decision as a :class:`Diagnosis`: intervals, what it is worth on held-out data, pictures and warnings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from artibot_sim.diagnose.command_view.view import command_view
from artibot_sim.diagnose.conclusion import doubted, is_doubtful, refuted
from artibot_sim.diagnose.data_check.check import data_warnings
from artibot_sim.diagnose.decision import Decision
from artibot_sim.diagnose.diagnosis import (
    Cause,
    ChannelBaseline,
    Diagnosis,
    Found,
    NextExperiment,
    Unexplained,
    Verdict,
)
from artibot_sim.diagnose.disc_place import disc_place
from artibot_sim.diagnose.evidence import DECADE
from artibot_sim.diagnose.extended import found_parameters, robot_of
from artibot_sim.diagnose.looks import COMMANDED, look, with_commands
from artibot_sim.diagnose.next_experiment.force import next_for_force
from artibot_sim.diagnose.next_experiment.repeat import one_by_one, repeated
from artibot_sim.diagnose.next_experiment.ties import next_experiment
from artibot_sim.diagnose.options import Options
from artibot_sim.diagnose.places import places
from artibot_sim.diagnose.predictions import Pair, baseline_levels, gains, predict
from artibot_sim.diagnose.ranking import ranking
from artibot_sim.diagnose.remains import beyond_noise, far_beyond_noise
from artibot_sim.diagnose.uncertain import Uncertain, judged, surroundings
from artibot_sim.diagnose.unexplained.finding import unexplained_of
from artibot_sim.diagnose.words import differing
from artibot_sim.diagnose.words_of_doubt import besides, doubt, partly, refutation, shortfall
from artibot_sim.diagnose.worth import Worth, improvements, is_minor, is_refuted
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.sensing import missing
from artibot_sim.identify.side_by_side import side_by_side
from artibot_sim.model import Robot

Parameters = Mapping[str, Mapping[str, Found]]


def result_of(
    robot: Robot,
    fitted: Sequence[Experiment],
    held: Sequence[Experiment],
    decision: Decision,
    options: Options,
    tick: Callable[[], None],
) -> Diagnosis:
    """The diagnosis that a decision comes to."""
    baseline, extended, effects = _robots([e.name for e in fitted], decision, options.seed, tick)
    pairs = _predictions(fitted, held, baseline, extended, options, tick)
    view = command_view([*fitted, *held], robot, needed=options.least)
    commanded = view.seen_by(extended)
    channels, looks = with_commands(baseline_levels(pairs), [look(pair, robot) for pair in pairs], *commanded)
    held_out = [pair for pair in pairs if pair.held_out]
    driven = [one.channels[COMMANDED] for one in looks if one.held_out and COMMANDED in one.channels]
    driven = driven if view.followed else []
    gained, gain = improvements(decision, held_out, extended, view, options), gains(held_out, driven, options.seed)
    if (refuting := is_refuted(gained, gain)) or (decision.fitted and is_minor(gained, decision.left)):
        found = result_of(robot, fitted, held, refuted(decision), options, tick)
        unnamed = [named.effect for named in decision.fitted or decision.named]
        said = (refutation if refuting else shortfall)(unnamed, gain)
        return replace(found, warnings=(said, *found.warnings))
    if is_doubtful(decision):
        found = result_of(robot, fitted, held, doubted(decision), options, tick)
        said = doubt([named.effect for named in decision.fitted], far_beyond_noise(decision.left))
        return replace(found, warnings=(said, *found.warnings))
    return Diagnosis(
        verdict=decision.verdict,
        robot=robot,
        baseline_robot=baseline,
        extended=extended,
        bags=tuple(e.name for e in fitted),
        holdout=tuple(e.name for e in held),
        horizon=options.horizon,
        baseline=channels,
        where=places(looks, channels),
        causes=_causes(decision, effects, gained),
        ranking=ranking(decision, options.thresholds),
        unexplained=_unexplained(decision),
        gain=gain,
        next_experiment=_next(decision, channels),
        warnings=(
            *_contradiction(decision),
            *_besides(decision),
            *data_warnings(fitted, robot, decision.neutral_problem, decision.neutral_fit.point, held),
        ),
        looks=tuple(looks),
        prior_odds=options.prior_odds,
        false_alarm_rate=options.false_alarm_rate,
        threshold=decision.least,
        seed=options.seed,
        left=decision.left,
    )


def _robots(
    names: Sequence[str], decision: Decision, seed: int, tick: Callable[[], None]
) -> tuple[Robot, Robot, Parameters]:
    """The paper's model and the extended one, and the named effects' parameters; what commands say weighs with fits."""
    fits = [(decision.neutral_problem, decision.neutral_fit), (decision.problem, decision.fit)]
    around = surroundings(fits if decision.named else fits[:1], tick)
    neutral = judged(*fits[0], around[0], seed)
    baseline = robot_of(decision.neutral_problem, neutral, {}, names)
    if not decision.named:
        return baseline, baseline, {}
    heard = {effect: other.found for effect, other in decision.other.items()}
    after = judged(*fits[1], around[1], seed, heard)
    effects = _parameters(decision, after, seed)
    return baseline, robot_of(decision.problem, after, effects, names), effects


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


def _parameters(decision: Decision, after: Uncertain, seed: int) -> dict[str, Mapping[str, Found]]:
    """Parameters of all named effects with their intervals."""
    problem: Problem = decision.problem
    found: dict[str, Mapping[str, Found]] = {}
    for which, part in enumerate(problem.parameters.places):
        extension = problem.parameters.extensions[which]
        where = disc_place(problem, decision.fit, which, seed)
        found[extension.id] = found_parameters(extension, after.coordinates[part], after.covariance[part, part], where)
    return found | {named.effect: named.found for named in decision.named if named.found}


def _unexplained(decision: Decision) -> Unexplained | None:
    """What is on no list, in words."""
    if decision.several_soils is not None:
        return decision.several_soils.unexplained
    return unexplained_of(decision.unexplained) if decision.unexplained else None


def _contradiction(decision: Decision) -> list[str]:
    """That the recordings contradict each other, where the answer itself does not say so."""
    alone = decision.apart
    if alone is None:
        return []
    if decision.verdict is not Verdict.UNEXPLAINED:
        own = f"; by themselves they ask for {alone.size_words}" if alone.sizes else ""
        return [f"{differing(alone.words)}; one soil was fitted to all of them, so sizes are a compromise{own}"]
    return partly(alone.names, alone.unexplained_alone)


def _besides(decision: Decision) -> list[str]:
    """That more is left than noise with all that is named, where several soils are no reason for it."""
    channels = beyond_noise(decision.left)
    if decision.verdict is Verdict.UNEXPLAINED or decision.apart is not None or not (decision.named and channels):
        return []
    return [besides([one.effect for one in decision.ordered], channels)]


def _next(decision: Decision, channels: Mapping[str, ChannelBaseline]) -> NextExperiment | None:
    """What would tell the first cause from those that tie with it, or what a force on no list is."""
    noise = {name: one.noise / (2.0**0.5 if name == "position" else 1.0) for name, one in channels.items()}
    if decision.verdict is Verdict.UNEXPLAINED:
        problem, force = decision.neutral_problem, decision.unexplained
        if decision.several_soils is not None:
            return one_by_one(decision.several_soils.names)
        advice = None if force is None else next_for_force(problem, force, noise)
        return advice or repeated(missing(problem.stretches, problem.parameters.robot))
    if not decision.named or not decision.ordered[0].ties:
        return None
    first = decision.ordered[0]
    at = decision.turn_of(first.effect)  # neither has what was found later, which would tell them apart
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
