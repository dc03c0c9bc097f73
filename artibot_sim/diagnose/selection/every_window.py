"""Evidence counted over every window of long recordings, of which searches fit some in turn.

What an effect gains grows with the windows. A search among some of them finds the right sizes, but an effect that
gains a little in each window would be asked for the same nats with a quarter of the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.selection.evidence import Evidence, evidence
from artibot_sim.diagnose.selection.joint_fits import Rival, Rounds, adopted, contained, excess_of, with_soil_of
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge, restarted_windows
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EveryWindow:
    """All windows of the recordings, some of which are searched.

    Attributes
    ----------
    problem : Problem
        With all of them; noise as the sensors have it.
    rows : sequence of int
        Those that are searched, in the order in which the search has them.
    """

    problem: Problem
    rows: Sequence[int]

    @property
    def times(self) -> float:
        """How many windows there are for one that is searched."""
        return len(self.problem) / len(self.rows)

    def chance(self, losses: Array) -> float:
        """Standard deviation, nats, of a sum over the searched windows for which of all windows these are.

        Parameters
        ----------
        losses : array, shape (searched windows,)
            Losses (twice the nats) of one model less those of another.
        """
        share = len(self.rows) / len(self.problem)
        return 0.5 * float(np.std(losses)) * ((1.0 - share) * len(losses)) ** 0.5

    def carried(self, part: Problem, fit: Fit, steps: int) -> tuple[Problem, Fit]:
        """A fit of the searched windows as one of all, some steps further; noise is what it is there."""
        levels = np.ones(len(CHANNEL_NAMES))
        for mine, row in zip(part.windows, self.rows, strict=True):
            there = self.problem.windows[row]
            levels[there.channel] = mine.sigma / there.sigma
        every = self.problem.with_parameters(part.parameters).rescaled(levels)
        starts = every.starts.copy()
        starts[list(self.rows)] = fit.point.starts
        point = evaluate(every, fit.loss, [fit.point.coordinates], starts)[0]
        return every, converge(every, restarted_windows(every, fit.loss, point), fit.loss, steps)

    def evidence(
        self, part: Problem, fit: Fit, rivals: Sequence[Rival], named: int, rounds: Rounds
    ) -> tuple[list[Evidence], tuple[Problem, Fit]]:
        """The evidence of effects that were fitted to the searched windows, over all of them; and the baseline there.

        The baseline is fitted from each effect's soil and starts as well, and each takes over starts from the other,
        as in the search: only what an effect itself adds is its evidence. What fits the searched windows by chance
        begins again at neutral where all windows are explained worse with it.

        Parameters
        ----------
        part, fit : Problem, Fit
            The search's baseline.
        rivals : sequence of Rival
            Fitted under the same loss.
        named : int
            Effects that are in the baseline.
        """
        workers = part.workers
        begun = [(part, fit), *((rival.problem, rival.fit) for rival in rivals)]
        (every, best), *fits = side_by_side(lambda one: self.carried(*one, rounds.many), begun, workers)

        def neutral(one: tuple[Problem, Fit]) -> Fit:
            return converge(*without_effect(one[0], best.loss, one[1].point), best.loss, rounds.few)

        best = min([best, *side_by_side(neutral, fits, workers)], key=lambda one: one.point.cost)
        found = [
            replace(rival, trial=replace(rival.trial, problem=problem), fit=adopted(problem, own, every, best, rounds))
            for rival, (problem, own) in zip(rivals, fits, strict=True)
        ]
        least = min(found, key=lambda rival: rival.fit.point.cost)
        found = side_by_side(lambda rival: with_soil_of(least, rival, rounds), found, workers)
        least = min(found, key=lambda rival: rival.fit.point.cost)
        best = adopted(every, best, least.problem, least.fit, rounds)
        found = side_by_side(lambda rival: contained(rival, best, rounds), found, workers)
        excess = excess_of(every, best, found, number=named)
        stated = side_by_side(
            lambda one: evidence(one[0], best, one[1]), list(zip(found, excess, strict=True)), workers
        )
        return stated, (every, best)
