"""Which effects are named: greedy turns, ties and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from artibot_sim.diagnose.contest import Rounds
from artibot_sim.diagnose.diagnosis import Verdict
from artibot_sim.diagnose.greedy import Turn, acceptable, turn
from artibot_sim.diagnose.thresholds import Thresholds
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.search import Fit
from artibot_sim.model.effects import EFFECTS

if TYPE_CHECKING:
    from artibot_sim.diagnose.run import Options

Tick = Callable[[], None]


@dataclass(frozen=True)
class Named:
    """An effect that the data speak for.

    Attributes
    ----------
    effect : str
    nats : float
        Log Bayes factor against the model without it, both views together.
    ties : tuple of str
        Effects that explain as much.
    """

    effect: str
    nats: float
    ties: tuple[str, ...]


@dataclass(frozen=True)
class Decision:
    """What was decided, and from what.

    Attributes
    ----------
    verdict : Verdict
    named : tuple of Named
        In the order in which they were found.
    least : float
        Nats that an effect had to gain.
    neutral_problem, neutral_fit : Problem, Fit
        The paper's model with its soil identified.
    problem, fit : Problem, Fit
        With all named effects.
    turns : tuple of Turn
    """

    verdict: Verdict
    named: tuple[Named, ...]
    least: float
    neutral_problem: Problem
    neutral_fit: Fit
    problem: Problem
    fit: Fit
    turns: tuple[Turn, ...]


def decide(
    problem: Problem, fit: Fit, options: Options, tick: Tick, other: Mapping[str, float] | None = None
) -> Decision:
    """Add the best effect to the model as long as the data ask for one.

    Parameters
    ----------
    problem, fit : Problem, Fit
        The baseline.
    options : Options
    tick : callable
    other : mapping of str to float, optional
        Nats that the view driven by commands gives to effects.
    """
    thresholds = options.thresholds
    least = thresholds.least(options.prior_odds, options.false_alarm_rate, len(EFFECTS))
    turns: list[Turn] = []
    named: list[Named] = []
    neutral = (problem, fit)
    for _ in range(thresholds.most):
        found = turn(problem, fit, fit.loss, [n.effect for n in named], Rounds(), tick)
        turns.append(found)
        fit = found.fit
        if not named:
            neutral = (problem, fit)
        best = _best(found, other or {}, least, thresholds)
        if best is None:
            break
        named.append(best)
        winner = next(rival for rival in found.rivals if rival.id == best.effect)
        problem, fit = winner.problem, winner.fit
    verdict = Verdict.NONE
    if named:
        verdict = Verdict.AMBIGUOUS if named[0].ties else Verdict.NAMED
    return Decision(verdict, tuple(named), least, *neutral, problem, fit, tuple(turns))


def _best(found: Turn, other: Mapping[str, float], least: float, thresholds: Thresholds) -> Named | None:
    """The effect with the most evidence, if it is enough, and those that tie with it."""
    nats = {rival.id: found.nats(rival.id, other) for rival in found.rivals}
    good = {
        effect: value for effect, value in nats.items() if acceptable(found.evidence[effect], value, least, thresholds)
    }
    if not good:
        return None
    best = max(good, key=lambda effect: good[effect])
    margin = max(thresholds.tie, thresholds.tie_share * good[best])
    ties = sorted((e for e in good if e != best and good[e] >= good[best] - margin), key=lambda e: -good[e])
    return Named(best, good[best], tuple(ties))


def refitted(decision: Decision, fit: Fit) -> Decision:
    """The same decision with another fit of the named effects."""
    return replace(decision, fit=fit)
