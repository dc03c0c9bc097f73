"""What a decision comes to: its models with intervals, their predictions of all recordings, and their worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from artibot_sim.diagnose.candidates.patches import disc_place
from artibot_sim.diagnose.commands.view import CommandView, view_with
from artibot_sim.diagnose.conclusion import HeldOut
from artibot_sim.diagnose.extended import found_parameters, robot_of
from artibot_sim.diagnose.intervals import Uncertain, judged
from artibot_sim.diagnose.records import ChannelBaseline, Comparison, EffectEstimate, Options
from artibot_sim.diagnose.remains import COMMANDED, remains, shows_forces
from artibot_sim.diagnose.selection.decision import Decision
from artibot_sim.diagnose.timetable import Task, Timetable
from artibot_sim.diagnose.unlisted.fitting import FittedLaws
from artibot_sim.diagnose.validation.predictions import (
    PredictionPair,
    baseline_levels,
    gains,
    improvements,
    is_minor,
    likelihood_interval,
    predict,
)
from artibot_sim.diagnose.validation.series import comparison, with_commands
from artibot_sim.diagnose.validation.varying_ground import beside_varying_ground
from artibot_sim.estimation.checks.common_map import in_common_map
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.surroundings import surroundings
from artibot_sim.experiment import Experiment
from artibot_sim.identify.validation import PredictedRecording
from artibot_sim.model import Robot

Parameters = Mapping[str, Mapping[str, EffectEstimate]]


@dataclass(frozen=True)
class Assessment:
    """A decision's models, and their predictions of all recordings.

    Attributes
    ----------
    baseline, extended : Robot
        The paper's model with its soil identified, and with all that is named.
    effects : mapping of str to mapping of str to EffectEstimate
        The named effects' parameters.
    channels : mapping of str to ChannelBaseline
    comparisons : list of Comparison
        What pictures are drawn from.
    baseline_predictions : tuple of PredictedRecording
        All recordings by the paper's model.
    extended_predictions : tuple of PredictedRecording
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
    baseline_predictions: tuple[PredictedRecording, ...]
    extended_predictions: tuple[PredictedRecording, ...]
    worth: HeldOut
    whole: tuple[Problem, Fit]
    laws: FittedLaws | None = None


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
        found, laws = self._predicted(decision), decision.laws
        if decision.fitted or laws is None:  # beside effects, tables decide about laws
            return found
        if found.worth.laws_hold and not is_minor(found.worth.gained, remains(laws.problem, laws.fit.point)):
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
        beside_varying = _beside_varying(decision, held_out, options)
        worth = HeldOut(gained, gain, beside_varying, likelihood_interval(held_out, gained, options.seed))
        before, after = (tuple(getattr(pair, name) for pair in pairs) for name in ("before", "after"))
        return Assessment(
            baseline, extended, effects, channels, comparisons, before, after, worth, decision.whole, decision.laws
        )  # fmt: skip

    def held_out(self, assessed: Assessment) -> list[tuple[Robot, list[PredictedRecording]]]:
        """An assessment's models, and their predictions of the held-out recordings."""
        models = (
            (assessed.baseline, assessed.baseline_predictions),
            (assessed.extended, assessed.extended_predictions),
        )
        return [(robot, list(runs[len(self._fitted) :])) for robot, runs in models]


def _robots(
    names: Sequence[str], decision: Decision, seed: int, tick: Callable[[], None]
) -> tuple[Robot, Robot, Parameters]:
    """The paper's model and the extended one, and the parameters of the named effects and of laws.

    What commands say weighs with fits.
    """
    fits = [decision.fits[0], decision.whole]
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
) -> list[PredictionPair]:
    """All recordings by both models."""
    return side_by_side(
        lambda one: predict(*one, baseline, extended, options.horizon, options.workers),
        [*((e, False) for e in fitted), *((e, True) for e in held)], options.workers, tick,
    )  # fmt: skip


def _parameters(decision: Decision, after: Uncertain, seed: int) -> dict[str, Mapping[str, EffectEstimate]]:
    """Parameters of all named effects, and of laws, with their intervals.

    Where recordings have soils of their own beside effects, one soil for all would bend these: then each is the mean of
    what recordings by themselves ask for.
    """
    (problem, fit), alone = decision.whole, decision.by_recording
    found: dict[str, Mapping[str, EffectEstimate]] = {}
    for which, part in enumerate(problem.parameters.places):
        extension = problem.parameters.extensions[which]
        where = disc_place(problem, fit, which, seed)
        own = after.coordinates[part], after.covariance[part, part]
        if alone is not None and alone.sufficient and extension.id in alone.effects:
            own = alone.mean(extension.id)
        found[extension.id] = found_parameters(extension, *own, where)
    return found | {named.effect: named.found for named in decision.named if named.found}


def _beside_varying(
    decision: Decision, pairs: Sequence[PredictionPair], options: Options
) -> tuple[float, float] | None:
    """What effects say more of held-out windows than varying ground does; None where forces are measured, or none is.

    Forces tell varying ground from effects by themselves.
    """
    if not (decision.fitted and pairs) or shows_forces(decision.problem):
        return None
    without = decision.neutral_problem, decision.neutral_fit, [pair.before for pair in pairs]
    with_them = decision.problem, decision.fit, [pair.after for pair in pairs]
    return beside_varying_ground(without, with_them, options.seed, options.false_alarm_rate)
