"""The model as a stepwise selection has it: what is named, and its fits with none of that, with one effect, …"""

from __future__ import annotations

from dataclasses import dataclass, replace

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.selection.decision import FittedEffects, Named
from artibot_sim.diagnose.selection.elimination import Removal
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge


@dataclass(frozen=True)
class SelectedModel(FittedEffects):
    """The paper's model with the effects that are named so far.

    Attributes
    ----------
    fits : tuple of (Problem, Fit)
        With none of the `fitted` effects, with the first of them, the first two, …, and with all.
    named : tuple of Named
        In the order in which they were found.
    dropped, refuted : tuple of str
        Effects taken back: those not needed beside later ones, and those that held-out recordings speak against.
    """

    fits: tuple[tuple[Problem, Fit], ...]
    named: tuple[Named, ...] = ()
    dropped: tuple[str, ...] = ()
    refuted: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Effects that are named."""
        return [one.effect for one in self.named]

    @property
    def out(self) -> tuple[str, ...]:
        """What is not named any more: it is already, or was taken back."""
        return (*self.names, *self.dropped, *self.refuted)

    def refitted(self, problem: Problem, fit: Fit) -> SelectedModel:
        """With another fit of the same effects."""
        return replace(self, fits=(*self.fits[:-1], (problem, fit)))

    def naming(self, one: Named) -> SelectedModel:
        """With one more effect, which only commands show: it is no part of a fit."""
        return replace(self, named=(*self.named, one))

    def growing(self, one: Named, problem: Problem, fit: Fit) -> SelectedModel:
        """With one more effect as it was fitted."""
        return replace(self.naming(one), fits=(*self.fits, (problem, fit)))

    def with_evidence(self, old: Named, new: Named) -> SelectedModel:
        """With other evidence of the same effect."""
        return replace(self, named=tuple(new if one is old else one for one in self.named))

    def without_commanded(self, gone: Named) -> SelectedModel:
        """Without an effect that only commands show."""
        return replace(self, named=self._but(gone), dropped=(*self.dropped, gone.effect))

    def without(self, spare: Removal, loss: Loss, steps: int) -> SelectedModel:
        """Without a fitted effect that those after it make up for; these are fitted without it by so many steps."""
        gone, count = self.fitted[spare.which], len(self.fitted) - 1
        between = list[tuple[Problem, Fit]]()
        problem, fit = spare.problem, spare.fit
        for last in range(count - 1, spare.which, -1):
            problem, point = without_effect(problem, loss, fit.point, last)
            fit = converge(problem, point, loss, steps)
            between.insert(0, (problem, fit))
        before = self.fits[: min(spare.which + 1, count)]
        fits = (*before, *between, (spare.problem, spare.fit))
        return SelectedModel(fits, self._but(gone), (*self.dropped, gone.effect), self.refuted)

    def without_last(self) -> SelectedModel:
        """Without the last of the fitted effects, which held-out recordings speak against."""
        gone = self.fitted[-1]
        return SelectedModel(self.fits[:-1], self._but(gone), self.dropped, (*self.refuted, gone.effect))

    def _but(self, gone: Named) -> tuple[Named, ...]:
        return tuple(one for one in self.named if one is not gone)
