"""The promising effects fitted jointly with the soil, in rounds of growing effort; the baseline gets as much."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.hypotheses import without_last
from artibot_sim.diagnose.screen import Trial
from artibot_sim.identify.gauss_newton import Point, again, evaluate, step
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.search import SCAN, Fit, awake, free_parameters, scan, settle

Array = NDArray[np.float64]
Tick = Callable[[], None]


@dataclass(frozen=True)
class Rounds:
    """How many effects go on from round to round, and with how many steps.

    Attributes
    ----------
    first, second, last : int
        Effects that are fitted by two steps, by a few, and to the end.
    returns : int
        Fits from whose soil and starts the baseline is fitted again.
    few, many : int
        Steps.
    """

    first: int = 12
    second: int = 6
    last: int = 4
    returns: int = 2
    few: int = 3
    many: int = 8


@dataclass(frozen=True)
class Rival:
    """A hypothesis fitted with the soil.

    Attributes
    ----------
    trial : Trial
    fit : Fit
    """

    trial: Trial
    fit: Fit

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.trial.id

    @property
    def problem(self) -> Problem:
        """The baseline's with the effect."""
        return self.trial.problem

    @property
    def own(self) -> Array:
        """The effect's coordinates."""
        return self.fit.point.coordinates[-len(self.trial.hypothesis.extension) :]


def contest(trials: Sequence[Trial], loss: Loss, rounds: Rounds, tick: Tick = lambda: None) -> list[Rival]:
    """The best hypotheses, each fitted with the soil and the starts; the least cost first.

    Parameters
    ----------
    trials : sequence of Trial
        One for each hypothesis.
    loss : Loss
        The baseline's.
    rounds : Rounds
    """
    first = sorted(trials, key=lambda t: t.point.cost)[: rounds.first]
    second = []
    for trial in first:
        second.append(replace(trial, point=_begun(trial, loss)))
        tick()
    second.sort(key=lambda t: t.point.cost)
    third = []
    for trial in _one_each(second)[: rounds.second]:
        third.append(Rival(trial, settle(trial.problem, trial.point, loss, rounds.few)))
        tick()
    third.sort(key=lambda rival: rival.fit.point.cost)
    last = []
    for rival in third[: rounds.last]:
        last.append(replace(rival, fit=settled(rival.problem, rival.fit.point, loss, rounds.many)))
        tick()
    return sorted(last, key=lambda rival: rival.fit.point.cost)


def _one_each(trials: Sequence[Trial]) -> list[Trial]:
    """The best hypothesis of every effect, in the order given."""
    seen: set[str] = set()
    return [trial for trial in trials if not (trial.id in seen or seen.add(trial.id))]  # type: ignore[func-returns-value]


def _begun(trial: Trial, loss: Loss) -> Point:
    """Two steps of everything, mu_s scanned before each."""
    problem, point = trial.problem, trial.point
    free, damping = free_parameters(problem), 1e-3
    for _ in range(2):
        point = scan(problem, loss, point, SCAN)
        point, _, damping = step(problem, loss, point, free, damping)
    return point


def settled(problem: Problem, point: Point, loss: Loss, steps: int) -> Fit:
    """A fit to the end: starts may change their branch, mu_s is scanned finely and coarsely."""
    point = awake(problem, loss, again(problem, loss, point))
    return settle(problem, point, loss, steps)


def neutralised(rival: Rival, loss: Loss, steps: int) -> Fit:
    """The baseline fitted from a rival's soil and starts, the rival's effect left out."""
    problem = without_last(rival.problem)
    size = len(rival.trial.hypothesis.extension)
    point = rival.fit.point
    begin = evaluate(problem, loss, [problem.parameters.inside(point.coordinates[:-size])], point.starts)[0]
    return settled(problem, begin, loss, steps)
