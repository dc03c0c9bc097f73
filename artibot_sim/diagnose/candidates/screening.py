"""The cheap test of every effect: what it would gain, by sensitivities around the baseline and by finite steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis, with_effect
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem, Sensitivity, clip, moved_along
from artibot_sim.estimation.search import coarse_to_fine_scan, converge, free_parameters
from artibot_sim.estimation.solver import Point, assess, evaluate, reduce, step

Array = NDArray[np.float64]
Follow = Callable[[Array], Array]
"""From an effect's coordinates to the change of the baseline's free ones that goes with them."""

_REACH = 3.0
"""Largest coordinate at which the estimate from sensitivities is tried."""
_FARTHEST = 0.7
"""Largest change of a coordinate of the baseline beside a probe."""
_TEST = 0.5
"""Coordinate at which effects are tried that need no probes: what it costs says how well they are determined."""
_FAINT, _PLAIN = 0.3, 0.6
"""Share of a probe at which it is tried as well where all of an effect's probes are at least this plain."""
_MORE = 3
"""Steps at most of a probe that is not at rest."""
_RESTS = 4
"""Fits at most of a baseline that is not at rest."""
_QUIET = 24.0
"""Fall of the loss, by what trials go through, of a baseline that is."""
_SCORE_STEP = 0.05
"""Coordinate by which an effect is turned on for its sensitivity."""


@dataclass(frozen=True)
class Trial:
    """One hypothesis and the best point that was found for it so far.

    Attributes
    ----------
    hypothesis : Hypothesis
    problem : Problem
        The baseline's with the effect's coordinates as the last ones.
    point : Point
    sd : array, shape (len(extension),)
        Standard deviations of the coordinates as sensitivities at neutral give them; infinite where nothing changes.
    tested : tuple of (array of shape (len(extension),), float)
        Coordinates of finite probes, and what each costs over the baseline, soil and mu_s having had their say.
    expected_gain : float
        Nats that the effect would gain if all were as linear as it is around the baseline.
    """

    hypothesis: Hypothesis
    problem: Problem
    point: Point
    sd: Array
    tested: tuple[tuple[Array, float], ...] = ()
    expected_gain: float = 0.0

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.hypothesis.id

    @property
    def coarsest_sd(self) -> float:
        """Standard deviation of the coordinates' length as the probe that tells least gives it: size over root of cost.

        Infinite where some probe costs nothing, or none was tried.
        """
        found = [float(np.linalg.norm(own) / np.sqrt(cost)) if cost > 0.0 else np.inf for own, cost in self.tested]
        return max(found, default=np.inf)

    @property
    def effect_coordinates(self) -> Array:
        """The effect's coordinates."""
        return self.point.coordinates[-len(self.hypothesis.extension) :]


@dataclass(frozen=True)
class Around:
    """What is known around a baseline: its residuals' sensitivities.

    Attributes
    ----------
    problem : Problem
    loss : Loss
    point : Point
        Its residuals simulated, not guessed.
    free : tuple of int
    sensitivity : Sensitivity
    """

    problem: Problem
    loss: Loss
    point: Point
    free: tuple[int, ...]
    sensitivity: Sensitivity


@dataclass(frozen=True)
class _Score:
    """What sensitivities say of an effect.

    Attributes
    ----------
    estimate : array or None
        Its coordinates after one step from the baseline; None where neutral is infinitely far.
    sd : array
        Their standard deviations.
    expected_gain : float
        As in `Trial`.
    follow : callable or None
        The change of the baseline's free coordinates that goes best with the effect's.
    """

    estimate: Array | None
    sd: Array
    expected_gain: float
    follow: Follow | None


def around(problem: Problem, loss: Loss, point: Point) -> Around:
    """Sensitivities at a baseline."""
    free = free_parameters(problem)
    residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    exact = assess(problem, loss, [point.coordinates], point.starts[None], residuals.flat[None])[0]
    return Around(problem, loss, exact, free, sensitivity)


def converged_baseline(problem: Problem, loss: Loss, point: Point, steps: int) -> tuple[Around, Point]:
    """A baseline to screen from, and where it gets by what every trial goes through: effects are held against that.

    Fitted further, by so many steps at a time, where it gets far: what an effect adds is not seen beside that.
    """
    base = around(problem, loss, point)
    for _ in range(_RESTS):
        control = _control(base)
        if base.point.cost - control.cost < _QUIET:
            break
        base = around(problem, loss, converge(problem, control, loss, steps).point)
    else:
        control = _control(base)
    return base, control


def _control(base: Around) -> Point:
    """The baseline as a trial without any effect."""
    problem, loss = base.problem, base.loss
    (point,) = _resumed(base, problem, [coarse_to_fine_scan(problem, loss, base.point)], 0)
    return step(problem, loss, point, base.free, known=base.sensitivity, tries=2)[0]


def screen(base: Around, found: Sequence[Hypothesis], tick: Callable[[], None] = lambda: None) -> list[Trial]:
    """Every hypothesis at the best of its probes, soil and starts corrected by a few steps."""
    return side_by_side(partial(_screened, base), found, base.problem.workers, tick)


def _screened(base: Around, hypothesis: Hypothesis) -> Trial:
    problem = with_effect(base.problem, hypothesis.extension)
    score = _score(base, problem, hypothesis)
    extension = hypothesis.extension
    tests = [extension.nearest(probe) for probe in hypothesis.probes or _TEST * np.eye(len(extension))]
    probes = list(tests)
    if score.estimate is not None:
        probes.append(extension.nearest(np.clip(score.estimate, -_REACH, _REACH)))
    guesses = [
        _guesses(base, problem, hypothesis, probe, score.follow) for probe in (*probes, *small_probes(hypothesis))
    ]
    every = [guess for some in guesses for guess in some]
    tried = iter(evaluate(problem, base.loss, every, _starts(base, problem, every)))
    points = [min((next(tried) for _ in some), key=lambda point: point.cost) for some in guesses]
    if len(points) > len(probes):
        points = [*points[: len(probes)], min(points[len(probes) :], key=lambda point: point.cost)]
    # mu_s acts by switching, so no sensitivity tells where it goes
    points = [coarse_to_fine_scan(problem, base.loss, point) for point in points]
    if extension.effect.sensor is not None:
        points = _resumed(base, problem, points, len(extension))
    ends = [_settled(base, problem, point) for point in points]
    best = min(ends, key=lambda point: point.cost)
    return Trial(hypothesis, problem, best, score.sd, _tested(tests, ends, base.point.cost), score.expected_gain)


def _settled(base: Around, problem: Problem, point: Point) -> Point:
    """A probe with soil and starts as one step with the baseline's sensitivities leaves them, or more with its own.

    Soil beside a law that is not linear may be far off: steps go on while one more that falls as far as the last one
    would reach the baseline's loss.
    """
    before, point = point, step(problem, base.loss, point, base.free, known=base.sensitivity, tries=2)[0]
    for _ in range(_MORE):
        if before.cost - point.cost < max(_QUIET, point.cost - base.point.cost):
            break
        before, point = point, step(problem, base.loss, point, base.free, tries=2)[0]
    return point


def _resumed(base: Around, problem: Problem, points: Sequence[Point], size: int) -> list[Point]:
    """The best point for each size of an effect after steps of its starts alone: other sensors saw other starts."""
    best: dict[bytes, Point] = {}
    for point in sorted(points, key=lambda point: point.cost):
        best.setdefault(point.coordinates[len(point.coordinates) - size :].tobytes(), point)
    found = []
    for point in best.values():
        for _ in range(2):
            point, _, _ = step(problem, base.loss, point, ())
        found.append(point)
    return found


def _starts(base: Around, problem: Problem, guesses: Sequence[Array]) -> Array:
    """The baseline's starts as each guess's sensors see them, shape (guesses, windows, 8 or 6)."""
    now = base.problem.parameters.robot_at(base.point.coordinates)
    return np.array([problem.held(now, problem.parameters.robot_at(c), base.point.starts) for c in guesses])


def _tested(probes: Sequence[Array], ends: Sequence[Point], neutral: float) -> tuple[tuple[Array, float], ...]:
    """Probes with what the best fit that holds to each costs over a baseline's `neutral`."""
    found = []
    for own in probes:
        costs = [end.cost for end in ends if np.array_equal(end.coordinates[-len(own) :], own)]
        found.append((own, min(costs, default=neutral) - neutral))
    return tuple(found)


def small_probes(hypothesis: Hypothesis) -> list[Array]:
    """Small probes of an effect that has none: between neutral and a plain size the loss may rise first."""
    sizes = [float(np.abs(probe).max()) for probe in hypothesis.probes]
    if not sizes or min(sizes) < _PLAIN:
        return []
    return [hypothesis.extension.nearest(_FAINT * probe) for probe in hypothesis.probes]


def _guesses(
    base: Around, problem: Problem, hypothesis: Hypothesis, probe: Array, follow: Follow | None
) -> list[Array]:
    """Coordinates of the whole fit at a probe: the baseline's soil, what it would become beside it, and its ridge."""
    parameters, own = problem.parameters, base.point.coordinates
    guesses = [np.concatenate([own, probe])]
    if follow is not None:
        moved = own.copy()
        moved[list(base.free)] += np.clip(follow(probe), -_FARTHEST, _FARTHEST)
        guesses.append(parameters.inside(np.concatenate([moved, probe])))
    extension = hypothesis.extension
    if not extension.search.ridge:
        return guesses
    first = guesses[0]
    soil = parameters.along_ridge(parameters.values(first), extension, np.zeros(len(extension)), probe)
    return [*guesses, parameters.inside(parameters.coordinates(soil, first[len(parameters.parameters) :]))]


def _score(base: Around, problem: Problem, hypothesis: Hypothesis) -> _Score:
    """What the baseline's and the effect's sensitivities make of each other."""
    extension = hypothesis.extension
    origin = np.maximum(np.zeros(len(extension)), extension.bounds[0])
    if extension.search.reference:
        return _Score(None, np.full(len(extension), np.inf), 0.0, None)
    p = len(base.free)
    guesses = [np.concatenate([base.point.coordinates, origin + _SCORE_STEP * e]) for e in np.eye(len(extension))]
    starts = _starts(base, problem, guesses)
    own = (problem.flat_residuals(guesses, starts) - base.point.residuals.flat) / _SCORE_STEP
    clip(problem.samples, own)
    moved_along(problem.samples, own, base.sensitivity.starts, (starts - base.point.starts) / _SCORE_STEP)
    combined = Sensitivity(np.concatenate([base.sensitivity.parameters, own]), base.sensitivity.starts)
    reduced = reduce(problem, base.loss, base.point.residuals, combined, base.point.starts)
    index = [*base.free, *range(len(base.point.coordinates), len(problem.parameters))]
    prior = problem.parameters.prior_information
    H = reduced.matrix + prior[np.ix_(index, index)]
    here = np.concatenate([base.point.coordinates, np.zeros(len(extension))])
    gradient = reduced.gradient.sum(axis=0) + (prior @ here)[index]
    covariance = np.linalg.inv(H)
    estimate = -(covariance @ gradient)[p:]
    known = np.linalg.inv(covariance[p:, p:])
    information = np.diag(known) - np.diag(prior)[-len(extension) :]
    sd = np.where(information > 1e-9, 1.0 / np.sqrt(np.maximum(information, 1e-12)), np.inf)

    def follow(own: Array) -> Array:
        """Change of the free coordinates that goes best with the effect's."""
        return np.asarray(-np.linalg.solve(H[:p, :p], gradient[:p] + H[:p, p:] @ (own - origin)), float)

    return _Score(estimate, sd, 0.5 * float(estimate @ known @ estimate), follow)
