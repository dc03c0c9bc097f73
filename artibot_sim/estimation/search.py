"""The way to the best fit: from several starts with a continuous contact, then with a jump in it that grows.

Eq. 16 jumps by mu_s over mu_d where a wheel breaks away. That makes the loss jagged: steps end near where they begin.
With mu_s = mu_d nothing jumps, and fits of very different starts end close to each other. From there the jump is
opened, all else following it (continuation), until the loss is least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats.qmc import LatinHypercube

from artibot_sim.estimation.loss import Loss, spread, thinning
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.parameters import MU_S, STIFFNESS
from artibot_sim.estimation.problem import Draw, Problem
from artibot_sim.estimation.solver import Point, Reduced, best_of, evaluate, polished, reassessed, step
from artibot_sim.estimation.windows import CHANNEL_NAMES, for_starts, turned

Array = NDArray[np.float64]

SCAN = np.log1p(np.array([-0.35, -0.27, -0.2, -0.14, -0.09, -0.05, -0.025, 0.025, 0.05, 0.09, 0.14, 0.2, 0.27, 0.35]))
"""Changes of mu_s tried at every step, as logarithms: its gradient is zero almost everywhere (eq. 16 switches)."""
FINE = np.array([-0.015, -0.008, -0.004, -0.002, 0.002, 0.004, 0.008, 0.015])
"""Changes of mu_s tried near the end of a search, as logarithms."""
FOLLOWED = (-0.02, 0.02, -0.006, 0.006)
"""Changes of mu_s, as logarithms, that all else may follow before they are judged."""
JUMPS = (1.12, 1.27, 1.5, 2.0, 3.0)
"""mu_s over mu_d, after 1: how far the jump of eq. 16 is opened."""
_OPENED = 6
"""Steps at most at each place of `JUMPS`."""
_BETWEEN = 2
"""How often jumps on both sides of the best one are tried."""
_WIDE = (1, 3, 5, 8, 10, 12)
"""Places in SCAN that a coarse scan tries first."""
_CONTINUED = 3
"""Starts from which continuation begins: the robot file's values, softer and stiffer ground."""
_OTHER_STIFFNESS = 1.5
"""Widths of the prior by which softer and stiffer ground is away from the robot file's."""
_DRAWS, _STIFFNESS_DRAWS = 2.0, 3.0
"""Widths of the prior within which further starts are drawn: of the soil, and of its stiffness."""
_SCREENED = 100.0
"""s of windows at most, evenly from all, by which many starts are compared."""
_EACH = 3
"""Steps from each of many starts before the worse half of them is left out."""
_START_SPREAD = np.array([0.1, 0.1, 0.3, 0.7, 0.7, 0.7, 0.3, 1.0])
"""Sizes of random changes of a start, in its prior deviations: what a window's own samples leave open."""
_TRIES = 12
"""Random starts of a window, a third of each size."""
_DRAWN = np.array([0.1, 0.1, 0.3, 1.0, 1.0, 1.0, 1.0, 1.0])
"""Sizes of random changes around a measured start, in its prior deviations: places and headings are aligned to the
window's path anyway."""
_COARSE = 4
"""Steps between two coarse scans of mu_s."""
_TURNS = (-0.06, -0.03, -0.015, 0.015, 0.03, 0.06)
"""rad, by which a start's heading is turned for another try."""
_FOLLOWS = 12
"""Changes of mu_s at most that all else follows."""
_CLOSE = 1.15
"""An end whose loss is larger than the best one's by this factor is not gone on from."""
_SAME = 10.0
"""Ends whose losses differ by less than this are one."""
_ROUGHEST = 30.0
"""Largest inflation from which a search begins."""
_SMALL = 1.0
"""Fall of the loss, per free parameter, under which a fit has converged; in all, on the way to one."""


@dataclass(frozen=True)
class Effort:
    """How long to search.

    Attributes
    ----------
    starts : int
        The robot file's values, softer and stiffer ground, and so many less three drawn around them.
    first, finalists, last : int
        Steps at most to an end without a jump, how many different ones go on, and steps at most for those.
    scheduler : str, optional
        Address of a Dask scheduler whose workers follow continuation from one start each; the result is the same.
    """

    starts: int = 32
    first: int = 25
    finalists: int = 2
    last: int = 10
    scheduler: str | None = None

    @property
    def ticks(self) -> int:
        """How many parts of the work a search says to be done, at most."""
        return min(self.starts, _CONTINUED) + 2 * self.finalists


@dataclass(frozen=True)
class SearchReport:
    """What a search from several starts says of itself.

    Attributes
    ----------
    restarts : int
        Starts.
    finalists : int
        Searches that were carried on to the end: those that came close to the best one.
    reached : float
        Share of these that ended within 1 nat of the best.
    scatter : float
        Nats by which the worst of them ended behind the best; 0 where there is only one.
    """

    restarts: int
    finalists: int
    reached: float
    scatter: float

    @classmethod
    def of(cls, restarts: int, costs: Sequence[float]) -> SearchReport:
        """Of the finalists' costs, twice a negative log-likelihood each."""
        behind = 0.5 * (np.asarray(costs) - min(costs))
        return cls(restarts, len(costs), float(np.mean(behind <= 1.0)), float(behind.max()))


@dataclass(frozen=True)
class Fit:
    """A search's end.

    Attributes
    ----------
    point : Point
    loss : Loss
    reduced : Reduced
        Normal equations of the free parameters there.
    free : tuple of int
        Parameters that move by their gradient; mu_s, which is scanned, is none of them.
    converged : bool
    report : SearchReport or None
        Of the search from several starts that it comes from.
    others : tuple of Point
        Other ends of that search, about as good.
    """

    point: Point
    loss: Loss
    reduced: Reduced
    free: tuple[int, ...]
    converged: bool
    report: SearchReport | None = None
    others: tuple[Point, ...] = ()


Tick = Callable[[], None]
"""Called when a part of the work is done."""


def free_parameters(problem: Problem) -> tuple[int, ...]:
    """All but mu_s."""
    return tuple(i for i, key in enumerate(problem.parameters.keys) if key != MU_S)


def search(
    problem: Problem,
    effort: Effort,
    tick: Tick = lambda: None,
    effects: Array | None = None,
    loss: Loss | None = None,
) -> Fit:
    """The best fit from several starts, noise levels as they stand.

    By continuation in the jump of eq. 16, from ground as the robot file has it, softer and stiffer: this ends lowest on
    recordings of a real Husky. And by successive halving of many starts under the jump as it is, which ends lowest on
    simulated ones that the model explains badly.

    Parameters
    ----------
    problem : Problem
    effort : Effort
    tick : callable
        Called when a part of the work is done.
    effects : array, optional
        Coordinates at which effects begin, neutral ones by default.
    loss : Loss, optional
        All samples count alike by default.
    """
    loss = loss or Loss(1.0, np.ones(len(CHANNEL_NAMES)))
    guesses = first_guesses(problem, effort, effects)
    first = partial(without_jump, problem, loss=loss, steps=effort.first)
    ends = side_by_side(first, guesses[:_CONTINUED], problem.workers, tick, effort.scheduler)
    ends.sort(key=lambda point: point.cost)
    near = [end for end in ends if end.cost <= _CLOSE * ends[0].cost]
    different = [end for k, end in enumerate(near) if k == 0 or end.cost > near[k - 1].cost + _SAME]
    last = partial(_opened, problem, loss, steps=effort.last)
    finals = side_by_side(last, different[: effort.finalists], problem.workers, tick)
    which = np.searchsorted([end.cost for end in different], [end.cost for end in near], side="right") - 1
    straight = _halved(problem, loss, guesses, effort, tick)
    reached = [*(finals[k].point.cost for k in which if k < len(finals)), *(fit.point.cost for fit in straight)]
    best, *rest = sorted([*finals, *straight], key=lambda fit: fit.point.cost)
    others = [fit.point for fit in rest if best.point.cost + _SAME < fit.point.cost <= _CLOSE * best.point.cost]
    report = SearchReport.of(len(guesses), reached)
    return replace(best, report=report, others=tuple(others[: effort.finalists - 1]))


def _halved(problem: Problem, loss: Loss, guesses: Sequence[Array], effort: Effort, tick: Tick) -> list[Fit]:
    """Fits from guesses with their jump as it is, by successive halving (Jamieson and Talwalkar 2016).

    After some steps on some of the windows the better half goes on, and in the end `effort.finalists` with all windows.
    """
    some = problem.part(evenly(problem, _SCREENED))
    points = evaluate(some, loss, guesses, some.starts)
    while len(points) > effort.finalists:
        points = side_by_side(partial(_some_steps, some, loss), points, problem.workers)
        points = sorted(points, key=lambda point: point.cost)[: max(effort.finalists, len(points) // 2)]
    begun = evaluate(problem, loss, [point.coordinates for point in points], problem.starts)
    return side_by_side(lambda point: converge(problem, point, loss, effort.first), begun, problem.workers, tick)


def _some_steps(problem: Problem, loss: Loss, point: Point) -> Point:
    """The point after a scan of mu_s and a few steps of all else."""
    free, damping = free_parameters(problem), 1e-3
    point = coarse_to_fine_scan(problem, loss, point)
    for _ in range(_EACH):
        point, _, damping = step(problem, loss, point, free, damping)
    return point


def evenly(problem: Problem, most: float) -> list[int]:
    """Windows of `most` s at most, evenly from all."""
    return list(range(0, len(problem), max(1, -int(-problem.durations.sum() // most))))


def first_guesses(problem: Problem, effort: Effort, effects: Array | None = None) -> list[Array]:
    """Coordinates to start from: the robot file's values, softer and stiffer ground, and other ones; the rest as given.

    Grounds of very different stiffness and friction explain a path nearly alike, and from one of them steps seldom lead
    to another.
    """
    parameters = problem.parameters
    own = parameters.keys[: len(parameters.parameters)]
    draws = LatinHypercube(len(own), seed=problem.generator(Draw.FIRST_GUESSES))
    drawn = 2.0 * draws.random(max(effort.starts - _CONTINUED, 0)) - 1.0
    stiffness = [i for i, key in enumerate(own) if key in STIFFNESS]
    drawn[:, stiffness[1:]] = drawn[:, stiffness[:1]]  # along and across wheels it is much the same
    widths = np.array([_DRAWS * key.startswith("contact.") for key in own])
    widths[stiffness] = _STIFFNESS_DRAWS
    other = np.zeros((_CONTINUED, len(own)))
    other[1, stiffness], other[2, stiffness] = -_OTHER_STIFFNESS, _OTHER_STIFFNESS
    moves = np.concatenate([other, widths * drawn])[: effort.starts] * parameters.spread[: len(own)]
    return [parameters.inside(parameters.coordinates(parameters.at(move), effects)) for move in moves]


def without_jump(problem: Problem, coordinates: Array, loss: Loss, steps: int) -> Point:
    """The best place without a jump; an inflation with which most windows fit falls by thirds.

    Parameters
    ----------
    problem : Problem
    coordinates : array, shape (p,)
        Where to begin.
    loss : Loss
    steps : int
        At most.
    """
    smooth = _with_jump(problem, 1.0)
    begin = smooth.parameters.inside(coordinates)
    inflation = min(spread(problem.windows, smooth.residuals([begin], problem.starts)[0]), _ROUGHEST)
    rough = replace(loss, inflation=inflation)
    point = evaluate(smooth, rough, [begin], problem.starts)[0]
    return reassessed(smooth, loss, _down(smooth, rough, point, steps))


def _with_jump(problem: Problem, jump: float) -> Problem:
    """The problem with mu_s that is `jump` times mu_d."""
    return problem.with_parameters(replace(problem.parameters, jump=jump))


def _down(problem: Problem, loss: Loss, point: Point, steps: int) -> Point:
    """Steps of all that has a gradient, until they gain little; the loss's inflation falls to 1 on the way."""
    free, damping = free_parameters(problem), 1e-3
    for _ in range(steps):
        before = point.cost
        point, _, damping = step(problem, loss, point, free, damping)
        if loss.inflation > 1.0:
            loss = replace(loss, inflation=max(1.0, loss.inflation / 1.5))
            point = reassessed(problem, loss, point)
        elif before - point.cost < _SMALL:
            break
    return point


def continued(problem: Problem, loss: Loss, coordinates: Array, effort: Effort) -> Fit:
    """The best fit that continuation leads to from some coordinates: without a jump first, then with one that grows."""
    return _opened(problem, loss, without_jump(problem, coordinates, loss, effort.first), effort.last)


def jump_opened(problem: Problem, loss: Loss, point: Point) -> Point:
    """The best place as the jump of eq. 16 grows from none, all else following; mu_s has its own coordinate again.

    Parameters
    ----------
    problem : Problem
    loss : Loss
    point : Point
        The best place without a jump.
    """
    parameters = problem.parameters
    if parameters.index(MU_S) is None:
        return point
    places = {1.0: point}

    def add(jump: float, begin: Point) -> Point:
        held = _with_jump(problem, jump)
        moved = held.parameters.inside(begin.coordinates)
        places[jump] = _down(held, loss, evaluate(held, loss, [moved], begin.starts)[0], _OPENED)
        return places[jump]

    here = point
    for jump in JUMPS:
        here = add(jump, here)
    for _ in range(_BETWEEN):
        jumps = sorted(places)
        k = min(range(len(jumps)), key=lambda k: places[jumps[k]].cost)
        for beside in (jumps[j] for j in (k - 1, k + 1) if 0 <= j < len(jumps)):
            add(float(np.sqrt(jumps[k] * beside)), places[jumps[k]])
    best = min(places.values(), key=lambda place: place.cost)
    return evaluate(problem, loss, [parameters.inside(best.coordinates)], best.starts)[0]


def _opened(problem: Problem, loss: Loss, point: Point, steps: int) -> Fit:
    """The best fit with a jump, from one without: the jump grows, all else follows, and at last it is free."""
    return converge(problem, jump_opened(problem, loss, point), loss, steps)


def converge(problem: Problem, point: Point, loss: Loss, steps: int) -> Fit:
    """Steps until nothing is gained any more, mu_s scanned coarsely and finely in turn."""
    free = free_parameters(problem)
    point = reassessed(problem, loss, point)
    damping, reduced, converged, quiet = 1e-3, None, False, 0
    for k in range(steps):
        before = point.cost
        point = scan(problem, loss, point, SCAN if k % _COARSE == 0 else FINE)
        point = restarted_windows(problem, loss, point, k) if k % _COARSE == 1 else point
        point, reduced, damping = step(problem, loss, point, free, damping)
        quiet = quiet + 1 if before - point.cost < _SMALL * max(len(free), 1) else 0
        converged = quiet >= 2
        if converged:
            break
    assert reduced is not None
    return Fit(point, loss, reduced, free, converged)


def scan(problem: Problem, loss: Loss, point: Point, changes: Array) -> Point:
    """The best of the same point with other mu_s."""
    points = _at_other_mu_s(problem, loss, point, changes)
    return min([point, *points], key=lambda p: p.cost)


def coarse_to_fine_scan(problem: Problem, loss: Loss, point: Point) -> Point:
    """Scan mu_s at every other place of SCAN, then beside the best one: mostly the same end for half the work."""
    tried = dict(zip(_WIDE, _at_other_mu_s(problem, loss, point, SCAN[list(_WIDE)]), strict=False))
    if not tried:
        return point
    least = min(tried, key=lambda k: tried[k].cost)
    middle = len(SCAN) // 2
    near = (least - 1, least + 1) if tried[least].cost < point.cost else (middle - 1, middle)
    more = _at_other_mu_s(problem, loss, point, SCAN[[k for k in near if 0 <= k < len(SCAN) and k not in tried]])
    return min([point, *tried.values(), *more], key=lambda p: p.cost)


def followed_scan(problem: Problem, loss: Loss, point: Point, free: Sequence[int]) -> Point:
    """The point with other mu_s, each judged after two steps of all else, until no change gains.

    When a wheel breaks away depends on its load and its force as well as on mu_s. Changed alone, any of these makes it
    do so at another instant than measured, and the loss rises on both sides at once, as from the bottom of a V. Where
    they change together, as a load and mu_s do, the bottom of the V falls on, and no scan of mu_s by itself sees it.

    A change that gains is taken and made again, until it gains no more.
    """
    if problem.parameters.index(MU_S) is None:
        return point
    change, in_vain = 0, 0
    for _ in range(_FOLLOWS):
        (changed,) = _at_other_mu_s(problem, loss, point, [FOLLOWED[change]])
        end = _follows(problem, loss, changed, free)
        if end.cost < point.cost - _SMALL * max(len(free), 1):
            point, in_vain = end, 0
            continue
        change, in_vain = (change + 1) % len(FOLLOWED), in_vain + 1
        if in_vain == len(FOLLOWED):
            break
    return point


def _follows(problem: Problem, loss: Loss, point: Point, free: Sequence[int]) -> Point:
    damping = 1e-3
    for _ in range(2):
        point, _, damping = step(problem, loss, point, free, damping)
    return point


def _at_other_mu_s(problem: Problem, loss: Loss, point: Point, changes: Sequence[float] | Array) -> list[Point]:
    """The point with other mu_s, none where it is not fitted."""
    i = problem.parameters.index(MU_S)
    if i is None:
        return []
    candidates = []
    for change in changes:
        coordinates = point.coordinates.copy()
        coordinates[i] += change
        candidates.append(problem.parameters.inside(coordinates))
    return evaluate(problem, loss, candidates, point.starts)


def restarted_windows(problem: Problem, loss: Loss, point: Point, number: int = 0) -> Point:
    """Every window tries other starts: as measured, as the window before predicts, and with other headings.

    A start on the wrong branch of eq. 16 (a wheel holds that should slide) is a local optimum; mostly its heading is
    to blame, for the side slip is what is left between heading and velocity. Windows that are explained worst try
    random ones as well.
    """
    turns = [turned(point.starts, angle) for angle in _TURNS]
    new = best_of(problem, loss, point.coordinates, [point.starts, problem.starts, *turns])
    new = polished(problem, loss, new, problem.carried(point.coordinates, point.starts))
    new = randomized_starts(problem, loss, new, number)
    return new if new.cost < point.cost else point


def randomized_starts(problem: Problem, loss: Loss, point: Point, number: int = 0) -> Point:
    """The windows that are explained worst try random starts around theirs, in three sizes, the best one polished.

    With effects in the fit around the measured one as well: a start that made up for what the model lacked is far from
    that, and on a branch of its own once the model has it.
    """
    size = np.array([len(window) for window in problem.windows])
    poor = point.losses / size
    worst = np.flatnonzero(poor > 1.08 * np.median(poor))
    worst = worst[np.argsort(-poor[worst])][: max(2, len(poor) // 6)]
    if not len(worst):
        return point
    rng = problem.generator(Draw.STARTS, number)
    some = problem.part(worst.tolist())
    scale = np.tile([0.15, 0.4, 1.0], _TRIES // 3)[:, None, None]
    moves = rng.normal(size=(_TRIES, len(worst), problem.size)) * problem.start_sd[worst] * scale
    starts = point.starts[worst] + moves * for_starts(_START_SPREAD, problem.size)
    if problem.parameters.extensions:
        anew = rng.normal(size=(2 * _TRIES, len(worst), problem.size)) * problem.start_sd[worst]
        anew *= for_starts(_DRAWN, problem.size)
        anew *= np.tile([0.5, 1.0], _TRIES)[:, None, None]
        starts = np.concatenate([starts, problem.starts[worst] + anew])
    tried = best_of(some, loss, point.coordinates, list(starts))
    kept = some.parts(np.concatenate([point.residuals[k] for k in worst.tolist()]))
    mine = Point(point.coordinates, point.starts[worst], kept, point.losses[worst], 0.0)
    best = polished(some, loss, mine, tried.starts)
    starts, losses, flat = point.starts.copy(), point.losses.copy(), point.residuals.flat.copy()
    starts[worst], losses[worst] = best.starts, best.losses
    residuals = problem.parts(flat)
    for i, k in enumerate(worst.tolist()):
        residuals[k][:] = best.residuals[i]
    cost = point.cost + float(losses.sum() - point.losses.sum())
    return replace(point, starts=starts, losses=losses, residuals=residuals, cost=cost)


def thinned(problem: Problem, fit: Fit) -> Loss:
    """The loss in which samples that err alike count as fewer."""
    return Loss(1.0, thinning(problem.windows, fit.point.residuals))
