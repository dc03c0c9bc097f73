"""Forward selection and backward elimination of effects, until the data ask for no more."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.candidates.patches import on_best_disc
from artibot_sim.diagnose.commands.view import CommandView
from artibot_sim.diagnose.policy import Thresholds
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.every_window import EveryWindow
from artibot_sim.diagnose.selection.evidence import CommandEvidence, Evidence, others, together
from artibot_sim.diagnose.selection.forward import SearchStage, refusal, stage, thorough
from artibot_sim.diagnose.selection.joint_fits import Rival, Rounds, settled
from artibot_sim.diagnose.selection.ridge_search import at_size
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.timetable import Task, TimeLimit, Timetable
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Effort, Fit, Tick, converge, search
from artibot_sim.estimation.solver import Point, evaluate, reassessed
from artibot_sim.model.effects import EFFECTS

if TYPE_CHECKING:
    from artibot_sim.diagnose.records import Options

# ----------------------------------------------------------------------
# Effects that are not needed any more once those found after them are in the model.
#
# What is named first may have stood for two others at once, or for a soil that a search beside them finds.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Removal:
    """A model without one of its effects.

    Attributes
    ----------
    which : int
        The effect's place among all.
    problem, fit : Problem, Fit
        Without it.
    nats : float
        What it was worth beside the others; less than nothing where it kept the fit from a better soil.
    """

    which: int
    problem: Problem
    fit: Fit
    nats: float


def superfluous(
    problem: Problem, fit: Fit, loss: Loss, least: float, rounds: Rounds, tick: Tick = lambda: None
) -> Removal | None:
    """The model without the effect that it needs least, if that is worth less than `least` nats; None if all are.

    Of the last one this is not asked: it was found beside all the others.
    """
    earlier = range(len(problem.parameters.extensions) - 1)
    removals = side_by_side(lambda which: removal_of(problem, fit, loss, which, rounds), earlier, problem.workers, tick)
    found = min(removals, key=lambda one: one.nats, default=None)
    return found if found is not None and found.nats < least else None


def removal_of(problem: Problem, fit: Fit, loss: Loss, which: int, rounds: Rounds) -> Removal:
    """The model without an effect: from where the fit is, or with the soil searched anew, whichever fits better."""
    part, here = without_effect(problem, loss, fit.point, which)
    best = fits_from_two_soils(part, here, loss, rounds)[0]
    firm = reassessed(problem, replace(loss, firm=True), fit.point).cost
    return Removal(which, part, best, 0.5 * (best.point.cost - firm))


def fits_from_two_soils(problem: Problem, point: Point, loss: Loss, rounds: Rounds) -> list[Fit]:
    """Fits of effects beside the soil at `point`, and beside one searched from several starts; the least cost first.

    A soil that was found without an effect makes up for it as far as it can. From there steps seldom lead to the one
    that is right beside it, and what else is missing hides behind the wrong one.
    """
    effects = point.coordinates[len(problem.parameters.parameters) :]
    begun = [point, search(problem, Effort(), effects=effects, loss=loss).point]
    fits = side_by_side(lambda one: settled(problem, one, loss, rounds), begun, problem.workers)
    return sorted(fits, key=lambda one: one.point.cost)


# ----------------------------------------------------------------------
# Which effects are named: one after the other, until the data ask for no more.
# ----------------------------------------------------------------------


_EVERY = "evidence of all windows"
_THOROUGH = "fitting every effect to the end"
_LEAVING_OUT = "leaving out each effect that was found"
_SOIL = "another soil beside what was found"
"""Searches, as warnings say that there was no time for them."""
_SAMPLING = 2.0
"""Standard deviations by which the windows that are searched may differ from all."""
_BETTER = 100.0
"""Nats by which a search must better its own baseline, and by more than what it finds is worth, to be made again."""


class SearchTime(TimeLimit):
    """The time that searches have: once there is none for one, none follows.

    Parameters
    ----------
    options : Options

    Attributes
    ----------
    took : float
        s, of the last search for one more effect.
    """

    def __init__(self, options: Options) -> None:
        super().__init__(lambda: options.for_search)
        self.took = 0.0

    @property
    def stopped(self) -> bool:
        """Whether no search follows."""
        return bool(self.untried)

    def lacks(self, what: str) -> bool:
        """Whether a search that takes as long as the last one would take longer than is left."""
        if self.took <= self._left():
            return False
        self.untried.append(what)
        return True


class Naming:
    """The model as it grows, and what was named on the way.

    Parameters
    ----------
    problem, fit : Problem, Fit
        The baseline.
    options : Options
    ticks : Timetable
    view : CommandView
        What the view driven by commands says.
    every : EveryWindow, optional
        All windows, where `problem` has some of them: what the search does not name is judged by them, and they have
        the last word on the sizes of what is named.
    """

    def __init__(
        self, problem: Problem, fit: Fit, options: Options, ticks: Timetable, view: CommandView,
        every: EveryWindow | None = None,
    ) -> None:  # fmt: skip
        self._options, self._ticks, self._view, self._every = options, ticks, view, every
        self._rounds = Rounds(scheduler=options.scheduler)
        self._named: list[Named] = []
        self._dropped: list[str] = []
        self._refuted: list[str] = []
        self._between: list[tuple[Problem, Fit]] = []
        self._whole: list[tuple[Fit, tuple[Problem, Fit]]] = []
        self._again = self._exhausted = False
        self._time = SearchTime(options)
        self._soils: tuple[Problem, tuple[Point, ...]] = problem, ()
        self._from_commands = self._other = others(view)
        self._stages = [self._search_stage(problem, fit, fit.loss)]  # whatever the time: else nothing was tried
        self._problem, self._fit = self._neutral = self._found.problem, self._found.fit

    @property
    def _found(self) -> SearchStage:
        return self._stages[-1]

    @property
    def _names(self) -> list[str]:
        return [one.effect for one in self._named]

    @property
    def _out(self) -> tuple[str, ...]:
        """What is not named any more: it is already, or was taken back."""
        return (*self._names, *self._dropped, *self._refuted)

    def _full(self) -> bool:
        """Whether no search for one more effect follows.

        What only commands show takes none. What sensors make of the truth does not count: those of a real robot have
        several errors at once, and as long as these are in the residuals nothing that is smaller can be told.
        """
        others = [one for one in self._fitted() if EFFECTS[one.effect].sensor is None]
        return len(others) >= self._options.thresholds.most

    def _fitted(self) -> list[Named]:
        return [one for one in self._named if not one.found]

    def _weighed(self, found: SearchStage) -> SearchStage:
        return replace(found, nats=_nats(found, self._view, self._named))

    def _search_stage(self, problem: Problem, fit: Fit, loss: Loss) -> SearchStage:
        begun = time.perf_counter()
        beside_what = _search_name(self._names) or ("beside a better soil" if self._again else "")
        self._ticks.begin(Task.SEARCH, beside_what, named=len(self._fitted()))
        of, soils = self._soils
        beside = [soil for soil in soils if self._rounds.differ(problem, fit, soil)] if of is problem else ()
        asked = [name for name, one in self._from_commands.items() if one.nats >= self._options.least]
        found = stage(problem, fit, loss, self._names, self._rounds, self._ticks, self._options.parts, beside, asked)
        self._time.took = time.perf_counter() - begun
        return self._weighed(found)

    def decide(self) -> Decision:
        """Add effects, and drop what is not needed any more, until the data ask for no more."""
        self.add()
        while self.drop():
            self.add()
        self._ticks()
        return self.decision()

    def without(self, effect: str) -> Decision:
        """Go on without the last of the fitted effects, which held-out recordings speak against.

        What was found beside the others is looked at again, and the next one named, if there is one.
        """
        gone = self._fitted()[-1]
        assert gone.effect == effect
        self._named.remove(gone)
        self._refuted.append(effect)
        self._problem, self._fit = self._between.pop() if self._between else self._neutral
        del self._stages[gone.stage + 1 :]
        self._exhausted = False
        return self.decide()

    def add(self) -> None:
        """Name one effect after the other."""
        thresholds, least = self._options.thresholds, self._options.least
        while not self._time.stopped:
            found, out, full = self._found, self._out, self._full()
            if full:
                out = (*out, *(effect for effect in EFFECTS if "rotation" in _views(effect)))
            best = best_of(found.evidence, found.nats, self._from_commands, least, thresholds, out, found.tried)
            anew = None if full else self._repeated_from_better_soil(best)
            if not full and anew is None:
                best = self._by_every_window(best)
                anew = self._thorough() if best is None else None
            if anew is not None:
                self._stages[-1] = anew
                self._problem, self._fit = anew.problem, anew.fit
                self._neutral = self._neutral if self._named else (anew.problem, anew.fit)
            elif best is not None:
                self._name(best)
            else:
                break

    def _by_every_window(self, best: Named | None) -> Named | None:
        """The best effect by the evidence of all windows, where the search has only some of them."""
        rivals = [] if self._every is None else self._rivals_for_every_window(self._every, best)
        if self._every is None or not rivals or self._time.lacks(_EVERY):
            return best
        return self._of_all(self._every, rivals, best)

    def _rivals_for_every_window(self, every: EveryWindow, best: Named | None) -> list[Rival]:
        """Rivals for the evidence of all windows, the most promising ones first.

        That is asked of the `best` one by the searched windows, of those that tie with it, and of those that may: where
        other windows may make up for what they are behind. Without a best one it is asked of all that would gain enough
        if they gained as much in every window.
        """
        found, least, thresholds = self._found, self._options.least, self._options.thresholds
        rivals = sorted((one for one in found.rivals if one.id not in self._out), key=lambda one: -found.nats[one.id])
        if best is None:
            enough = [one for one in rivals if every.times * found.nats[one.id] >= least + thresholds.more(one.id)]
            return enough[: self._rounds.most[2]]
        first = next((one for one in rivals if one.id == best.effect), None)
        if first is None:
            return []

        def may_tie(one: Rival) -> bool:
            losses = one.fit.point.losses - first.fit.point.losses
            behind = found.nats[first.id] - found.nats[one.id]
            return behind <= thresholds.tie + _SAMPLING * every.sampling_sd(losses)

        near = [one for one in rivals if one is not first and (one.id in best.ties or may_tie(one))]
        return [first, *near][: self._rounds.most[2]]

    def _of_all(self, every: EveryWindow, rivals: list[Rival], best: Named | None) -> Named | None:
        """The best effect once these have the evidence of all windows; the `best` one so far if there is no time."""
        found, options = self._found, self._options
        self._ticks.begin(Task.WINDOWS, _search_name(self._names))
        stated = self._time.within(_EVERY, lambda: options.parts.once(
            _EVERY, lambda: every.evidence(found.problem, found.fit, rivals, len(self._named), self._rounds)
        ))  # fmt: skip
        if stated is None:
            return best
        evidence, by_every_window = stated
        self._whole.append((found.fit, by_every_window))
        both = {**found.evidence, **{rival.id: one for rival, one in zip(rivals, evidence, strict=True)}}
        seen = found.by_every_window.union(rival.id for rival in rivals)
        self._stages[-1] = found = self._weighed(replace(found, evidence=both, by_every_window=seen))
        least, thresholds = options.least, options.thresholds
        return best_of(found.evidence, found.nats, self._from_commands, least, thresholds, self._out, found.tried)

    def _repeated_from_better_soil(self, best: Named | None) -> SearchStage | None:
        """The first search once more, where its effects were screened around a soil that was none."""
        found = self._found
        if self._named or self._again or found.fallen <= max(_BETTER, best.nats if best else 0.0):
            return None
        self._again = True
        return self._time.within(
            "effects beside a better soil", lambda: self._search_stage(found.problem, found.fit, found.loss)
        )

    def _thorough(self) -> SearchStage | None:
        """The last search with every effect fitted, once, where nothing is found though more than noise is left."""
        found = self._found
        if self._exhausted or not leaves_more_than_noise(remains(self._problem, self._fit.point)):
            return None
        self._exhausted = True
        if self._time.lacks(_THOROUGH):
            return None
        self._ticks.begin(Task.SEARCH, f"{_search_name(self._names)}, each fitted to the end")
        return self._time.within(_THOROUGH, lambda: self._weighed(
            thorough(found, self._names, self._rounds, self._ticks, self._options.parts)
        ))  # fmt: skip

    def _name(self, best: Named) -> None:
        """Add an effect to the model, and look for the next one beside it."""
        only_commanded = "rotation" not in _views(best.effect)
        if self._fitted() and not only_commanded:
            self._between.append((self._problem, self._fit))
        own = best if only_commanded else replace(best, found={}, stage=len(self._stages) - 1)
        self._named.append(own)
        if best.effect in self._from_commands:
            self._from_commands = others(self._view, tuple(self._names))
        if only_commanded:
            self._stages[-1] = self._weighed(self._found)
            return
        self._problem, self._fit = _with_effect(self._problem, self._fit, self._found, best, self._options.seed)
        self._search_soil()
        further = f"further effects beside {best.effect.replace('_', ' ')}"
        if not self._full() and not self._time.lacks(further):
            self._search_next(further)

    def _search_soil(self) -> None:
        """Search the soil anew beside what is named, where more than noise is left and there is time.

        Another soil that explains the recordings about as well is kept: effects are tried beside that, too.
        """
        if not leaves_more_than_noise(remains(self._problem, self._fit.point)):
            return
        problem, fit, loss = self._problem, self._fit, self._found.loss
        self._ticks.begin(Task.SEARCH, _search_name(self._names), named=len(self._fitted()))
        key = f"{_SOIL} {_search_name(self._names)}"
        found = self._time.within(_SOIL, lambda: self._options.parts.once(
            key, lambda: fits_from_two_soils(problem, fit.point, loss, self._rounds)
        ))  # fmt: skip
        self._fit, *others = found or [fit]
        close = self._fit.point.cost + 2.0 * self._options.least
        self._soils = problem, tuple(other.point for other in others if other.point.cost < close)

    def _search_next(self, what: str) -> None:
        """Look for one more effect, if there is time."""
        found = self._time.within(what, lambda: self._search_stage(self._problem, self._fit, self._found.loss))
        if found is not None:
            self._stages.append(found)
            self._problem, self._fit = found.problem, found.fit

    def drop(self) -> bool:
        """Take an effect back that those named after it make up for; whether there was one."""
        if self._drop_from_commands():
            return True
        fitted = self._fitted()
        if self._time.stopped or (len(fitted) > 1 and self._time.lacks(_LEAVING_OUT)):
            return False
        self._ticks.begin(Task.LEAVING_OUT, parts=len(fitted) - 1)
        spare = self._time.within(_LEAVING_OUT, lambda: self._options.parts.once(_LEAVING_OUT, self._unneeded))
        if spare is None:
            return False
        gone, self._problem, self._fit = fitted[spare.which], spare.problem, spare.fit
        self._named.remove(gone)
        self._dropped.append(gone.effect)
        self._between = [*self._between[: spare.which], *self._below(len(fitted) - 1, spare.which)]
        self._search_next(f"further effects without {gone.effect.replace('_', ' ')}")
        for place, one in enumerate(self._fitted()):
            if one.stage > gone.stage and not self._time.stopped:
                reassessed = self._time.within(_LEAVING_OUT, partial(self._with_joint_evidence, place, one))
                self._named[self._named.index(one)] = reassessed or one
        return True

    def _drop_from_commands(self) -> bool:
        """Take back the effect that only commands asked for and need least beside the others; whether there was one."""
        stated = _command_evidence(self._view, self._names)
        spare = [one for one in self._named if one.found and stated[one.effect].nats < self._options.least]
        if not spare:
            return False
        gone = min(spare, key=lambda one: stated[one.effect].nats)
        self._named.remove(gone)
        self._dropped.append(gone.effect)
        self._from_commands = others(self._view, tuple(self._names))
        self._stages[-1] = self._weighed(self._found)
        return True

    def _unneeded(self) -> Removal | None:
        """The model without an effect that the data do not ask for any more; None where they ask for all."""
        loss, options = self._found.loss, self._options
        for which, one in enumerate(self._fitted()):
            if self._stated(one) < options.least + options.thresholds.more(one.effect):
                return removal_of(self._problem, self._fit, loss, which, self._rounds)
        every = self._every.times if self._every is not None else 1.0
        return superfluous(self._problem, self._fit, loss, options.least / every, self._rounds, self._ticks)

    def _stated(self, one: Named) -> float:
        """Nats of a fitted effect from both views, beside what only commands show: that may have been named later."""
        if "command" not in _views(one.effect) or len(self._fitted()) == len(self._named):
            return one.nats
        fitted = _nats(self._stages[one.stage], self._view, self._named, (one.effect,))
        return fitted.get(one.effect, _command_evidence(self._view, self._names)[one.effect].nats)

    def _with_joint_evidence(self, place: int, one: Named) -> Named:
        """An effect with what speaks for it beside the others: it was found in a model that was wrong."""
        options, loss = self._options, self._found.loss
        names = [other for other in self._names if other != one.effect]
        rest = removal_of(self._problem, self._fit, loss, place, self._rounds)
        found = self._weighed(stage(rest.problem, rest.fit, loss, names, self._rounds, self._ticks, options.parts))
        out = (*names, *self._dropped, *self._refuted)
        best = best_of(found.evidence, found.nats, {}, options.least, options.thresholds, out)
        if best is None or best.effect != one.effect:
            return one
        self._stages.insert(len(self._stages) - 1, found)
        return replace(best, found={}, stage=len(self._stages) - 2)

    def _below(self, count: int, least: int) -> list[tuple[Problem, Fit]]:
        """The model, which has `count` effects, with only the first of them: as many as are more than `least`."""
        found: list[tuple[Problem, Fit]] = []
        problem, fit = self._problem, self._fit
        for last in range(count - 1, least, -1):
            problem, point = without_effect(problem, self._found.loss, fit.point, last)
            fit = converge(problem, point, self._found.loss, self._rounds.few)
            found.insert(0, (problem, fit))
        return found

    def _carried(self, every: EveryWindow, fits: list[tuple[Problem, Fit]]) -> list[tuple[Problem, Fit]]:
        """Fits of the searched windows as fits of all, if there is time."""
        what = "sizes by all windows"
        found = self._time.within(what, lambda: self._options.parts.once(
            what, lambda: [self._of_all_windows(every, *one) for one in fits]
        ))  # fmt: skip
        return found or fits

    def _of_all_windows(self, every: EveryWindow, problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
        """A model fitted to all windows, unless that was done for the evidence of effects beside it."""
        known = (by_every_window for part, by_every_window in self._whole if part is fit)
        return next(known, None) or every.carried(problem, fit, self._rounds.many)

    def decision(self) -> Decision:
        """What it came to; commands say of each effect what they say beside the others."""
        other = {**self._other, **_command_evidence(self._view, self._names)}
        named = tuple(replace(one, found=other[one.effect].found) if one.found else one for one in self._named)
        fits = [self._neutral, *self._between, (self._problem, self._fit), *self._refitted_from_other_soils()]
        if self._every is not None and self._fitted():
            fits = self._carried(self._every, fits)
        last = 1 + len(self._between)
        return Decision(
            named, self._options.least, *fits[0], *fits[last], tuple(self._stages),
            other, between=tuple(fits[1:last]), dropped=tuple(self._dropped), refuted=tuple(self._refuted),
            untried=tuple(self._time.untried), beside=tuple(fits[last + 1 :]),
            searched=1.0 / self._every.times if self._every is not None else 1.0,
        )  # fmt: skip

    def _refitted_from_other_soils(self) -> list[tuple[Problem, Fit]]:
        """The model fitted beside the soils that explain the recordings about as well, if it is still that model."""
        (of, soils), problem, loss = self._soils, self._problem, self._fit.loss
        if [one.id for one in of.parameters.extensions] != [one.id for one in problem.parameters.extensions]:
            return []

        def fitted(soil: Point) -> tuple[Problem, Fit]:
            point = evaluate(problem, loss, [soil.coordinates], soil.starts)[0]
            return problem, converge(problem, point, loss, self._rounds.few)

        return side_by_side(fitted, soils, problem.workers)


def _search_name(names: Sequence[str]) -> str:
    """What a search is beside, in words; empty where it is the first one."""
    return f"beside {', '.join(name.replace('_', ' ') for name in names)}" if names else ""


def _command_evidence(view: CommandView, named: Sequence[str]) -> dict[str, CommandEvidence]:
    """What commands say of each named effect once the others are in the model: alone it stands for them as well."""
    found: dict[str, CommandEvidence] = {}
    for effect in named:
        stated = others(view, tuple(one for one in named if one != effect))
        found |= {effect: stated[effect]} if effect in stated else {}
    return found


def _views(effect: str) -> tuple[str, ...]:
    search = EFFECTS[effect].search
    return tuple(search.views) if search is not None else ()


def _with_effect(problem: Problem, fit: Fit, found: SearchStage, best: Named, seed: int) -> tuple[Problem, Fit]:
    """The model with the effect that was named, as it was fitted, or begun at the size that commands tell."""
    for rival in found.rivals:
        if rival.id == best.effect:
            return on_best_disc(rival.problem, rival.fit, seed, Rounds().few)
    values, extension = (
        {name: one.value for name, one in best.found.items()},
        sized(best.effect, problem.parameters.robot),
    )
    known = {name: value for name, value in values.items() if name not in extension.search.sizes}
    if known:  # commands tell more of it than a fit looks for
        extension = replace(extension, fixed={**extension.fixed, **known})
    own = extension.coordinates(values)
    return at_size(problem, fit, extension, own, Rounds().few)


def _nats(
    found: SearchStage, view: CommandView, named: Sequence[Named], of: Collection[str] | None = None
) -> dict[str, float]:
    """Log Bayes factors of what was fitted, all of it or some effects only, from both views."""
    beside = {n.effect: {name: float(f.value) for name, f in n.found.items()} for n in named if n.found}
    rivals = [rival for rival in found.rivals if of is None or rival.id in of]
    return {rival.id: together(view, rival, found.evidence[rival.id], beside) for rival in rivals}


def best_of(
    evidence: Mapping[str, Evidence],
    fitted: Mapping[str, float],
    from_commands: Mapping[str, CommandEvidence],
    least: float,
    thresholds: Thresholds,
    without: Collection[str] = (),
    tried: Collection[str] = (),
) -> Named | None:
    """The effect with the most evidence, if it is enough, and those that tie with it; None if there is none.

    Parameters
    ----------
    evidence : mapping of str to Evidence
        Of what was fitted, by the view that is driven by rotations.
    fitted : mapping of str to float
        Nats of the same from both views.
    from_commands : mapping of str to CommandEvidence
        What the view driven by commands says.
    least : float
        Nats that an effect has to gain.
    without : collection of str
        What is named already.
    tried : collection of str
        What the motion was asked for; commands alone do not name that.
    """
    good: dict[str, float] = {}
    for effect, nats in fitted.items():
        enough = least + thresholds.more(effect)
        if effect not in without and not refusal(effect, evidence[effect], nats, enough, thresholds):
            good[effect] = nats
    for effect, view in from_commands.items():
        if effect in good or effect in (*without, *fitted, *tried):
            continue  # what the motion would show and does not ask for is no cause, however well commands like it
        if view.nats >= least:
            good[effect] = view.nats
    if not good:
        return None
    best = max(good, key=lambda effect: good[effect])

    def margin(effect: str) -> float:
        """What commands show has the noise that the best of it leaves; nothing but chance is to be feared there."""
        commanded = best not in fitted and effect not in fitted
        return thresholds.tie if commanded else max(thresholds.tie, thresholds.tie_share * good[best])

    ties = sorted((e for e in good if e != best and good[e] >= good[best] - margin(e)), key=lambda e: -good[e])
    values = from_commands[best].found if best in from_commands and best not in fitted else {}
    return Named(best, good[best], tuple(ties), values)
