"""Backward elimination: effects that are not needed any more once those found after them are in the model.

What is named first may have stood for two others at once, or for a soil that a search beside them finds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.selection.joint_fits import Rounds, settled
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Effort, Fit, Tick, search
from artibot_sim.estimation.solver import Point, reassessed


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
