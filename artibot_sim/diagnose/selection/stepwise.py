"""Forward selection and backward elimination of effects, until the data ask for no more."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from artibot_sim.diagnose.candidates.patches import on_best_disc
from artibot_sim.diagnose.commands.view import CommandView
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains, shows_forces
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.elimination import Removal, removal_of, superfluous, with_soil_searched
from artibot_sim.diagnose.selection.every_window import EveryWindow, rivals_for_every_window
from artibot_sim.diagnose.selection.evidence import others
from artibot_sim.diagnose.selection.forward import SearchStage, stage, thorough
from artibot_sim.diagnose.selection.joint_fits import Rival, Rounds
from artibot_sim.diagnose.selection.naming import best_of, command_evidence, nats_of, views_of
from artibot_sim.diagnose.selection.ridge_search import at_size
from artibot_sim.diagnose.selection.selected import SelectedModel
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.timetable import Task, TimeLimit, Timetable
from artibot_sim.diagnose.unlisted.fitting import promise
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge
from artibot_sim.estimation.solver import Point, evaluate
from artibot_sim.model.effects import EFFECTS

_EVERY = "evidence of all windows"
_THOROUGH = "fitting every effect to the end"
_LEAVING_OUT = "leaving out each effect that was found"
_SOIL = "another soil beside what was found"
"""Searches, as warnings say that there was no time for them."""
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


class StepwiseSelection:
    """Forward selection and backward elimination of effects.

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
    explained : callable, optional
        Whether laws explain the recordings, with no more terms than a decision has effects, which leave more than
        noise: then the search is over. It is asked once, where whole windows promise more of a law than the last effect
        gained.
    """

    def __init__(
        self, problem: Problem, fit: Fit, options: Options, ticks: Timetable, view: CommandView,
        every: EveryWindow | None = None, explained: Callable[[Decision], bool] | None = None,
    ) -> None:  # fmt: skip
        self._options, self._ticks, self._view, self._every = options, ticks, view, every
        self._explained: Callable[[Decision], bool] | None = explained
        self._end: Decision | None = None
        self._rounds = Rounds(scheduler=options.scheduler)
        self._model = SelectedModel(((problem, fit),))
        self._whole: list[tuple[Fit, tuple[Problem, Fit]]] = []
        self._again = self._exhausted = False
        self._time = SearchTime(options)
        self._soils: tuple[Problem, tuple[Point, ...]] = problem, ()
        self._from_commands = self._other = others(view)
        self._stages = [self._search_stage(problem, fit, fit.loss)]  # whatever the time: else nothing was tried
        self._model = self._model.refitted(self._found.problem, self._found.fit)

    @property
    def _found(self) -> SearchStage:
        return self._stages[-1]

    def _full(self) -> bool:
        """Whether no search for one more effect follows: laws explain the rest, or enough of them were found.

        What only commands show takes none. What sensors make of the truth does not count: those of a real robot have
        several errors at once, and as long as these are in the residuals nothing that is smaller can be told.
        """
        others = [one for one in self._model.fitted if EFFECTS[one.effect].sensor is None]
        return self._end is not None or len(others) >= self._options.thresholds.most

    def _weighed(self, found: SearchStage) -> SearchStage:
        return replace(found, nats=nats_of(found, self._view, self._model.named))

    def _search_stage(self, problem: Problem, fit: Fit, loss: Loss) -> SearchStage:
        begun = time.perf_counter()
        beside_what = _search_name(self._model.names) or ("beside a better soil" if self._again else "")
        self._ticks.begin(Task.SEARCH, beside_what, named=len(self._model.fitted))
        of, soils = self._soils
        beside = [soil for soil in soils if self._rounds.differ(problem, fit, soil)] if of is problem else ()
        asked = [name for name, one in self._from_commands.items() if one.nats >= self._options.least]
        found = stage(
            problem, fit, loss, self._model.names, self._rounds, self._ticks, self._options.parts, beside, asked
        )
        self._time.took = time.perf_counter() - begun
        return self._weighed(found)

    def decide(self) -> Decision:
        """Add effects, and drop what is not needed any more, until the data ask for no more, or laws explain them."""
        self.add()
        while self.drop():
            self.add()
        self._ticks()
        return self.decision()

    def without(self, effect: str) -> Decision:
        """Go on without the last of the fitted effects, which held-out recordings speak against.

        What was found beside the others is looked at again, and the next one named, if there is one.
        """
        gone = self._model.fitted[-1]
        assert gone.effect == effect
        self._model = self._model.without_last()
        del self._stages[gone.stage + 1 :]
        self._exhausted, self._end = False, None
        return self.decide()

    def add(self) -> None:
        """Name one effect after the other."""
        thresholds, least = self._options.thresholds, self._options.least
        while not self._time.stopped:
            found, out, full = self._found, self._model.out, self._full()
            if full:
                out = (*out, *(effect for effect in EFFECTS if "rotation" in views_of(effect)))
            best = best_of(found.evidence, found.nats, self._from_commands, least, thresholds, out, found.tried)
            anew = None if full else self._repeated_from_better_soil(best)
            if not full and anew is None:
                best = self._by_every_window(best)
                anew = self._thorough() if best is None else None
            if anew is not None:
                self._stages[-1] = anew
                self._model = self._model.refitted(anew.problem, anew.fit)
            elif best is not None:
                self._name(best)
            else:
                break

    def _by_every_window(self, best: Named | None) -> Named | None:
        """The best effect by the evidence of all windows, where the search has only some of them."""
        every, model, options = self._every, self._model, self._options
        if every is None:
            return best
        rivals = rivals_for_every_window(every, self._found, best, model.out, options)[: self._rounds.most[2]]
        if not rivals or self._time.lacks(_EVERY):
            return best
        return self._of_all(every, rivals, best)

    def _of_all(self, every: EveryWindow, rivals: list[Rival], best: Named | None) -> Named | None:
        """The best effect once these have the evidence of all windows; the `best` one so far if there is no time."""
        found, options = self._found, self._options
        self._ticks.begin(Task.WINDOWS, _search_name(self._model.names))
        stated = self._time.within(_EVERY, lambda: options.parts.once(
            _EVERY, lambda: every.evidence(found.problem, found.fit, rivals, len(self._model.named), self._rounds)
        ))  # fmt: skip
        if stated is None:
            return best
        evidence, by_every_window = stated
        self._whole.append((found.fit, by_every_window))
        both = {**found.evidence, **{rival.id: one for rival, one in zip(rivals, evidence, strict=True)}}
        seen = found.by_every_window.union(rival.id for rival in rivals)
        self._stages[-1] = found = self._weighed(replace(found, evidence=both, by_every_window=seen))
        least, thresholds = options.least, options.thresholds
        return best_of(found.evidence, found.nats, self._from_commands, least, thresholds, self._model.out, found.tried)

    def _repeated_from_better_soil(self, best: Named | None) -> SearchStage | None:
        """The first search once more, where its effects were screened around a soil that was none."""
        found = self._found
        if self._model.named or self._again:
            return None
        if found.bettered(self._rounds.few) <= max(_BETTER, best.nats if best else 0.0):
            return None
        self._again = True
        return self._time.within(
            "effects beside a better soil", lambda: self._search_stage(found.problem, found.fit, found.loss)
        )

    def _thorough(self) -> SearchStage | None:
        """The last search with every effect fitted, once, where nothing is found though more than noise is left."""
        found = self._found
        if self._exhausted or not leaves_more_than_noise(remains(self._model.problem, self._model.fit.point)):
            return None
        self._exhausted = True
        if self._time.lacks(_THOROUGH):
            return None
        self._ticks.begin(Task.SEARCH, f"{_search_name(self._model.names)}, each fitted to the end")
        return self._time.within(_THOROUGH, lambda: self._weighed(
            thorough(found, self._model.names, self._rounds, self._ticks, self._options.parts)
        ))  # fmt: skip

    def _name(self, best: Named) -> None:
        """Add an effect to the model, and look for the next one beside it."""
        only_commanded = "rotation" not in views_of(best.effect)
        if only_commanded:
            self._model = self._model.naming(best)
        else:
            larger = _with_effect(self._model.problem, self._model.fit, self._found, best, self._options.seed)
            self._model = self._model.growing(replace(best, found={}, stage=len(self._stages) - 1), *larger)
        if best.effect in self._from_commands:
            self._from_commands = others(self._view, tuple(self._model.names))
        if only_commanded:
            self._stages[-1] = self._weighed(self._found)
            return
        self._ask_laws(best)
        if self._end is None:
            self._search_soil()
        further = f"further effects beside {best.effect.replace('_', ' ')}"
        if not self._full() and not self._time.lacks(further):
            self._search_next(further)

    def _ask_laws(self, best: Named) -> None:
        """Ask once whether laws explain it all, where they promise more than the effect that was found: the end if so.

        What whole windows promise of laws, and what the effect gained, is both held against the model without it.
        """
        model, asked, before = self._model, self._explained, self._found
        if asked is None or not shows_forces(model.problem):
            return
        left = leaves_more_than_noise(remains(model.problem, model.fit.point))
        if left and promise(before.problem, before.fit) > best.nats:
            self._explained, decision = None, self.decision()
            self._end = decision if asked(decision) else None

    def _search_soil(self) -> None:
        """Search the soil anew beside what is named, where more than noise is left and there is time.

        Another soil that explains the recordings about as well is kept: effects are tried beside that, too.
        """
        if not leaves_more_than_noise(remains(self._model.problem, self._model.fit.point)):
            return
        problem, fit, loss = self._model.problem, self._model.fit, self._found.loss
        self._ticks.begin(Task.SEARCH, _search_name(self._model.names), named=len(self._model.fitted))
        key = f"{_SOIL} {_search_name(self._model.names)}"
        anew = self._time.within(_SOIL, lambda: self._options.parts.once(
            key, lambda: with_soil_searched(problem, fit.point, loss, self._rounds)
        ))  # fmt: skip
        best, *others = sorted([fit] if anew is None else [fit, anew], key=lambda one: one.point.cost)
        self._model = self._model.refitted(problem, best)
        close = best.point.cost + 2.0 * self._options.least
        self._soils = problem, tuple(other.point for other in others if other.point.cost < close)

    def _search_next(self, what: str) -> None:
        """Look for one more effect, if there is time."""
        model, loss = self._model, self._found.loss
        found = self._time.within(what, lambda: self._search_stage(model.problem, model.fit, loss))
        if found is not None:
            self._stages.append(found)
            self._model = model.refitted(found.problem, found.fit)

    def drop(self) -> bool:
        """Take an effect back that those named after it make up for; whether there was one."""
        if self._drop_from_commands():
            return True
        fitted = self._model.fitted
        if self._end is not None or self._time.stopped or (len(fitted) > 1 and self._time.lacks(_LEAVING_OUT)):
            return False
        self._ticks.begin(Task.LEAVING_OUT, parts=len(fitted) - 1)
        spare = self._time.within(_LEAVING_OUT, lambda: self._options.parts.once(_LEAVING_OUT, self._unneeded))
        if spare is None:
            return False
        gone = fitted[spare.which]
        self._model = self._model.without(spare, self._found.loss, self._rounds.few)
        self._search_next(f"further effects without {gone.effect.replace('_', ' ')}")
        for place, one in enumerate(self._model.fitted):
            if one.stage > gone.stage and not self._time.stopped:
                reassessed = self._time.within(_LEAVING_OUT, partial(self._with_joint_evidence, place, one))
                self._model = self._model.with_evidence(one, reassessed or one)
        return True

    def _drop_from_commands(self) -> bool:
        """Take back the effect that only commands asked for and need least beside the others; whether there was one."""
        stated = command_evidence(self._view, self._model.names)
        spare = [one for one in self._model.named if one.found and stated[one.effect].nats < self._options.least]
        if not spare:
            return False
        gone = min(spare, key=lambda one: stated[one.effect].nats)
        self._model = self._model.without_commanded(gone)
        self._from_commands = others(self._view, tuple(self._model.names))
        self._stages[-1] = self._weighed(self._found)
        return True

    def _unneeded(self) -> Removal | None:
        """The model without an effect that the data do not ask for any more; None where they ask for all."""
        loss, options, model = self._found.loss, self._options, self._model
        for which, one in enumerate(model.fitted):
            if self._stated(one) < options.least + options.thresholds.more(one.effect):
                return removal_of(model.problem, model.fit, loss, which, self._rounds)
        every = self._every.times if self._every is not None else 1.0
        return superfluous(model.problem, model.fit, loss, options.least / every, self._rounds, self._ticks)

    def _stated(self, one: Named) -> float:
        """Nats of a fitted effect from both views, beside what only commands show: that may have been named later."""
        if "command" not in views_of(one.effect) or len(self._model.fitted) == len(self._model.named):
            return one.nats
        fitted = nats_of(self._stages[one.stage], self._view, self._model.named, (one.effect,))
        return fitted.get(one.effect, command_evidence(self._view, self._model.names)[one.effect].nats)

    def _with_joint_evidence(self, place: int, one: Named) -> Named:
        """An effect with what speaks for it beside the others: it was found in a model that was wrong."""
        options, loss, model = self._options, self._found.loss, self._model
        names = [other for other in model.names if other != one.effect]
        rest = removal_of(model.problem, model.fit, loss, place, self._rounds)
        found = self._weighed(stage(rest.problem, rest.fit, loss, names, self._rounds, self._ticks, options.parts))
        out = (*names, *model.dropped, *model.refuted)
        best = best_of(found.evidence, found.nats, {}, options.least, options.thresholds, out)
        if best is None or best.effect != one.effect:
            return one
        self._stages.insert(len(self._stages) - 1, found)
        return replace(best, found={}, stage=len(self._stages) - 2)

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
        model, other = self._model, {**self._other, **command_evidence(self._view, self._model.names)}
        named = tuple(replace(one, found=other[one.effect].found) if one.found else one for one in model.named)
        if self._end is not None:  # only what commands show was asked since
            untried = tuple(self._time.untried)
            if named == self._end.named:
                return self._end
            return replace(self._end, named=named, other=other, dropped=model.dropped, untried=untried)
        fits, count = [*model.fits, *self._refitted_from_other_soils()], len(model.fits)
        if self._every is not None and model.fitted:
            fits = self._carried(self._every, fits)
        return Decision(
            named, self._options.least, tuple(fits[:count]), tuple(self._stages), other,
            dropped=model.dropped, refuted=model.refuted, untried=tuple(self._time.untried), beside=tuple(fits[count:]),
            searched=1.0 / self._every.times if self._every is not None else 1.0,
        )  # fmt: skip

    def _refitted_from_other_soils(self) -> list[tuple[Problem, Fit]]:
        """The model fitted beside the soils that explain the recordings about as well, if it is still that model."""
        (of, soils), problem, loss = self._soils, self._model.problem, self._model.fit.loss
        if [one.id for one in of.parameters.extensions] != [one.id for one in problem.parameters.extensions]:
            return []

        def fitted(soil: Point) -> tuple[Problem, Fit]:
            point = evaluate(problem, loss, [soil.coordinates], soil.starts)[0]
            return problem, converge(problem, point, loss, self._rounds.few)

        return side_by_side(fitted, soils, problem.workers)


def _search_name(names: Sequence[str]) -> str:
    """What a search is beside, in words; empty where it is the first one."""
    return f"beside {', '.join(name.replace('_', ' ') for name in names)}" if names else ""


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
