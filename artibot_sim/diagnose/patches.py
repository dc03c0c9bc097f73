"""Discs of ground on which something differs: candidates along the paths of badly explained windows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.hypotheses import Hypothesis, with_effect
from artibot_sim.diagnose.screen import Around, Trial, faint
from artibot_sim.identify.extension import Extension
from artibot_sim.identify.gauss_newton import Point, assess, evaluate, step
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.side_by_side import side_by_side
from artibot_sim.model.effects import EFFECTS

Array = NDArray[np.float64]

SPACING = 0.7
"""m between centres of candidates."""
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
_AT_ONCE = 200
"""Windows that are simulated together."""
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


def discs(base: Around) -> list[Trial]:
    """The best discs for every effect that has one, each as a trial."""
    found = []
    for effect in EFFECTS.values():
        named = {extension.id for extension in base.problem.parameters.extensions}
        if effect.search is None or not effect.search.disc or effect.id in named:
            continue
        found += _discs(base, effect.id, effect.search.probes)
    return found


def _discs(base: Around, effect: str, probes: Sequence[tuple[float, ...]]) -> list[Trial]:
    centres = candidates(base)
    plain = tuple(np.array(probe) for probe in probes)
    every = [*plain, *faint(Hypothesis(Extension(effect), plain))]
    tried = [_Disc(x, y, radius, probe) for x, y in centres for radius in RADII for probe in every]
    tried = sorted(gained(base, effect, tried), key=lambda disc: -disc.gain)[:_KEPT]

    def trial(disc: _Disc) -> Trial:
        hypothesis = Hypothesis(_extension(effect, disc), (disc.probe,), max(1, len(tried) * len(centres)))
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
    for i in bad:
        for x, y in path(base.problem, i)[::2].tolist():
            cells.setdefault((round(x / SPACING), round(y / SPACING)))
    return [(SPACING * i, SPACING * j) for i, j in cells][:_MOST]


def path(problem: Problem, number: int) -> Array:
    """Measured places of a window, shape (n, 2)."""
    window = problem.windows[number]
    x, y = (window.value[window.plan.kind == kind] for kind in (0, 1))
    return np.column_stack([x, y])


def _extension(effect: str, disc: _Disc) -> Extension:
    search = EFFECTS[effect].search
    assert search is not None
    return Extension(effect, dict(zip(search.disc, (disc.x, disc.y, disc.radius), strict=True)))


def touched(paths: Sequence[Array], x: float, y: float, radius: float) -> list[int]:
    """Windows whose wheels may come onto a disc, by their paths (n, 2)."""
    return [i for i, path in enumerate(paths) if (np.hypot(*(path - (x, y)).T) < radius + _REACH).any()]


def gained(base: Around, effect: str, discs: Sequence[_Disc]) -> list[_Disc]:
    """The discs with the loss that each takes from the windows which touch it, soil and starts as they are.

    Many are simulated at once, each window with the robot of its disc: one by one they fill no processor.
    """
    problem, point = base.problem, base.point
    paths = [path(problem, i) for i in range(len(problem))]
    found, rows = list(discs), [touched(paths, disc.x, disc.y, disc.radius) for disc in discs]
    for some in _together([len(mine) for mine in rows]):
        every = np.concatenate([rows[k] for k in some])
        which = np.repeat(np.arange(len(some)), [len(rows[k]) for k in some])
        robots = []
        for k in some:
            parameters = with_effect(problem, _extension(effect, discs[k])).parameters
            robots.append(parameters.robot_at(np.concatenate([point.coordinates, discs[k].probe])))
        part = problem.part(every.tolist())
        starts = point.starts[every][None]
        residuals = part.compare(part.predictions(robots, which[None], starts))
        losses = assess(part, base.loss, [point.coordinates], starts, residuals)[0].losses
        gains = np.bincount(which, point.losses[every] - losses, minlength=len(some))
        for k, gain in zip(some, gains.tolist(), strict=True):
            found[k] = replace(discs[k], gain=gain)
    return found


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
