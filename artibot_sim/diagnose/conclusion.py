"""Facts about what a search found, each computed when a table asks for it, and the decision that the tables make."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

from artibot_sim.diagnose.commands.model import FILTER
from artibot_sim.diagnose.commands.view import CommandView
from artibot_sim.diagnose.policy import MINOR_COMMANDS, MOST_EFFECTS
from artibot_sim.diagnose.records import ChannelGain, SlowResidual
from artibot_sim.diagnose.remains import (
    COMMANDED,
    beyond_noise,
    far_beyond_noise,
    leaves_more_than_noise,
    remains,
    shows_forces,
)
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.per_recording import ByRecording, fitted_by_recording
from artibot_sim.diagnose.timetable import Timetable
from artibot_sim.diagnose.unlisted.explanations import Explanation, Explanations
from artibot_sim.diagnose.unlisted.finding import ForceFinding
from artibot_sim.diagnose.validation.predictions import LAWS, Worth, is_minor, is_refuted
from artibot_sim.diagnose.validation.stability import disagreement, drifts
from artibot_sim.diagnose.verdict import COMMANDS, MOTION, VERDICT, Outcome, Reason, Row
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.model import Robot


@dataclass(frozen=True)
class HeldOut:
    """What all that is named is worth on held-out recordings.

    Attributes
    ----------
    gained : mapping of str to Worth
        By cause, in the order in which they were found; of laws together under `predictions.LAWS`.
    gain : mapping of str to ChannelGain
        By channel.
    beside_varying : (float, float) or None
        Nats by which held-out windows are likelier with the effects, where the ground may vary in both models: an
        interval outside of which lies the share of false alarms. None where that was not asked.
    likelier : (float, float) or None
        95 % interval of the nats by which held-out recordings are likelier with all that is named.
    """

    gained: Mapping[str, Worth]
    gain: Mapping[str, ChannelGain]
    beside_varying: tuple[float, float] | None = None
    likelier: tuple[float, float] | None = None

    def fact(self, decision: Decision) -> str:
        """As the tables ask for it."""
        if is_refuted(self.gained, self.gain):
            return "worse"
        little = decision.fitted and is_minor(self.gained, decision.left)
        return "little" if little or not self.laws_hold else "better"

    @property
    def laws_hold(self) -> bool:
        """Whether held-out recordings are predicted better with the laws, if there are any, than without."""
        laws = self.gained.get(LAWS)
        return laws is None or laws.after < laws.before

    @property
    def sure(self) -> bool:
        """Whether positions or headings are surely predicted better, neither worse, and not for varying ground."""
        if self.beside_varying is not None and not self.beside_varying[0] > 0.0:
            return False
        intervals = [self.gain[name].ci95 for name in ("position", "yaw") if name in self.gain]
        return any(low > 0.0 for low, _ in intervals) and not any(high < 0.0 for _, high in intervals)


Judge = Callable[[Decision], HeldOut]
"""Predicts held-out recordings with what a decision names."""


GoOn = Callable[[str], Decision]
"""Decides again without an effect that it found last."""


@dataclass(frozen=True)
class LastEffect:
    """An effect beside those found before it.

    Attributes
    ----------
    effects : tuple of str
        Those.
    worth : Worth
        Its own, on held-out recordings.
    """

    effects: tuple[str, ...]
    worth: Worth


@dataclass(frozen=True)
class Withdrawal:
    """Effects that explain the fitted recordings best and are not named.

    Attributes
    ----------
    effects : tuple of str
    reason : Reason
    gain : mapping of str to ChannelGain
        What held-out recordings gain by them, where that is the reason.
    left : mapping of str to SlowResidual
        What they leave of the fitted ones.
    beside : LastEffect or None
        Where only the last of several effects is not named.
    """

    effects: tuple[str, ...]
    reason: Reason
    gain: Mapping[str, ChannelGain]
    left: Mapping[str, SlowResidual]
    beside: LastEffect | None = None


@dataclass(frozen=True)
class Conclusion:
    """What the tables decided.

    Attributes
    ----------
    decision : Decision
        With its verdict, what is named, and what is left with that.
    motion, commands : Row
        The rows that decided about effects fitted to the motion, and about those that only commands show.
    withdrawn : tuple of Withdrawal
        What is not named though it explains the fitted recordings best.
    """

    decision: Decision
    motion: Row[Outcome]
    commands: Row[Outcome]
    withdrawn: tuple[Withdrawal, ...] = ()


_AGAINST = (Reason.REFUTED, Reason.MINOR)
"""Reasons that held-out recordings give."""


def concluded(
    found: Decision,
    view: CommandView,
    judge: Judge,
    about: AboutMotion | None = None,
    go_on: GoOn | None = None,
) -> Conclusion:
    """Decide by the tables what of a search's effects is named.

    Where held-out recordings are against all of them, and the one that was found last makes their predictions worse
    beside the others, it goes, and the table is asked about the others, and about what is found beside these. So does a
    single one that ties with others, which the fitted recordings do not tell from it.

    Parameters
    ----------
    found : Decision
        What the search found; its verdict does not count.
    view : CommandView
        Of the fitted recordings.
    judge : callable
        Says what a decision is worth on held-out recordings.
    about : AboutMotion, optional
        Gives the facts; of the judge's own by default.
    go_on : callable, optional
        Goes on with the search without the effect that it found last.
    """
    about = about or AboutMotion(judge)
    about_motion = about(found)
    motion, last = MOTION.first(about_motion), list[Withdrawal]()
    while motion.reason in _AGAINST and about_motion.last_is_worse and len(last) < MOST_EFFECTS:
        last.append(about_motion.last)
        about_motion = about(about_motion.without_last(go_on))
        motion = MOTION.first(about_motion)
    kept = about_motion.kept(motion.then)
    judged = (lambda _: about_motion.held) if motion.then is Outcome.NAMED and kept.fitted else judge
    about_commands = CommandFacts(kept, view, judged)
    commands = COMMANDS.first(about_commands)
    kept = about_commands.kept(commands.then)
    fallen = [facts.withdrawal(row.reason) for facts, row in _withdrawn(about_motion, motion, about_commands, commands)]
    facts = {
        "encoders": "named" if _recorded(kept) else "nothing",
        "motion": motion.then.name.lower(), "commands": commands.then.name.lower(),
        "tie": "yes" if kept.named and kept.ordered[0].ties else "no",
    }  # fmt: skip
    verdict = VERDICT.first(facts.__getitem__).then
    kept = replace(kept, verdict=verdict, untried=(*kept.untried, *about_motion.untried))
    return Conclusion(kept, motion, commands, (*fallen, *last))


def _withdrawn(
    about_motion: MotionFacts,
    motion: Row[Outcome],
    about_commands: CommandFacts,
    commands: Row[Outcome],
) -> list[tuple[MotionFacts | CommandFacts, Row[Outcome]]]:
    """The facts and rows by which names fell for a reason that is to be said."""
    found: list[tuple[MotionFacts | CommandFacts, Row[Outcome]]] = []
    for facts, row in ((about_motion, motion), (about_commands, commands)):
        if row.reason is not Reason.NO_REASON and row.then is not Outcome.NAMED:
            found.append((facts, row))
    return found


class AboutMotion:
    """Facts about decisions. Those of the last one are kept: a search asks for some before the tables do.

    Parameters
    ----------
    judge : callable
        Says what a decision is worth on held-out recordings.
    ticks : Timetable, optional
        Told of each part of the work.
    latest : float
        Instant of `time.perf_counter` after which no more forces on no list are looked for.
    """

    def __init__(self, judge: Judge, ticks: Timetable | None = None, latest: float = math.inf) -> None:
        self._judge, self._explain = judge, partial(Explanations, ticks=ticks, latest=latest)
        self._last: MotionFacts | None = None

    def __call__(self, found: Decision) -> MotionFacts:
        """The facts about a decision; one of the models of the last has these explained as they are."""
        if self._last is None or self._last.fits is not found.fits:
            self._last = MotionFacts(found, self._judge, self._explain)
        elif not self._last.is_of(found):
            self._last = self._last.about(found)
        return self._last


class MotionFacts:
    """Facts about effects that were fitted to the motion."""

    def __init__(self, found: Decision, judge: Judge, explain: Callable[[Decision], Explanations]) -> None:
        self._found, self._judge, self._explain = found, judge, explain
        self._instead: Explanation | None = None

    @property
    def fits(self) -> tuple[tuple[Problem, Fit], ...]:
        """The decision's models."""
        return self._found.fits

    def is_of(self, found: Decision) -> bool:
        """Whether these are the facts about this very decision."""
        return self._found is found

    def about(self, found: Decision) -> MotionFacts:
        """Facts about another decision of the same models."""
        other = MotionFacts(found, self._judge, self._explain)
        other._instead, other._explanations = self._instead, self._explanations
        return other

    def __call__(self, question: str) -> str:
        """The fact that a question of the table asks for."""
        decision = self._decision
        if question == "several soils":
            return self._soils[0]
        if question == "effects":
            return "yes" if decision.fitted else "no"
        if question == "left":
            return size_of(decision.left)
        if question == "force":
            return "beside" if self._with_laws is not None else "yes" if self._force is not None else "no"
        if question == "held out":
            return self.held.fact(decision)
        if question == "forces":
            return "yes" if shows_forces(decision.problem) else "no"
        if question == "sure":
            return "yes" if self.held.sure else "no"
        assert question == "left without"
        return "more" if self._contradiction is not None else size_of(self._without_left)

    def laws_explain(self) -> bool:
        """Whether laws leave noise alone where effects leave more, in models with no more terms than these have.

        More effects would have to explain as much with more terms. So no more of them are looked for.
        """
        found = self._decision
        if leaves_more_than_noise(found.left) and self._laws_compete:
            self._instead = self._by_laws(self._explanations.best(len(found.fitted)))
        return self._instead is not None

    def _by_laws(self, best: Explanation | None) -> Explanation | None:
        """An explanation if it has laws, and no soil of its own in each recording does as well."""
        if best is None or best.laws is None:
            return None
        return best if best.effects or self._force_alone is not None else None

    def kept(self, outcome: object) -> Decision:
        """What is left of the names."""
        decision = self._decision
        if outcome is Outcome.NAMED:
            return without_ties_among_named(self._with_laws or decision)
        if outcome is Outcome.SOILS:
            return without_ties_among_named(
                replace(on_no_list(self._found), by_recording=self._soils[2], left=self._without_left)
            )
        if outcome is Outcome.NOTHING and not decision.fitted:
            return without_ties_among_named(decision)
        back = replace(on_no_list(self._found), left=self._without_left)
        if outcome is Outcome.NOTHING:
            return without_ties_among_named(back)
        if self._force_alone is not None:
            alone = self._explanations(())
            back = replace(back, unexplained=alone.force, laws=alone.laws)
        return without_ties_among_named(replace(back, by_recording=self._contradiction))

    def withdrawal(self, reason: Reason) -> Withdrawal:
        """What was not named, why, and what it would have gained."""
        gain = self.held.gain if reason in (Reason.REFUTED, Reason.MINOR) else {}
        return Withdrawal(tuple(one.effect for one in self._decision.fitted), reason, gain, self._decision.left)

    @property
    def last_is_worse(self) -> bool:
        """Whether held-out recordings are predicted worse with the last of several effects, or of those that tie."""
        fitted = self._decision.fitted
        if not fitted or (len(fitted) == 1 and not fitted[0].ties):
            return False
        worth = self.held.gained.get(fitted[-1].effect)
        return worth is not None and worth.after > worth.before

    def without_last(self, go_on: GoOn | None) -> Decision:
        """The decision without the effect that was found last, and what a search that goes on without it finds."""
        gone = self._decision.fitted[-1]
        if go_on is not None and gone is self._found.fitted[-1]:
            return go_on(gone.effect)
        return self._decision.without_last()

    @property
    def last(self) -> Withdrawal:
        """The last effect beside the others, if there are any, and how held-out recordings are predicted with it."""
        *others, effect = (one.effect for one in self._decision.fitted)
        beside = LastEffect(tuple(others), self.held.gained[effect]) if others else None
        gain = {} if others else self.held.gain
        return Withdrawal((effect,), Reason.REFUTED, gain, self._decision.left, beside)

    @cached_property
    def held(self) -> HeldOut:
        """What effects and laws are worth on held-out recordings, effects included that only commands show."""
        return self._judge(without_ties_among_named(self._with_laws or self._decision))

    @cached_property
    def _decision(self) -> Decision:
        """With those effects only that soils of each recording leave."""
        return self._soils[1]

    @cached_property
    def _soils(self) -> tuple[str, Decision, ByRecording | None]:
        found = replace(self._found, left=remains(self._found.problem, self._found.fit.point))
        return soils_of(found)

    @property
    def untried(self) -> tuple[str, ...]:
        """What there was no time for."""
        return self._explanations.untried

    @cached_property
    def _explanations(self) -> Explanations:
        return self._explain(self._decision)

    @cached_property
    def _with_laws(self) -> Decision | None:
        """The effects that are still needed beside laws, where these together leave no more than noise."""
        best = self._better
        if best is None and leaves_more_than_noise(self._decision.left) and self._laws_compete:
            best = self._explanations.best() if self._explanations.force() is not None else None
        return self._explanations.decision(best, self._decision) if best is not None and best.effects else None

    @cached_property
    def _better(self) -> Explanation | None:
        """Laws that explain the recordings better than the effects, with no more terms; None where none do.

        What leaves no more than noise in single windows need not be the best of what does so.
        """
        found = self._decision
        if leaves_more_than_noise(found.left) or not (self._laws_compete and self._explanations.promised):
            return self._instead
        return self._by_laws(self._explanations.best(len(found.fitted), alone=True))

    @property
    def _laws_compete(self) -> bool:
        """Whether laws are asked to explain what effects do not."""
        return bool(self._decision.fitted) and self._forces_tell and self._soils[0] == "no"

    @property
    def _force(self) -> ForceFinding | None:
        """The force that is at work instead of what was fitted, or beside it."""
        if not self._forces_tell:
            return None
        if self._decision.fitted and self._better is None:
            if not leaves_more_than_noise(self._decision.left):
                return None
            if self._explanations.force() is None and not self._changes:
                return None
        return self._force_alone

    @property
    def _forces_tell(self) -> bool:
        """Whether a force on no list may take an effect's place, or stand beside it; without effects it may always.

        Where nothing measures forces, all that bends poses is a force: a lever arm is one to the side that follows the
        yaw rate.
        """
        return not self._decision.fitted or shows_forces(self._decision.problem)

    @cached_property
    def _changes(self) -> bool:
        """Whether the size of an effect changes in the course of the recordings."""
        found = self._decision
        return any(nats >= found.least for nats in drifts(found.problem, found.fit).values())

    @property
    def _force_alone(self) -> ForceFinding | None:
        """The force that explains the recordings without any effect; None where several soils do."""
        if not self._forces_tell:
            return None
        alone = self._contradiction
        return None if alone is not None and alone.sufficient else self._explanations.force(())

    @cached_property
    def _without_left(self) -> Mapping[str, SlowResidual]:
        return remains(self._found.neutral_problem, self._found.neutral_fit.point)

    @cached_property
    def _contradiction(self) -> ByRecording | None:
        """The recordings one by one without any effect, where they contradict each other."""
        problem, fit = self._found.neutral_problem, self._found.neutral_fit
        return fitted_by_recording(problem, fit) if disagreement(problem, fit) >= self._found.least else None


class CommandFacts:
    """Facts about effects that only commands show, beside what is named of the others."""

    def __init__(self, found: Decision, view: CommandView, judge: Judge) -> None:
        self._found, self._view, self._judge = found, view, judge

    def __call__(self, question: str) -> str:
        """The fact that a question of the table asks for."""
        if question == "followed":
            if not self._view.levels:
                return "not commanded"
            return "yes" if self._view.followed else "no" if self._view.plausible else "not theirs"
        if question == "effects":
            return "yes" if _commanded(self._found) else "no"
        if question == "left":
            return self._size(self._with)
        if question == "share":
            most = (
                self._with is not None
                and self._none is not None
                and self._with.worst > MINOR_COMMANDS * self._none.worst
            )
            return "most" if most else "little"
        if question == "held out":
            return self._held.fact(self._found)
        assert question == "left without"
        return self._size(self._none)

    def kept(self, outcome: object) -> Decision:
        """What is left of the names, and what is left in the front motors' speeds."""
        named = outcome is Outcome.NAMED or not _commanded(self._found)
        kept = self._found if named else replace(self._found, named=_uncommanded(self._found))
        left = self._with if named else self._none
        return kept if left is None or not self._view.plausible else replace(kept, left={**kept.left, COMMANDED: left})

    def withdrawal(self, reason: Reason) -> Withdrawal:
        """What was not named, why, and what it would have gained."""
        effects = tuple(one.effect for one in _commanded(self._found))
        left = {} if self._with is None else {COMMANDED: self._with}
        return Withdrawal(effects, reason, self._held.gain if reason is Reason.REFUTED else {}, left)

    def _size(self, left: SlowResidual | None) -> str:
        return "noise" if left is None or not beyond_noise({COMMANDED: left}) else "more"

    @cached_property
    def _held(self) -> HeldOut:
        return self._judge(replace(self._found, laws=None))

    @cached_property
    def _with(self) -> SlowResidual | None:
        return self._view.remainder(self._robot(self._found.named))

    @cached_property
    def _none(self) -> SlowResidual | None:
        return self._view.remainder(self._robot(_uncommanded(self._found)))

    def _robot(self, named: tuple[Named, ...]) -> Robot:
        """The model with these."""
        robot = self._found.problem.parameters.robot_at(self._found.fit.point.coordinates)
        stated = {one.effect: {name: found.value for name, found in one.found.items()} for one in named if one.found}
        return replace(robot, effects={**robot.effects, **stated})


def size_of(left: Mapping[str, SlowResidual]) -> str:
    """What is left, as the tables ask for it."""
    if far_beyond_noise(left):
        return "far more"
    return "more" if leaves_more_than_noise(left) else "noise"


def soils_of(found: Decision) -> tuple[str, Decision, ByRecording | None]:
    """Whether a soil of its own in each recording explains more than all effects that follow, and which effects stay.

    Not where the recordings agree with each other, or leave more than noise one by one as well. The normal equations
    may take them to agree where a compromise of a soil is far from either.
    """
    alone = len(found.problem.recordings[0]) == 1
    agree = disagreement(found.problem, found.fit) < found.least
    if alone or (agree and not leaves_more_than_noise(found.left)):
        return "no", found, None
    last = fitted_by_recording(found.problem, found.fit)
    if not last.sufficient:  # nor are soils with fewer effects
        return "no", found, None
    for count, (problem, fit) in enumerate(found.fits):
        each = fitted_by_recording(problem, fit) if count < len(found.fitted) else last
        further = sum(one.nats for one in found.fitted[count:])
        if each.nats < max(further, found.least) or not each.sufficient:
            continue
        if not count:
            return "instead", found, each
        kept = tuple(one for one in found.named if one.found or one in found.fitted[:count])
        left = remains(problem, fit.point)
        fits = found.fits[: count + 1]
        return "beside", replace(found, named=kept, fits=fits, left=left, by_recording=each), each
    return "no", found, None


def without_ties_among_named(found: Decision) -> Decision:
    """A decision without ties between named effects: what was found beside another effect is no rival of it."""
    both = {one.effect for one in found.named}
    named = tuple(replace(one, ties=tuple(tie for tie in one.ties if tie not in both)) for one in found.named)
    return replace(found, named=named)


def on_no_list(found: Decision) -> Decision:
    """The paper's model: of what is named only what was not fitted to the motion stays."""
    named = tuple(one for one in found.named if one.found)
    return replace(found, named=named, fits=found.fits[:1], by_recording=None)


def _commanded(found: Decision) -> tuple[Named, ...]:
    """What only commands show."""
    return tuple(one for one in found.named if one.found and one.effect != FILTER)


def _uncommanded(found: Decision) -> tuple[Named, ...]:
    """What else is named."""
    return tuple(one for one in found.named if not one.found or one.effect == FILTER)


def _recorded(found: Decision) -> tuple[Named, ...]:
    """What recorded angles show of the speeds recorded beside them."""
    return tuple(one for one in found.named if one.effect == FILTER)
