"""Backward elimination: effects that are not needed any more once those found after them are in the model.

What is named first may have stood for two others at once, or for a soil that a search beside them finds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.selection.joint_fits import Rounds, settled
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Effort, Fit, Tick, search
from artibot_sim.estimation.solver import Point, reassessed

_BESIDE = Effort(starts=3)
"""A search beside effects: continuation from ground as the robot file has it, softer and stiffer. 29 more starts, as
for the baseline, take as long again, and ended 0.2 nats at most below the better of this end and the fit at hand (four
real recordings, six simulated Huskies)."""


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

    Which one that is fits from the present soil tell; beside a soil searched anew only that one is asked for. Of the
    last effect nothing is asked: it was found beside all the others.
    """
    earlier = range(len(problem.parameters.extensions) - 1)
    without = partial(_from_present_soil, problem, fit, loss, rounds=rounds)
    removals = side_by_side(without, earlier, problem.workers, tick)
    if not removals:
        return None
    found = _beside_another_soil(min(removals, key=lambda one: one.nats), loss, rounds)
    return found if found.nats < least else None


def removal_of(problem: Problem, fit: Fit, loss: Loss, which: int, rounds: Rounds) -> Removal:
    """The model without an effect: from where the fit is, or with the soil searched anew, whichever fits better."""
    return _beside_another_soil(_from_present_soil(problem, fit, loss, which, rounds), loss, rounds)


def _from_present_soil(problem: Problem, fit: Fit, loss: Loss, which: int, rounds: Rounds) -> Removal:
    """The model without an effect, fitted from where it is with it."""
    part, here = without_effect(problem, loss, fit.point, which)
    rest = settled(part, here, loss, rounds)
    firm = reassessed(problem, replace(loss, firm=True), fit.point).cost
    return Removal(which, part, rest, 0.5 * (rest.point.cost - firm))


def _beside_another_soil(removal: Removal, loss: Loss, rounds: Rounds) -> Removal:
    """The same with a soil that is searched anew, if that fits better."""
    fit = with_soil_searched(removal.problem, removal.fit.point, loss, rounds)
    gained = 0.5 * (removal.fit.point.cost - fit.point.cost)
    return replace(removal, fit=fit, nats=removal.nats - gained) if gained > 0.0 else removal


def with_soil_searched(problem: Problem, point: Point, loss: Loss, rounds: Rounds) -> Fit:
    """A fit whose soil is searched from several starts, effects as they are at `point`; at last all of it is free.

    A soil that was found without an effect makes up for it as far as it can. From there steps seldom lead to the one
    that is right beside it, and what else is missing hides behind the wrong one.
    """
    effects = point.coordinates[len(problem.parameters.parameters) :]
    return settled(problem, search(problem, _BESIDE, effects=effects, loss=loss).point, loss, rounds)
