"""The promising effects fitted jointly with the soil, in rounds of growing effort; the baseline gets as much."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from artibot_sim.diagnose.candidates.hypotheses import without_effect
from artibot_sim.diagnose.candidates.patches import refined
from artibot_sim.diagnose.candidates.screening import Around, Trial
from artibot_sim.diagnose.selection.ridge_search import from_far_sizes
from artibot_sim.estimation.encoder_noise import answers, with_noisy_inputs
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import (
    Fit,
    coarse_to_fine_scan,
    converge,
    followed_scan,
    free_parameters,
    restarted_windows,
)
from artibot_sim.estimation.solver import Point, evaluate, polished, reassessed, step

# ----------------------------------------------------------------------
# The promising effects fitted jointly with the soil, in rounds of growing effort; the baseline gets as much.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]
Tick = Callable[[], None]
Item = TypeVar("Item")
Result = TypeVar("Result")

_HOPELESS = 0.03
"""Share of what the best gains by a few steps, below which no further steps are tried."""


@dataclass(frozen=True)
class Rounds:
    """How many effects go on from round to round, and with how many steps.

    Attributes
    ----------
    most : tuple of int
        Effects at most that are fitted by two steps, by a few, and to the end.
    least : tuple of int
        Effects that go on in any case.
    shares : tuple of float
        Others go on if they gain this share of what the best one gains.
    returns : int
        Fits from whose soil and starts the baseline is fitted again.
    most_expected : int
        Effects that are fitted although they gain nothing in the screen, for what sensitivities promise.
    least_expected : float
        Nats that sensitivities have to promise.
    few, many : int
        Steps.
    worth : float
        Nats that an effect has to gain in the screen to be fitted at all.
    plain : float
        Nats between two fits that no further steps make up for.
    scheduler : str, optional
        Address of a Dask scheduler whose workers fit one effect each.
    """

    most: tuple[int, int, int] = (12, 6, 4)
    least: tuple[int, int, int] = (3, 2, 2)
    shares: tuple[float, float, float] = (0.04, 0.15, 0.3)
    returns: int = 2
    most_expected: int = 2
    least_expected: float = 12.0
    few: int = 3
    many: int = 8
    worth: float = 12.0
    plain: float = 1000.0
    scheduler: str | None = None

    def through(self, number: int, gains: Sequence[float]) -> int:
        """How many go on into a round, of gains in falling order."""
        best = gains[0] if gains else 0.0
        good = sum(gain >= self.shares[number] * best for gain in gains)
        return min(max(good, self.least[number]), self.most[number])

    def differ(self, problem: Problem, fit: Fit, other: Point) -> bool:
        """Whether effects look otherwise beside another soil than beside that of a fit.

        They do not where the fit's normal equations lead to it, by less than an effect has to gain to be fitted: then
        it lies on the same ridge. On soft tyres a Husky's two soils lay 3 and 5 nats apart with `k_l` and `k_t` by 50
        and by 7 % more, and 75 000 where their ratio was another.
        """
        away = (other.coordinates - fit.point.coordinates)[list(fit.free)]
        prior = problem.parameters.prior_information[np.ix_(fit.free, fit.free)]
        return bool(0.5 * away @ (fit.reduced.matrix + prior) @ away > self.worth)

    def for_all(self, count: int) -> Rounds:
        """Rounds of a search in which all of `count` trials may be fitted, and all but hopeless ones to the end."""
        most, shares = (*self.most[:2], count), (*self.shares[:2], _HOPELESS)
        return replace(self, most_expected=count, least_expected=-np.inf, most=most, shares=shares)


@dataclass(frozen=True)
class Rival:
    """A hypothesis fitted with the soil.

    Attributes
    ----------
    trial : Trial
    fit : Fit
    """

    trial: Trial
    fit: Fit

    @property
    def id(self) -> str:
        """Of the effect."""
        return self.trial.id

    @property
    def problem(self) -> Problem:
        """The baseline's with the effect."""
        return self.trial.problem

    @property
    def effect_coordinates(self) -> Array:
        """The effect's coordinates."""
        return self.fit.point.coordinates[-len(self.trial.hypothesis.extension) :]


class FitCache:
    """Fits of one search by what they began from, so that a more thorough one does not make them again.

    What they began from is known by identity; it is kept, for the number of an object that is gone may be given again.
    Only fits under one loss and by as many steps share this: `Rounds.for_all` changes how many are made, not how.
    """

    def __init__(self) -> None:
        self._made: dict[tuple[object, ...], tuple[tuple[object, ...], Any]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {"made": list(self._made.values())}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._made = {tuple(map(id, parts)): (parts, result) for parts, result in state["made"]}

    def all(
        self,
        do: Callable[[Item], Result],
        items: Sequence[Item],
        begun: Callable[[Item], tuple[object, ...]],
        make: Callable[[Callable[[Item], Result], Sequence[Item]], list[Result]],
    ) -> list[Result]:
        """What `do` makes of each item, in their order; `make` makes those that are not known yet.

        `begun` says of an item what a fit depends on: what is done, and the objects that it begins with.
        """
        keys = [tuple(map(id, begun(item))) for item in items]
        new = [item for key, item in zip(keys, items, strict=True) if key not in self._made]
        for item, result in zip(new, make(do, new), strict=True):
            parts = begun(item)
            self._made[tuple(map(id, parts))] = parts, result
        return [self._made[key][1] for key in keys]


def contest(
    trials: Sequence[Trial],
    baseline: float,
    loss: Loss,
    rounds: Rounds,
    tick: Tick = lambda: None,
    known: FitCache | None = None,
    asked: Collection[str] = (),
) -> list[Rival]:
    """The best hypotheses, each fitted with the soil and the starts by a few steps; the least cost first.

    Parameters
    ----------
    trials : sequence of Trial
        One for each hypothesis.
    baseline : float
        Cost of the model without any of them.
    loss : Loss
        The baseline's.
    rounds : Rounds
    known : FitCache, optional
        Fits that were made of the same trials under the same loss.
    asked : collection of str
        Effects that are fitted in any case.
    """
    workers, known = trials[0].problem.workers if trials else None, known or FitCache()
    worthy = [trial for trial in trials if 0.5 * (baseline - trial.point.cost) > rounds.worth]

    def made(do: Callable[[Loss, Rounds, Trial], Result], some: Sequence[Trial]) -> list[Result]:
        return known.all(
            partial(do, loss, rounds), some, lambda trial: (do, trial), _parallel_fits(rounds, tick, workers)
        )

    begun = made(_refined_trial, _through(worthy, 0, baseline, rounds))
    tried = _through(_one_each(sorted(begun, key=lambda t: t.point.cost)), 1, baseline, rounds)
    wanted = sorted((trial for trial in trials if trial.id in asked), key=lambda trial: trial.point.cost)
    tried = _one_each([*tried, *_promising(trials, worthy, rounds), *wanted])
    fitted = sorted(made(_fitted, tried), key=lambda rival: rival.fit.point.cost)
    most = rounds.through(2, [baseline - rival.fit.point.cost for rival in fitted])
    return [*fitted[:most], *(rival for rival in fitted[most:] if rival.id in asked)]


def finished(
    base: Around, rivals: Sequence[Rival], rounds: Rounds, tick: Tick = lambda: None, *, known: FitCache
) -> tuple[Fit, list[Rival]]:
    """The baseline and the rivals fitted to the end, all with the same effort; the least cost first."""
    begun = [(base.problem, base.point), *((rival.problem, rival.fit.point) for rival in rivals)]
    best, *fits = known.all(
        partial(_settled, base.loss, rounds), begun, lambda one: (_settled, *one),
        _parallel_fits(rounds, tick, base.problem.workers),
    )  # fmt: skip
    found = [replace(rival, fit=fit) for rival, fit in zip(rivals, fits, strict=True)]
    return best, sorted(found, key=lambda rival: rival.fit.point.cost)


def _parallel_fits(
    rounds: Rounds, tick: Tick, workers: int | None
) -> Callable[[Callable[[Item], Result], Sequence[Item]], list[Result]]:
    """Fits made side by side; on a cluster where the rounds name one."""
    return lambda do, items: side_by_side(do, items, workers, tick, rounds.scheduler)


def _through(trials: Sequence[Trial], number: int, baseline: float, rounds: Rounds) -> list[Trial]:
    """The trials that go on into a round."""
    ordered = sorted(trials, key=lambda trial: trial.point.cost)
    return ordered[: rounds.through(number, [baseline - trial.point.cost for trial in ordered])]


def _promising(trials: Sequence[Trial], worthy: Sequence[Trial], rounds: Rounds) -> list[Trial]:
    """Those of the others that would gain most if all were linear: starts on other branches of eq. 16 hide a gain."""
    gaining = {trial.id for trial in worthy}
    others = [trial for trial in trials if trial.id not in gaining and trial.expected_gain > rounds.least_expected]
    return _one_each(sorted(others, key=lambda trial: -trial.expected_gain))[: rounds.most_expected]


def _one_each(trials: Sequence[Trial]) -> list[Trial]:
    """The best hypothesis of every effect, in the order given."""
    seen: set[str] = set()
    return [trial for trial in trials if not (trial.id in seen or seen.add(trial.id))]  # type: ignore[func-returns-value]


def _fitted(loss: Loss, rounds: Rounds, trial: Trial) -> Rival:
    return Rival(trial, converge(trial.problem, trial.point, loss, rounds.few))


def _settled(loss: Loss, rounds: Rounds, begun: tuple[Problem, Point]) -> Fit:
    return settled(*begun, loss, rounds)


def _refined_trial(loss: Loss, rounds: Rounds, trial: Trial) -> Trial:
    """Two steps of everything, mu_s scanned before each, and discs moved to where they explain most."""
    free, damping = free_parameters(trial.problem), 1e-3
    for _ in range(2):
        trial = refined(trial, loss)
        point = coarse_to_fine_scan(trial.problem, loss, trial.point)
        point, _, damping = step(trial.problem, loss, point, free, damping)
        trial = replace(trial, point=point)
    return refined(trial, loss)


def settled(problem: Problem, point: Point, loss: Loss, rounds: Rounds) -> Fit:
    """A fit to the end: starts may change their branch, mu_s is scanned, at last with all else following it.

    The last steps are under the firm loss, which is what evidence counts: a window that lost its branch says little.
    """
    point = restarted_windows(problem, loss, reassessed(problem, loss, point))
    fit = from_far_sizes(problem, loss, converge(problem, point, loss, rounds.many), rounds.few)
    fit = converge(problem, fit.point, replace(loss, firm=True), rounds.few)
    lower = followed_scan(problem, fit.loss, fit.point, fit.free)
    return converge(problem, lower, fit.loss, rounds.few) if lower.cost < fit.point.cost else fit


def neutralised(rival: Rival, best: Fit, loss: Loss, rounds: Rounds) -> Fit:
    """The baseline fitted from a rival's soil and starts, the rival's effect left out.

    To the end only if that may be better than the `best` baseline after some steps, or if the rival's evidence is not
    so much that it does not matter.
    """
    problem, begin = without_effect(rival.problem, loss, rival.fit.point)
    if best.point.cost - rival.fit.point.cost > 2.0 * rounds.plain:
        some = converge(problem, restarted_windows(problem, loss, begin), loss, rounds.few)
        begin = some.point
        if reassessed(problem, best.loss, begin).cost > best.point.cost:
            return best
    return settled(problem, begin, loss, rounds)


def adopted(problem: Problem, fit: Fit, other: Problem, theirs: Fit, rounds: Rounds) -> Fit:
    """The fit with another model's starts wherever these explain a window better, fitted again if that is worth it.

    Two models are compared, not which of them happened upon a window's right branch.
    """
    seen = (other.parameters.robot_at(theirs.point.coordinates), problem.parameters.robot_at(fit.point.coordinates))
    point = polished(problem, fit.loss, fit.point, problem.held(*seen, theirs.point.starts))
    if point.cost > fit.point.cost - 2.0 * rounds.worth:
        return fit
    return converge(problem, point, fit.loss, rounds.few)


def with_soil_of(other: Rival, rival: Rival, rounds: Rounds) -> Rival:
    """A rival that is fitted from another one's soil and starts as well, from its own size or from neutral.

    Soils have many local optima on ground that is not quite the model's: effects are compared, not which of them
    happened upon the best soil.
    """
    if other.id == rival.id:
        return rival
    problem, loss, extension = rival.problem, rival.fit.loss, rival.trial.hypothesis.extension
    neutral, soil = np.zeros(len(extension)), other.fit.point.coordinates[: -len(other.effect_coordinates)]
    sizes = (
        [rival.effect_coordinates]
        if extension.effect.active(extension.values(neutral))
        else [rival.effect_coordinates, neutral]
    )
    begun = evaluate(problem, loss, [np.concatenate([soil, own]) for own in sizes], other.fit.point.starts)
    begin = restarted_windows(problem, loss, min(begun, key=lambda one: one.cost))
    fit = converge(problem, begin, loss, rounds.many)
    return replace(rival, fit=fit) if fit.point.cost < rival.fit.point.cost else rival


def contained(rival: Rival, best: Fit, rounds: Rounds) -> Rival:
    """A rival that fits no worse than the `best` baseline, which is the rival's model with its effect at neutral.

    Searches begin at probes, from which a fit may end on worse branches than the baseline's; then it is made again from
    the baseline's end. Limits have no neutral coordinates: they stay as they were fitted.
    """
    problem, extension = rival.problem, rival.trial.hypothesis.extension
    neutral = np.zeros(len(extension))
    if rival.fit.point.cost <= best.point.cost or extension.effect.active(extension.values(neutral)):
        return rival
    begin = np.concatenate([best.point.coordinates, neutral])
    point = evaluate(problem, best.loss, [begin], best.point.starts)[0]
    if extension.search.least:  # there are no small sizes of it, so no step leads away from neutral
        return replace(rival, fit=replace(rival.fit, point=point, loss=best.loss))
    return replace(rival, fit=converge(problem, point, best.loss, rounds.few))


def renoised(problem: Problem, fit: Fit, levels: Array, loss: Loss, steps: int) -> tuple[Problem, Fit]:
    """A problem with other noise `levels` (channels,) and its fit under another firm loss."""
    new = problem.rescaled(levels)
    point = evaluate(new, loss, [fit.point.coordinates], fit.point.starts)[0]
    return new, converge(new, point, loss, steps)


# ----------------------------------------------------------------------
# What noise of the measured rotations adds to a fit's cost: a model that answers them less is not the truer for
# it.
#
# The steps of encoders go through the contact into predicted torques (`estimation/encoder_noise.py`). Back wheels with
# less grip, say, make less of that noise, and so a better fit of recordings with nothing hidden.
# ----------------------------------------------------------------------


def excess_of(problem: Problem, fit: Fit, rivals: Sequence[Rival], number: int) -> list[float]:
    """Cost that the noise makes in `fit` and not in each rival, all fitted under the same loss; never negative.

    A rival that answers the noise more gets nothing for it: fits were not made to weigh that.
    """
    noisy = with_noisy_inputs(problem, number)
    mine = answers(problem, noisy, fit.point)
    counts = np.sum([window.counts for window in problem.windows], axis=0) / fit.loss.thinning
    found = []
    for rival in rivals:
        theirs = noisy.with_parameters(rival.problem.parameters)
        less = mine - answers(rival.problem, theirs, rival.fit.point)
        total = sum(n * _usual(column) for n, column in zip(counts, less.T, strict=True) if n > 0.0)
        found.append(max(0.0, float(total)))
    return found


def _usual(values: Array) -> float:
    """Mean (of numbers, NaN left out) without the largest and the smallest fifth: windows that took another branch."""
    known = values[np.isfinite(values)]
    return float(trim_mean(known, 0.2)) if len(known) else 0.0
