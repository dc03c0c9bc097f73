"""Named effects and forces on no list together: which effects the data still ask for once laws are in the model.

What a search of the lists names where a force on no list acts may be the shadow of that force, or an effect that is
there beside it. So laws are searched in what each choice of the named effects leaves, and these models compete.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeVar

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.policy import FORCE_NATS, TIE, TIE_SHARE
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.selection.decision import Decision
from artibot_sim.diagnose.timetable import Task, Timetable
from artibot_sim.diagnose.unlisted.finding import ForceFinding, unexplained
from artibot_sim.diagnose.unlisted.fitting import FittedLaws, fitted_laws, promise
from artibot_sim.estimation.parallel import TimeIsUp, until
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge
from artibot_sim.estimation.solver import reassessed
from artibot_sim.model.effects import LAWS

Which = tuple[int, ...]
"""Places among a decision's fitted effects."""

Result = TypeVar("Result")

_FORCES = "forces on no list"
"""The search for these, as warnings say that there was no time for it."""
_STEPS = 3
"""Of a fit from which effects were taken."""


@dataclass(frozen=True)
class Explanation:
    """Some of the named effects, and what acts beside them.

    Attributes
    ----------
    effects : tuple of int
        Their places among the decision's fitted ones.
    problem, fit : Problem, Fit
        The model with these effects alone.
    force : ForceFinding or None
        What a force on no list explains of its residuals.
    laws : FittedLaws or None
        The model with these effects and the force, and others that were found after it, as laws.
    """

    effects: Which
    problem: Problem
    fit: Fit
    force: ForceFinding | None
    laws: FittedLaws | None

    @property
    def terms(self) -> int:
        """Effects and laws."""
        return len(self.effects) + (len(self.laws.spans) if self.laws is not None else 0)

    @property
    def cost(self) -> float:
        """With the laws."""
        return float((self.laws.fit if self.laws is not None else self.fit).point.cost)

    @property
    def suffices(self) -> bool:
        """Whether laws were found, and no more than noise is left with them."""
        laws = self.laws
        return laws is not None and not leaves_more_than_noise(remains(laws.problem, laws.fit.point))


class Explanations:
    """What explains the recordings of a decision; each is made once.

    All are under the loss of the decision's fit, and of the same windows with the same noise: their costs compare.

    Parameters
    ----------
    found : Decision
    ticks : Timetable, optional
        Told of each part of the work.
    latest : float
        Instant of `time.perf_counter` after which no more forces are looked for.

    Attributes
    ----------
    untried : tuple of str
        What there was no time for.
    """

    def __init__(self, found: Decision, ticks: Timetable | None = None, latest: float = math.inf) -> None:
        self._found, self._ticks, self._latest = found, ticks or Timetable(), latest
        self.untried: tuple[str, ...] = ()
        self._models: dict[Which, tuple[Problem, Fit]] = {tuple(range(len(found.fitted))): (found.problem, found.fit)}
        self._forces: dict[Which, ForceFinding | None] = {}
        self._made: dict[Which, Explanation] = {}

    def force(self, effects: Which | None = None) -> ForceFinding | None:
        """What a force explains of what some of the effects leave, or all of them; None if nothing is left for one.

        The model is asked where no force explains enough by itself.
        """
        which = tuple(range(len(self._found.fitted))) if effects is None else effects
        found = self._possible(which)
        return found if found is None or found.chosen else self(which).force

    @property
    def promised(self) -> bool:
        """Whether sensitivities of whole windows promise enough of a law beside all effects."""
        nats = self._in_time(lambda: promise(self._found.problem, self._found.fit))
        return nats is not None and nats >= FORCE_NATS

    def _possible(self, which: Which) -> ForceFinding | None:
        """The forces that may be what some of the effects leave."""
        if which not in self._forces:
            self._ticks.begin(Task.FORCES)
            problem, fit = self._model(which)
            self._forces[which] = self._in_time(lambda: unexplained(problem, fit.point.coordinates))
        return self._forces[which]

    def _in_time(self, find: Callable[[], Result | None]) -> Result | None:
        """What looking for forces finds; None if the time is up before."""
        try:
            with until(self._latest):
                return find()
        except TimeIsUp:
            self.untried = (_FORCES,)
            return None

    def __call__(self, effects: Which, most: int = len(LAWS)) -> Explanation:
        """Laws beside some of the effects, so many at most."""
        if effects in self._made:
            return self._made[effects]
        (problem, fit), found = self._model(effects), self._possible(effects)
        laws = None
        if found is not None:
            laws = self._in_time(lambda: fitted_laws(problem, fit, found, self._ticks, most=most))
        force = laws.force if laws is not None else found if found is not None and found.chosen else None
        one = Explanation(effects, problem, fit, force, laws)
        if most >= len(LAWS) or one.suffices:
            self._made[effects] = one
        return one

    def best(self, most: float = math.inf, alone: bool = False) -> Explanation | None:
        """The simplest one that leaves no more than noise, of those with so many terms at most; None if none does.

        All effects `alone`, without a law, are one of them where they leave no more than noise.

        Effects and laws cost the same. What is as simple and explains as much has effects rather than laws: a law may
        look like any of them. Of three effects pairs are not tried: each choice takes a search and a fit. But a law
        that was found beside effects may do without any of them: where it acts and on which soil is known then, which a
        search without them, on the soil that the force has bent, need not find.
        """
        every_effect = tuple(range(len(self._found.fitted)))
        found = [Explanation(every_effect, *self._model(every_effect), None, None)] if alone else []
        best: Explanation | None = None
        for count in sorted({0, 1, len(self._found.fitted)}):
            if count + 1 > (most if best is None else best.terms):  # with a law it would have more terms
                break
            laws = int(min(most - count, len(LAWS)))
            every = (self(which, laws) for which in combinations(every_effect, count))
            found += [one for one in every if one.suffices]
            best = self._simplest(found) if found else None
        while best is not None and best.effects and best.laws is not None:
            fewer = [one for place in best.effects if (one := self._without(best, place)).suffices]
            if not fewer:
                break
            simplest = self._simplest([best, *fewer])
            if simplest is best:
                break
            best = simplest
        return best

    def _without(self, one: Explanation, place: int) -> Explanation:
        """Laws without one of an explanation's effects, begun on the soil that goes with all of it."""
        effects = tuple(other for other in one.effects if other != place)
        (problem, fit), whole = self._model(effects), one.laws
        assert whole is not None
        larger, begin = whole.problem, whole.fit.point
        for which in (*(-1 for _ in whole.spans), one.effects.index(place)):
            larger, begin = without_effect(larger, fit.loss, begin, which)
        found = self._in_time(lambda: unexplained(problem, begin.coordinates, 1))
        laws = None if found is None else self._in_time(lambda: fitted_laws(problem, fit, found, self._ticks, begin))
        again = Explanation(effects, problem, fit, None if laws is None else laws.force, laws)
        if again.suffices:
            self._made[effects] = again
        return again

    def _simplest(self, found: list[Explanation]) -> Explanation:
        worth = {one.effects: -0.5 * one.cost - self._found.least * one.terms for one in found}
        neutral = 0.5 * self._model(())[1].point.cost
        most = max(worth.values())
        close = [one for one in found if worth[one.effects] >= most - max(TIE, TIE_SHARE * (neutral + most))]
        return max(close, key=lambda one: (-one.terms, len(one.effects), worth[one.effects]))

    def _model(self, effects: Which) -> tuple[Problem, Fit]:
        """The model with these effects alone: as the search left it, or as it is once another effect is taken out."""
        if effects not in self._models:
            gone = next(place for place in range(len(self._found.fitted)) if place not in effects)
            more = tuple(sorted((*effects, gone)))
            whole, fit = self._model(more)
            problem, point = without_effect(whole, fit.loss, fit.point, more.index(gone))
            if effects == tuple(range(len(effects))):
                searched = reassessed(problem, fit.loss, self._found.fits[len(effects)][1].point)
                point = min(point, searched, key=lambda one: one.cost)
            self._models[effects] = problem, converge(problem, point, fit.loss, _STEPS)
        return self._models[effects]

    def decision(self, one: Explanation, found: Decision) -> Decision:
        """A decision of these models with this explanation's effects and laws."""
        laws = one.laws
        assert laws is not None
        named = tuple(each for each in found.named if each.found or found.fitted.index(each) in one.effects)
        fits = (found.fits[0], *(self._model(one.effects[:count]) for count in range(1, len(one.effects) + 1)))
        left = {**found.left, **remains(laws.problem, laws.fit.point)}
        return replace(found, named=named, fits=fits, left=left, unexplained=one.force, laws=laws)
