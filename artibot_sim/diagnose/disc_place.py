"""Where a disc of ground is, and how surely: other discs beside the fitted one, and how well they explain.

Where a disc is cannot be fitted by gradients: predictions jump as its edge comes under another wheel. So many discs
around it are tried, each with the effect's size, the soil and the starts fitted anew; of windows that a disc does not
touch the fit's normal equations tell what another soil costs. Then windows are weighted at random, as for all other
values (`uncertain`), each time the disc with the least loss is taken, and the interval holds what comes out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.patches import SMALLEST, path, touched, with_disc
from artibot_sim.identify.gauss_newton import Beside, evaluate, prior, step
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.search import Fit, settle
from artibot_sim.identify.side_by_side import side_by_side

Array = NDArray[np.float64]
Place = tuple[float, tuple[float, float]]
"""A value and its 95 % interval, m."""

_ROUNDS, _TRIED = 5, 20
"""Rounds, and discs in each."""
_SOME = 3
"""Rounds where no interval is asked for."""
_FIRST = 0.2
"""Standard deviation of the first round's centres and radii, m."""
_FARTHEST = 0.8
"""Farthest that centre and radius are moved, m."""
_BLUNT = 4.0
"""Losses over this say around which discs the next ones are drawn: wider than what is known."""
_WIDER = 1.5
_LEAST = 0.05
"""Standard deviation of what no residual shows, and of what lies between discs that were tried, m."""
_STEPS = 2
_DRAWS = 600
_ENDS = (0.025, 0.975)


@dataclass(frozen=True)
class _Apart:
    """A fit's windows, those apart that a disc may touch.

    Attributes
    ----------
    part : Problem
        Of the windows that it may touch.
    rows : list of int
        Their numbers among all.
    fit : Fit
        Of all windows.
    which : int
        The effect's place among all.
    """

    part: Problem
    rows: list[int]
    fit: Fit
    which: int

    @cached_property
    def others(self) -> NDArray[np.int64]:
        """Numbers of the other windows."""
        return np.setdiff1d(np.arange(len(self.fit.point.losses)), self.rows)

    @cached_property
    def beside(self) -> Beside:
        """What the other windows lose with another soil."""
        reduced, free = self.fit.reduced, list(self.fit.free)
        middle = self.fit.point.coordinates[free]
        return Beside(middle, reduced.gradient[self.others], reduced.matrices[self.others])

    def losses(self, place: Array) -> Array:
        """Of all windows (windows,), and last of the prior, with the disc elsewhere (3,) and all else fitted anew."""
        problem, fit = with_disc(self.part, self.which, place), self.fit
        point = evaluate(problem, fit.loss, [fit.point.coordinates], fit.point.starts[self.rows])[0]
        for _ in range(_STEPS):
            point, _, _ = step(problem, fit.loss, point, fit.free, tries=2, beside=self.beside)
        found = np.empty(len(fit.point.losses) + 1)
        found[self.rows] = point.losses
        found[self.others] = fit.point.losses[self.others] + self.beside.losses(point.coordinates[list(fit.free)])
        found[-1] = prior(problem, point.coordinates)
        return found


def disc_place(problem: Problem, fit: Fit, which: int, seed: int) -> dict[str, Place]:
    """Centre and radius (m) of the disc numbered `which` among the effects, with 95 % intervals; none for others."""
    rng = np.random.default_rng(seed)
    table, losses = _tried(problem, fit, which, rng, _ROUNDS)
    if not len(table):
        return {}
    weights = np.ones((_DRAWS, losses.shape[1]))
    weights[:, :-1] = rng.exponential(size=(_DRAWS, losses.shape[1] - 1))  # the prior stays
    drawn = table[np.argmin(weights @ losses.T, axis=1)] + rng.normal(scale=_LEAST, size=(_DRAWS, 3))
    low, high = np.quantile(drawn, _ENDS, axis=0)
    names = problem.parameters.extensions[which].search.disc
    return {
        name: (float(value), (float(a), float(b)))
        for name, value, a, b in zip(names, drawn.mean(axis=0), low, high, strict=True)
    }


def on_best_disc(problem: Problem, fit: Fit, seed: int, steps: int) -> tuple[Problem, Fit]:
    """The fit with the last effect's disc where it explains most, `steps` steps from there; others as they are.

    What is looked for next must not have to make up for a disc that lies beside its place.
    """
    which = len(problem.parameters.extensions) - 1
    table, losses = _tried(problem, fit, which, np.random.default_rng(seed), _SOME)
    if not len(table):
        return problem, fit
    moved = with_disc(problem, which, table[np.argmin(losses.sum(axis=1))])
    begun = evaluate(moved, fit.loss, [fit.point.coordinates], fit.point.starts)[0]
    found = settle(moved, begun, fit.loss, steps)
    return (moved, found) if found.point.cost < fit.point.cost else (problem, fit)


def _tried(problem: Problem, fit: Fit, which: int, rng: np.random.Generator, rounds: int) -> tuple[Array, Array]:
    """Discs (n, 3) around the fitted one, which is the first, and their losses (n, windows + 1); none for others."""
    extension = problem.parameters.extensions[which]
    here = np.array([float(extension.fixed[name]) for name in extension.search.disc])
    rows = _near(problem, here)
    if not rows:
        return np.empty((0, 3)), np.empty((0, len(problem) + 1))
    apart = _Apart(problem.part(rows), rows, fit, which)
    table, losses = here[None], apart.losses(here)[None]
    middle, width = here, np.full(3, _FIRST)
    for _ in range(rounds):
        tried = _inside(here, middle + width * rng.normal(size=(_TRIED, 3)))
        found = side_by_side(apart.losses, list(tried), problem.workers)
        table, losses = np.concatenate([table, tried]), np.concatenate([losses, found])
        total = losses.sum(axis=1)
        share = np.exp(-0.5 / _BLUNT * (total - total.min()))
        middle = np.average(table, axis=0, weights=share)
        width = _WIDER * np.sqrt(np.average((table - middle) ** 2, axis=0, weights=share))
        width = np.clip(width, _LEAST, _FIRST)
    return table, losses


def _near(problem: Problem, disc: Array) -> list[int]:
    """Windows that a disc (3,) may touch wherever it is moved; none where there is no disc."""
    if not len(disc):
        return []
    x, y, radius = disc.tolist()
    return touched([path(problem, i) for i in range(len(problem))], x, y, radius + _FARTHEST)


def _inside(here: Array, places: Array) -> Array:
    """Places (n, 3) no farther from one than they may be, their radii no smaller."""
    places = here + np.clip(places - here, -_FARTHEST, _FARTHEST)
    places[:, 2] = np.maximum(places[:, 2], SMALLEST)
    return places
