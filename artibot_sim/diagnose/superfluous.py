"""Effects that are not needed any more once those found after them are in the model.

What is named first may have stood for two others at once, or for a soil that a search beside them finds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from artibot_sim.diagnose.contest import Rounds, settled
from artibot_sim.diagnose.hypotheses import without_effect
from artibot_sim.identify.gauss_newton import again, evaluate
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.search import Effort, Fit, search
from artibot_sim.identify.side_by_side import side_by_side


@dataclass(frozen=True)
class Spare:
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


def superfluous(problem: Problem, fit: Fit, loss: Loss, least: float, rounds: Rounds, seed: int) -> Spare | None:
    """The model without the effect that it needs least, if that is worth less than `least` nats; None if all are.

    Of the last one this is not asked: it was found beside all the others.
    """
    earlier = range(len(problem.parameters.extensions) - 1)
    spares = side_by_side(lambda which: spared(problem, fit, loss, which, rounds, seed), earlier, problem.workers)
    found = min(spares, key=lambda one: one.nats, default=None)
    return found if found is not None and found.nats < least else None


def spared(problem: Problem, fit: Fit, loss: Loss, which: int, rounds: Rounds, seed: int) -> Spare:
    """The model without an effect: from where the fit is, or with the soil searched anew, whichever fits better."""
    part, here = without_effect(problem, fit.point, which)
    effects = here.coordinates[len(part.parameters.parameters) :]
    points = [here, search(part, Effort(seed=seed), effects=effects).point]
    begun = [evaluate(part, loss, [point.coordinates], point.starts)[0] for point in points]
    best = min((settled(part, point, loss, rounds) for point in begun), key=lambda one: one.point.cost)
    firm = again(problem, replace(loss, firm=True), fit.point).cost
    return Spare(which, part, best, 0.5 * (best.point.cost - firm))
