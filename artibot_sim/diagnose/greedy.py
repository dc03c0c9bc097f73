"""One effect after the other: the best is added to the model until none is worth it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from artibot_sim.diagnose.contest import Rival, Rounds, contest, neutralised
from artibot_sim.diagnose.evidence import Evidence, evidence
from artibot_sim.diagnose.hypotheses import hypotheses
from artibot_sim.diagnose.screen import Trial, around, screen
from artibot_sim.diagnose.thresholds import Thresholds
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.search import Fit

Tick = Callable[[], None]


@dataclass(frozen=True)
class Turn:
    """One search for one more effect.

    Attributes
    ----------
    trials : tuple of Trial
        Every hypothesis as the screen left it.
    rivals : tuple of Rival
        Those that were fitted, the best first.
    evidence : mapping of str to Evidence
        Of the rivals, by effect.
    problem : Problem
        The baseline of this turn.
    fit : Fit
        The baseline, fitted as hard as any rival.
    """

    trials: tuple[Trial, ...]
    rivals: tuple[Rival, ...]
    evidence: Mapping[str, Evidence]
    problem: Problem
    fit: Fit

    def nats(self, effect: str, other: Mapping[str, float]) -> float:
        """Log Bayes factor of an effect, with what the other view says."""
        mine = self.evidence[effect].nats if effect in self.evidence else 0.0
        return mine + other.get(effect, 0.0)


def turn(
    problem: Problem, fit: Fit, loss: Loss, named: Sequence[str], rounds: Rounds, tick: Tick = lambda: None
) -> Turn:
    """Look for one more effect beside those in `problem`.

    The baseline is fitted again from the best rivals' soil and starts: what they found there without their effect
    is none of its evidence.
    """
    base = around(problem, loss, fit.point)
    trials = screen(base, hypotheses(problem.parameters.robot, problem.stretches, named), tick)
    rivals = contest(trials, loss, rounds, tick)
    best = replace(fit, point=min(fit.point, base.point, key=lambda point: point.cost))
    for rival in rivals[: rounds.returns]:
        again = neutralised(rival, loss, rounds.many)
        best = again if again.point.cost < best.point.cost else best
        tick()
    found = {rival.id: evidence(rival, best.point.cost, loss) for rival in rivals}
    return Turn(tuple(trials), tuple(rivals), found, problem, best)


def acceptable(found: Evidence, nats: float, least: float, thresholds: Thresholds) -> bool:
    """Whether an effect is named."""
    size = float(np.abs(found.own).max())
    return nats >= least and found.away >= thresholds.away and size >= thresholds.size
