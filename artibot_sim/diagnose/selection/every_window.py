"""Evidence counted over every window of long recordings, of which searches fit some in turn.

What an effect gains grows with the windows. A search among some of them finds the right sizes, but an effect that
gains a little in each window would be asked for the same nats with a quarter of the data.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.policy import TRUST
from artibot_sim.diagnose.records import HALF_WIDTH, Options
from artibot_sim.diagnose.selection.decision import Named
from artibot_sim.diagnose.selection.evidence import Evidence, evidence
from artibot_sim.diagnose.selection.forward import SearchStage
from artibot_sim.diagnose.selection.joint_fits import Rival, Rounds, adopted, contained, excess_of, with_soil_of
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.parameters import SOIL
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Effort, Fit, Tick, converge, restarted_windows
from artibot_sim.estimation.solver import evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.run import best_fit
from artibot_sim.model import Robot

Array = NDArray[np.float64]

ENOUGH = 240.0
"""s of windows that are searched, about. All count for what is held out, for evidence that is too little in the
searched ones, and for the sizes of what is named. Of a Husky's 266 s 90 s named nothing, and all of them a wheel
resistance and a lever arm, with which held-out positions were missed by 0.170 m instead of 0.268."""
LEAST = 45.0
"""s of windows that are searched whatever the time, about: fewer (8 windows of 2 s of a Husky) showed forces on no list
where all of them name a lever arm."""
SEARCH, END = 10_000, 600
"""Predictions of every searched window that the baseline and one search for an effect take, and of every window that
intervals and predictions take after that, about: 6000 to 10 000 (Husky, 2 s; Agri.q, 5 s), and 400 to 600."""
COMMANDS = 5.0
"""Times that the first command view takes, in which it is asked for evidence and others are made, about (Husky)."""
_SAMPLING = 2.0
"""Standard deviations by which the windows that are searched may differ from all."""
_PILOT = 3
"""Predictions by which their time is measured."""


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

    def soil(self, tick: Tick = lambda: None) -> tuple[Problem, Fit]:
        """The paper's model with its soil identified from the searched windows.

        All of them keep their say, for local effects hide in bad ones.
        """
        return best_fit(self.problem.part(self.rows), Effort(), tick, TRUST)

    def sampling_sd(self, losses: Array) -> float:
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
        as in the search: only what an effect itself adds is its evidence. An effect that fits the searched windows by
        chance begins again at neutral where all windows are explained worse with it.

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


def rivals_for_every_window(
    every: EveryWindow, found: SearchStage, best: Named | None, out: Collection[str], options: Options
) -> list[Rival]:
    """Rivals for the evidence of all windows, the most promising ones first.

    That is asked of the `best` one by the searched windows, of those that tie with it, and of those that may: where
    other windows may make up for what they are behind. Without a best one it is asked of all that would gain enough
    if they gained as much in every window.

    Parameters
    ----------
    found : SearchStage
        Of the searched windows.
    best : Named or None
        The best effect by these, if one gains enough.
    out : collection of str
        Effects that are not named any more.
    """
    least, thresholds = options.least, options.thresholds
    rivals = sorted((one for one in found.rivals if one.id not in out), key=lambda one: -found.nats[one.id])
    if best is None:
        return [one for one in rivals if every.times * found.nats[one.id] >= least + thresholds.more(one.id)]
    first = next((one for one in rivals if one.id == best.effect), None)
    if first is None:
        return []

    def may_tie(one: Rival) -> bool:
        losses = one.fit.point.losses - first.fit.point.losses
        behind = found.nats[first.id] - found.nats[one.id]
        return behind <= thresholds.tie + _SAMPLING * every.sampling_sd(losses)

    return [first, *(one for one in rivals if one is not first and (one.id in best.ties or may_tie(one)))]


def every_window(fitted: Sequence[Experiment], robot: Robot, options: Options) -> EveryWindow:
    """All windows of recordings, and those in turn that are searched where all are more than that takes."""
    problem = problem_of(fitted, parameter_set(robot, SOIL), options.horizon, options.workers, HALF_WIDTH, options.seed)
    step = max(1, round(float(problem.durations.sum()) / ENOUGH))
    return EveryWindow(problem, range(0, len(problem), step))


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
        after_search = COMMANDS * view_took + END * took
        seconds = max(0.0, options.left - after_search) / (SEARCH * took) * total
        step = max(round(every.times), round(total / max(seconds, 1e-3)))
        return max(1, min(step, int(total / LEAST))), after_search

    step, after_search = options.parts.once("windows that there is time for", searched)
    return replace(every, rows=range(0, len(every.problem), step)), replace(options, after_search=after_search)
