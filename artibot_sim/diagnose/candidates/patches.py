"""Discs of ground on which something differs: candidates, their screening, and how surely one is where it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis, with_effect
from artibot_sim.diagnose.candidates.screening import Around, Trial, small_probes
from artibot_sim.diagnose.sizes import scale_of
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem, Sensitivity
from artibot_sim.estimation.search import Fit, converge
from artibot_sim.estimation.solver import FrozenWindows, Point, assess, evaluate, prior, reduce, step
from artibot_sim.model.effects import EFFECTS

# ----------------------------------------------------------------------
# Discs of ground on which something differs: candidates along the paths of badly explained windows.
# ----------------------------------------------------------------------


Indices = NDArray[np.int64]

SPACING = 0.7
"""m between centres of candidates; all lengths here are Agri.q's, and those of others as their track is (`length`)."""
RADII = (1.2, 2.0)
"""m of candidates."""
SMALLEST = 0.3
"""m: radius of the smallest disc that is tried."""
_REACH = 1.6
"""m beyond a disc's radius, from the front module's origin, at which its wheels still touch it."""
_BAD = 1.15
"""Loss of a window over the median one's, per sample, from which its path is looked at."""
_MOST = 60
"""Candidates at most for centres, the worst explained first."""
_KEPT = 6
"""Discs that are kept of those tried."""
_AT_ONCE = 200
"""Windows that are simulated together."""
_SMALL = 0.3
"""Coordinate of the discs that show how well one is determined."""
_APART = 2.0 * SPACING
"""m between the centres of those."""
_PLACES = 120
"""At most."""
_IN_ONE = 8
"""So many of them at once."""
_PLAIN = (-1.0, 1.0)
"""Coordinates between which such a disc is tried."""
_SOUGHT, _FEW = 15.0, 3
"""Nats that the best of them promise at least to be tried, and how many are."""
_MOVES = (0.4, 0.2, 0.1)
"""m by which centre and radius are moved when a disc is refined."""


@dataclass(frozen=True)
class _Disc:
    """A candidate with its coordinate and gain."""

    x: float
    y: float
    radius: float
    probe: Array
    gain: float = 0.0


@dataclass(frozen=True)
class _DiscEstimate:
    """A disc at its best, linearly, and the standard deviation of its coordinate."""

    disc: _Disc
    sd: float


def length(problem: Problem) -> float:
    """A robot's lengths over Agri.q's."""
    return scale_of(problem.parameters.robot).length


def discs(base: Around) -> list[Trial]:
    """The best discs for every effect that has one, each as a trial."""
    found, parameters = [], base.problem.parameters
    known = {*parameters.robot.effects, *(extension.id for extension in parameters.extensions)}
    for effect in EFFECTS.values():
        if effect.search is None or not effect.search.disc or effect.id in known:
            continue
        found += _discs(base, effect.id, effect.search.probes)
    return found


def _discs(base: Around, effect: str, probes: Sequence[tuple[float, ...]]) -> list[Trial]:
    centres = candidates(base)
    plain = tuple(np.array(probe) for probe in probes)
    every = [*plain, *small_probes(Hypothesis(Extension(effect), plain))]
    radii = [length(base.problem) * radius for radius in RADII]
    tried = [_Disc(x, y, radius, probe) for x, y in centres for radius in radii for probe in every]
    tried = sorted(gained(base, effect, tried), key=lambda disc: -disc.gain)[:_KEPT]
    seen = sorted((one.disc for one in scanned(base, effect)), key=lambda disc: -disc.gain)
    nearest = Extension(effect).nearest
    tried += [replace(disc, probe=nearest(np.clip(disc.probe, *_PLAIN))) for disc in seen[:_FEW] if disc.gain > _SOUGHT]
    among = max(1, len(tried) * max(len(centres), len(seen)))

    def trial(disc: _Disc) -> Trial:
        hypothesis = Hypothesis(_extension(effect, disc), (disc.probe,), among)
        problem = with_effect(base.problem, hypothesis.extension)
        first = evaluate(problem, base.loss, [np.concatenate([base.point.coordinates, disc.probe])], base.point.starts)
        point, _, _ = step(problem, base.loss, first[0], base.free, known=base.sensitivity, tries=2)
        return Trial(hypothesis, problem, point, np.full(1, np.inf))

    return side_by_side(trial, tried, base.problem.workers)


def candidates(base: Around) -> list[tuple[float, float]]:
    """Centres along the paths of windows that are explained worst."""
    windows = base.problem.windows
    poor = base.point.losses / np.array([len(w) for w in windows])
    order = np.argsort(-poor)
    bad = [i for i in order.tolist() if poor[i] > _BAD * np.median(poor)]
    cells: dict[tuple[int, int], None] = {}
    spacing = SPACING * length(base.problem)
    for i in bad:
        for x, y in path(base.problem, i)[::2].tolist():
            cells.setdefault((round(x / spacing), round(y / spacing)))
    return [(spacing * i, spacing * j) for i, j in cells][:_MOST]


def path(problem: Problem, number: int) -> Array:
    """Measured places of a window, shape (n, 2)."""
    window = problem.windows[number]
    x, y = (window.value[window.plan.kind == kind] for kind in (0, 1))
    return np.column_stack([x, y])


def _extension(effect: str, disc: _Disc) -> Extension:
    search = EFFECTS[effect].search
    assert search is not None
    return Extension(effect, dict(zip(search.disc, (disc.x, disc.y, disc.radius), strict=True)))


def touched(paths: Sequence[Array], x: float, y: float, radius: float, scale: float) -> list[int]:
    """Windows whose wheels may come onto a disc, by their paths (n, 2); `scale` is the robot's `length`."""
    reach = radius + scale * _REACH
    return [i for i, path in enumerate(paths) if (np.hypot(*(path - (x, y)).T) < reach).any()]


def gained(base: Around, effect: str, discs: Sequence[_Disc]) -> list[_Disc]:
    """The discs with the loss that each takes from the windows which touch it, soil and starts as they are.

    Many are simulated at once, each window with the robot of its disc: one by one they fill no processor.
    """
    problem, point = base.problem, base.point
    paths = [path(problem, i) for i in range(len(problem))]
    found, rows = list(discs), [touched(paths, disc.x, disc.y, disc.radius, length(problem)) for disc in discs]
    for some in _together([len(mine) for mine in rows]):
        part, residuals, every = _predicted(base, effect, [discs[k] for k in some], [rows[k] for k in some])
        which = np.repeat(np.arange(len(some)), [len(rows[k]) for k in some])
        losses = assess(part, base.loss, [point.coordinates], point.starts[every][None], residuals)[0].losses
        gains = np.bincount(which, point.losses[every] - losses, minlength=len(some))
        for k, gain in zip(some, gains.tolist(), strict=True):
            found[k] = replace(discs[k], gain=gain)
    return found


def scanned(base: Around, effect: str) -> list[_DiscEstimate]:
    """What all recordings together say of discs all along the paths that were driven, less and more slippery ones.

    Linear in the disc's coordinate, soil and starts, around what a small disc changes: a patch too faint to spoil any
    window shows here.
    """
    problem = base.problem
    paths = np.concatenate([path(problem, i) for i in range(len(problem))])
    apart, radius = _APART * length(problem), RADII[0] * length(problem)
    cells = np.unique(np.round(paths / apart), axis=0) * apart
    cells = cells[:: -(-len(cells) // _PLACES) or 1]
    discs = [_Disc(x, y, radius, np.array([sign * _SMALL])) for x, y in cells.tolist() for sign in (-1.0, 1.0)]
    parts = [discs[a : a + _IN_ONE] for a in range(0, len(discs), _IN_ONE)]
    found = side_by_side(lambda some: _disc_estimates(base, effect, some), parts, problem.workers)
    return [one for some in found for one in some]


def _disc_estimates(base: Around, effect: str, discs: Sequence[_Disc]) -> list[_DiscEstimate]:
    """Each disc at the coordinate that it would be best with, and how well that is determined."""
    problem, p = base.problem, len(base.free)
    changes = _changes(base, effect, discs) / np.array([disc.probe for disc in discs])
    sensitivity = Sensitivity(np.concatenate([base.sensitivity.parameters, changes]), base.sensitivity.starts)
    reduced = reduce(problem, base.loss, base.point.residuals, sensitivity, base.point.starts)
    H, gradient = reduced.matrix, reduced.gradient.sum(axis=0)
    prior, free = problem.parameters.prior_information, list(base.free)
    H[:p, :p] += prior[np.ix_(free, free)]
    gradient[:p] += (prior @ base.point.coordinates)[free]
    beside = np.linalg.solve(H[:p, :p], H[:p, p:])
    information = np.maximum(np.diag(H)[p:] - np.einsum("ij,ij->j", H[:p, p:], beside), 1e-12)
    best = -(gradient[p:] - gradient[:p] @ beside) / information
    return [
        _DiscEstimate(
            replace(disc, probe=np.array([own]), gain=0.5 * own * own * stated),
            stated**-0.5 if stated > 1e-9 else np.inf,
        )
        for disc, own, stated in zip(discs, best.tolist(), information.tolist(), strict=True)
    ]


def deviations_along(base: Around, effect: str) -> Array:
    """Standard deviations of a disc's coordinate at places all along the paths, shape (places,).

    Of less and more slippery discs, whichever tell less; infinite where a disc changes nothing.
    """
    return np.array([one.sd for one in scanned(base, effect)]).reshape(-1, 2).max(axis=1)


def _changes(base: Around, effect: str, discs: Sequence[_Disc]) -> Array:
    """What discs change in the residuals, shape (discs, n)."""
    problem, edges = base.problem, base.problem.samples.begin
    paths = [path(problem, i) for i in range(len(problem))]
    found, rows = (
        np.zeros((len(discs), edges[-1])),
        [touched(paths, disc.x, disc.y, disc.radius, length(problem)) for disc in discs],
    )
    for some in _together([len(mine) for mine in rows]):
        _, now, every = _predicted(base, effect, [discs[k] for k in some], [rows[k] for k in some])
        place = np.concatenate([np.arange(edges[i], edges[i + 1]) for i in every])
        whose = np.repeat(np.repeat(some, [len(rows[k]) for k in some]), np.diff(edges)[every])
        found[whose, place] = now[0] - base.point.residuals.flat[place]
    return found


def _predicted(
    base: Around, effect: str, discs: Sequence[_Disc], rows: Sequence[Sequence[int]]
) -> tuple[Problem, Array, Indices]:
    """All windows in `rows`, their residuals (1, n), each set's with its disc, and their numbers in the whole."""
    problem, point = base.problem, base.point
    every = np.concatenate(rows).astype(np.int64)
    which = np.repeat(np.arange(len(discs)), [len(mine) for mine in rows])
    robots = []
    for disc in discs:
        parameters = with_effect(problem, _extension(effect, disc)).parameters
        robots.append(parameters.robot_at(np.concatenate([point.coordinates, disc.probe])))
    part = problem.part(every.tolist())
    return part, part.compare(part.predictions(robots, which[None], point.starts[every][None])), every


def _together(counts: Sequence[int]) -> Iterator[list[int]]:
    """Numbers of discs, of which so many windows each are touched, in groups that memory holds; none without any."""
    group: list[int] = []
    for k in np.flatnonzero(counts).tolist():
        group.append(k)
        if sum(counts[i] for i in group) >= _AT_ONCE:
            yield group
            group = []
    if group:
        yield group


def refined(trial: Trial, loss: Loss) -> Trial:
    """The trial with its disc moved and resized to where it explains most; others as they are."""
    search = trial.hypothesis.extension.search
    if not search.disc:
        return trial
    for size in _MOVES:
        for _ in range(3):
            better = _moved(trial, loss, size)
            if better is None:
                break
            trial = better
    return trial


def _moved(trial: Trial, loss: Loss, size: float) -> Trial | None:
    extension = trial.hypothesis.extension
    now = np.array([float(extension.fixed[name]) for name in extension.search.disc])
    best: tuple[Problem, Point] | None = None
    for i in range(3):
        for sign in (-1.0, 1.0):
            new = now.copy()
            new[i] += sign * size
            if new[2] < SMALLEST:
                continue
            problem = with_disc(trial.problem, -1, new)
            point = evaluate(problem, loss, [trial.point.coordinates], trial.point.starts)[0]
            if best is None or point.cost < best[1].cost:
                best = problem, point
    if best is None or best[1].cost >= trial.point.cost - 1.0:
        return None
    hypothesis = replace(trial.hypothesis, extension=best[0].parameters.extensions[-1])
    return Trial(hypothesis, *best, trial.sd)


def with_disc(problem: Problem, which: int, disc: Array) -> Problem:
    """The problem with the disc (3,) of the effect numbered `which` elsewhere."""
    parameters = problem.parameters
    extension = parameters.extensions[which]
    there = dict(zip(extension.search.disc, disc.tolist(), strict=True))
    moved = list(parameters.extensions)
    moved[which] = replace(extension, fixed=dict(extension.fixed) | there)
    return problem.with_parameters(replace(parameters, extensions=tuple(moved)))


# ----------------------------------------------------------------------
# Where a disc of ground is, and how surely: other discs beside the fitted one, and how well they explain.
#
# Where a disc is cannot be fitted by gradients: predictions jump as its edge comes under another wheel. So many
# discs around it are tried, each with the effect's size, the soil and the starts fitted anew; of windows that a
# disc does not touch the fit's normal equations tell what another soil costs. Then windows are weighted at random,
# as for all other values (`intervals.judged`), each time the disc with the least loss is taken, and the interval holds
# what comes out.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]
Place = tuple[float, tuple[float, float]]
"""A value and its 95 % interval, m."""

_ROUNDS, _TRIED = 12, 20
"""Rounds, and discs in each."""
_FIRST = 0.2
"""Standard deviation of the first round's centres and radii, m."""
_NEXT = 0.02
"""What is added to that of later rounds, m, so that none tries one disc only."""
_FARTHEST = 0.8
"""Farthest that centre and radius are moved, m."""
_BLUNT = 4.0
"""Losses over this, or more (`_shares`), say around which discs the next ones are drawn: wider than what is known."""
_COUNT = 6.0
"""So many discs count at least: a few centimetres cost hundreds of nats, and one disc alone tells no direction."""
_WIDER = 1.5
"""Factor by which discs are drawn wider than what is known of the best one."""
_LEAST = 0.05
"""Standard deviation of what no residual shows, and of what lies between discs that were tried, m."""
_STEPS = 2
_DRAWS = 600
"""Random weightings of the windows."""
_ENDS = (0.025, 0.975)


@dataclass(frozen=True)
class _NearWindows:
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
    def other_windows(self) -> FrozenWindows:
        """What the other windows lose with another soil."""
        reduced, free = self.fit.reduced, list(self.fit.free)
        middle = self.fit.point.coordinates[free]
        return FrozenWindows(middle, reduced.gradient[self.others], reduced.matrices[self.others])

    def losses(self, place: Array) -> Array:
        """Of all windows (windows,), and last of the prior, with the disc elsewhere (3,) and all else fitted anew."""
        problem, fit = with_disc(self.part, self.which, place), self.fit
        point = evaluate(problem, fit.loss, [fit.point.coordinates], fit.point.starts[self.rows])[0]
        for _ in range(_STEPS):
            point, _, _ = step(problem, fit.loss, point, fit.free, tries=2, beside=self.other_windows)
        found = np.empty(len(fit.point.losses) + 1)
        found[self.rows] = point.losses
        found[self.others] = fit.point.losses[self.others] + self.other_windows.losses(
            point.coordinates[list(fit.free)]
        )
        found[-1] = prior(problem, point.coordinates)
        return found


def disc_place(problem: Problem, fit: Fit, which: int, seed: int) -> dict[str, Place]:
    """Centre and radius (m) of the disc numbered `which` among the effects, with 95 % intervals; none for others."""
    rng = np.random.default_rng(seed)
    table, losses = _tried(problem, fit, which, rng)
    if not len(table):
        return {}
    weights = np.ones((_DRAWS, losses.shape[1]))
    weights[:, :-1] = rng.exponential(size=(_DRAWS, losses.shape[1] - 1))  # the prior stays
    drawn = table[np.argmin(weights @ losses.T, axis=1)] + rng.normal(scale=length(problem) * _LEAST, size=(_DRAWS, 3))
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
    table, losses = _tried(problem, fit, which, np.random.default_rng(seed))
    if not len(table):
        return problem, fit
    moved = with_disc(problem, which, table[np.argmin(losses.sum(axis=1))])
    begun = evaluate(moved, fit.loss, [fit.point.coordinates], fit.point.starts)[0]
    found = converge(moved, begun, fit.loss, steps)
    return (moved, found) if found.point.cost < fit.point.cost else (problem, fit)


def _tried(problem: Problem, fit: Fit, which: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Discs (n, 3) around the fitted one, which is the first, and their losses (n, windows + 1); none for others.

    Each round is drawn from the normal distribution of the discs that explained most, correlations and all: a disc that
    is larger and farther off touches nearly the same wheels, so the loss is a narrow ridge oblique to x, y and radius.
    """
    extension = problem.parameters.extensions[which]
    here = np.array([float(extension.fixed[name]) for name in extension.search.disc])
    rows = _near(problem, here)
    if not rows:
        return np.empty((0, 3)), np.empty((0, len(problem) + 1))
    apart = _NearWindows(problem.part(rows), rows, fit, which)
    table, losses = here[None], apart.losses(here)[None]
    scale = length(problem)
    middle, covariance = here, np.eye(3) * (scale * _FIRST) ** 2
    for _ in range(_ROUNDS):
        drawn = middle + rng.normal(size=(_TRIED, 3)) @ np.linalg.cholesky(covariance).T
        tried = _inside(here, drawn, scale)
        found = side_by_side(apart.losses, list(tried), problem.workers)
        table, losses = np.concatenate([table, tried]), np.concatenate([losses, found])
        total = losses.sum(axis=1)
        share = _shares(total - total.min())
        middle = share @ table
        away = table - middle
        covariance = _WIDER**2 * (away.T * share) @ away + np.eye(3) * (scale * _NEXT) ** 2
    return table, losses


def _shares(excess: Array) -> Array:
    """Weights (n,) of discs whose losses exceed the best one's by `excess` (n,); at least `_COUNT` of them count.

    Their effective number is 1/sum(share²).
    """
    blunt, enough = _BLUNT, min(_COUNT, 0.5 * len(excess))
    while True:
        share = np.exp(-0.5 / blunt * excess)
        share /= share.sum()
        if 1.0 / (share @ share) >= enough:
            return share
        blunt *= 1.3


def _near(problem: Problem, disc: Array) -> list[int]:
    """Windows that a disc (3,) may touch wherever it is moved; none where there is no disc."""
    if not len(disc):
        return []
    scale = length(problem)
    x, y, radius = disc.tolist()
    return touched([path(problem, i) for i in range(len(problem))], x, y, radius + scale * _FARTHEST, scale)


def _inside(here: Array, places: Array, scale: float) -> Array:
    """Places (n, 3) no farther from one than they may be, their radii no smaller; `scale` is the robot's `length`."""
    places = here + np.clip(places - here, -scale * _FARTHEST, scale * _FARTHEST)
    places[:, 2] = np.maximum(places[:, 2], scale * SMALLEST)
    return places
