"""One effect after the other: the best is added to the model until none is worth it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from artibot_sim.checkpoints import Checkpoints
from artibot_sim.diagnose.candidates.hypotheses import hypotheses
from artibot_sim.diagnose.candidates.patches import discs
from artibot_sim.diagnose.candidates.screening import Around, Trial, converged_baseline, screen
from artibot_sim.diagnose.policy import TRUST, Thresholds
from artibot_sim.diagnose.selection.evidence import Evidence, evidence
from artibot_sim.diagnose.selection.joint_fits import (
    FitCache,
    Rival,
    Rounds,
    adopted,
    contained,
    contest,
    excess_of,
    finished,
    neutralised,
    renoised,
)
from artibot_sim.estimation.checks.common_map import experiments_of, in_common_map, needed
from artibot_sim.estimation.loss import Loss, channel_levels
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge, thinned
from artibot_sim.estimation.solver import Point, evaluate
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.run import Trust
from artibot_sim.model.effects import EFFECTS

Array = NDArray[np.float64]
Tick = Callable[[], None]


@dataclass(frozen=True)
class SearchStage:
    """One search for one more effect.

    Attributes
    ----------
    trials : tuple of Trial
        Every hypothesis as the screen left it.
    rivals : tuple of Rival
        Those that were fitted, the best first.
    evidence : mapping of str to Evidence
        Of the rivals, by effect, by the view that is driven by rotations.
    problem : Problem
        The baseline of this search, with the noise that the best rival's residuals show.
    fit : Fit
        The baseline, fitted as hard as any rival.
    loss : Loss
        With that noise's colour.
    screened : float
        Cost that the trials are to be held against.
    base : Around, optional
        The baseline around which effects were screened.
    nats : mapping of str to float
        Log Bayes factors of the rivals from both views, by effect.
    by_every_window : frozenset of str
        Effects whose evidence is of all windows; of the others it is of those that were searched.
    known : FitCache
        The fits that were made on the way.
    """

    trials: tuple[Trial, ...]
    rivals: tuple[Rival, ...]
    evidence: Mapping[str, Evidence]
    problem: Problem
    fit: Fit
    loss: Loss
    screened: float
    base: Around | None = None
    nats: Mapping[str, float] = field(default_factory=dict)
    by_every_window: frozenset[str] = frozenset()
    known: FitCache = field(default_factory=FitCache, repr=False, compare=False)

    @property
    def tried(self) -> frozenset[str]:
        """Effects that the motion was asked for."""
        return frozenset(trial.id for trial in self.trials)

    def bettered(self, steps: int) -> float:
        """Nats by which the baseline is better than the one around which effects were screened.

        By the loss of that screen, after so many steps under it: by the firm loss, under which a baseline ends, it is
        better wherever windows are explained badly.
        """
        base = self.base
        if base is None or not self.rivals:
            return 0.0
        point = evaluate(base.problem, base.loss, [self.fit.point.coordinates], self.fit.point.starts)[0]
        return 0.5 * (base.point.cost - converge(base.problem, point, base.loss, steps).point.cost)


def stage(
    problem: Problem, fit: Fit, loss: Loss, named: Sequence[str], rounds: Rounds, tick: Tick = lambda: None,
    parts: Checkpoints | None = None, soils: Sequence[Point] = (), asked: Collection[str] = (),
) -> SearchStage:  # fmt: skip
    """Look for one more effect beside those in `problem`.

    The baseline is fitted again from the best rivals' soil and starts: what they found there without their effect
    is none of its evidence. Effects are tried beside other `soils` as well, which explain the recordings as well as
    that of `fit`, and held against the best of these: what another soil explains is no effect's merit. Those that are
    `asked` for are fitted whatever the screen thought of them. What is finished on the way is kept in `parts`.
    """
    parts = parts or Checkpoints()

    def screened() -> SearchStage:
        bases = [converged_baseline(problem, loss, point, rounds.few) for point in (fit.point, *soils)]
        in_map = in_common_map(experiments_of(problem.stretches))
        every = hypotheses(problem.parameters.robot, problem.stretches, named)
        tried = [one for one in every if in_map or not needed(one.id)]
        beside = zip(*(screen(base, tried, tick) for base, _ in bases), strict=True)
        trials = [min(each, key=lambda trial: trial.point.cost) for each in beside]
        base, control = min(bases, key=lambda one: one[1].cost)
        trials += discs(base) if in_map else []
        return SearchStage(tuple(trials), (), {}, problem, fit, loss, control.cost, base)

    begun = parts.once(_name("screened", named), screened)
    return _contested(begun, named, rounds, tick, parts, asked)


def _name(what: str, named: Sequence[str]) -> str:
    return f"{what} beside {', '.join(named) or 'nothing'}"


def thorough(
    found: SearchStage,
    named: Sequence[str],
    rounds: Rounds,
    tick: Tick,
    parts: Checkpoints,
) -> SearchStage:
    """A search in which every effect is fitted, whatever its screening gave, and most of them to the end.

    A probe may throw so many windows off their branch that an effect of just its size looks worse than none.
    """
    base, every = found.base, rounds.for_all(len(found.trials))
    if base is None or not found.trials:
        return found
    begun = SearchStage(
        found.trials, (), {}, base.problem, found.fit, base.loss, found.screened, base, known=found.known
    )
    return _contested(begun, named, every, tick, parts)


def _contested(
    begun: SearchStage,
    named: Sequence[str],
    rounds: Rounds,
    tick: Tick,
    parts: Checkpoints,
    asked: Collection[str] = (),
) -> SearchStage:
    """A search whose trials are screened, with the promising ones fitted and judged."""

    def fitted(some: SearchStage) -> tuple[SearchStage, list[Rival]]:
        return some, contest(some.trials, some.screened, some.loss, rounds, tick, some.known, asked)

    begun, rivals = parts.once(_name("fitted", named), partial(fitted, begun))
    if not rivals:
        return begun
    return parts.once(_name("judged", named), lambda: _judged(begun, rivals, named, rounds, tick))


def _judged(begun: SearchStage, rivals: list[Rival], named: Sequence[str], rounds: Rounds, tick: Tick) -> SearchStage:
    """Rivals and baseline fitted to the end, with the evidence of each."""
    base, problem, loss, known = begun.base, begun.problem, begun.loss, begun.known
    assert base is not None
    best, rivals = finished(base, rivals, rounds, tick, known=known)
    near = [r for r in rivals[: rounds.returns] if best.point.cost - r.fit.point.cost >= 2.0 * rounds.worth]
    others = known.all(
        lambda rival: neutralised(rival, best, loss, rounds), near, lambda rival: (neutralised, rival.fit, best),
        lambda do, some: side_by_side(do, some, problem.workers, tick),
    )  # fmt: skip
    best = min([best, *others], key=lambda fit: fit.point.cost)
    rivals = _with_starts_of(problem, best, rivals, rounds)
    problem, best, rivals, loss = _with_honest_noise(problem, best, rivals, rounds)
    rivals = side_by_side(lambda rival: contained(rival, best, rounds), rivals, problem.workers)
    rivals = sorted(rivals, key=lambda rival: rival.fit.point.cost)
    excess = excess_of(problem, best, rivals, number=len(named))
    stated = side_by_side(
        lambda one: evidence(one[0], best, one[1]), list(zip(rivals, excess, strict=True)), problem.workers
    )
    found = {rival.id: one for rival, one in zip(rivals, stated, strict=True)}
    return SearchStage(begun.trials, tuple(rivals), found, problem, best, loss, begun.screened, base, known=known)


def _with_honest_noise(
    problem: Problem, best: Fit, rivals: list[Rival], rounds: Rounds
) -> tuple[Problem, Fit, list[Rival], Loss]:
    """All fits again with the noise that the least cost leaves, the baseline's or a rival's.

    Positions alone may err as much and as slowly as they seem to: with the other sensors that is another effect, still
    to be found, and no noise.
    """
    first = min((best, rivals[0].fit), key=lambda fit: fit.point.cost)
    found = channel_levels(problem.windows, first.point.residuals)
    thinning = np.clip(thinned(problem, first).thinning, 1.0, None)
    known = np.array([name != "position" for name in CHANNEL_NAMES])
    widened = _widened(problem)
    levels = np.where(known, TRUST.levels(found, widened), Trust().levels(found, widened))
    new = Loss(1.0, np.where(known, np.minimum(thinning, TRUST.thinning), thinning))

    def steps(fit: Fit) -> int:
        """As many as close fits need, one for those that are far behind."""
        return rounds.few if fit.point.cost - first.point.cost < 2.0 * rounds.plain else 1

    firm, fits = replace(new, firm=True), [(problem, best), *((rival.problem, rival.fit) for rival in rivals)]
    (problem, best), *anew = side_by_side(
        lambda one: renoised(*one, levels, firm, steps(one[1])), fits, problem.workers
    )
    honest = [
        replace(rival, trial=replace(rival.trial, problem=own), fit=fit)
        for rival, (own, fit) in zip(rivals, anew, strict=True)
    ]
    rivals = _with_starts_of(problem, best, honest, rounds)
    best = adopted(problem, best, rivals[0].problem, rivals[0].fit, rounds)
    return problem, best, rivals, new


def _widened(problem: Problem) -> Array:
    """By how much each channel's noise is taken to be more than its sensor's own, shape (channels,)."""
    found: dict[str, float] = {}
    for window in problem.windows:
        for name, one in problem.widening(window).items():
            found[name] = min(found.get(name, one), one)
    return np.array([found.get(name, 1.0) for name in CHANNEL_NAMES])


def _with_starts_of(problem: Problem, best: Fit, rivals: Sequence[Rival], rounds: Rounds) -> list[Rival]:
    """The rivals, each with the baseline's starts where these are better; the least cost first."""
    fits = side_by_side(lambda rival: adopted(rival.problem, rival.fit, problem, best, rounds), rivals, problem.workers)
    found = [replace(rival, fit=fit) for rival, fit in zip(rivals, fits, strict=True)]
    return sorted(found, key=lambda rival: rival.fit.point.cost)


def refusal(effect: str, found: Evidence, nats: float, least: float, thresholds: Thresholds) -> str:
    """Why an effect is not named, in a few words; empty where it is.

    The size of a limit says nothing, for without it there is none.
    """
    if nats < least:
        return f"{least:.0f} nats are asked of it"
    if nats < least + thresholds.margin * found.sampling_sd:
        return "it explains too many windows worse"
    search = EFFECTS[effect].search
    if search is not None and search.reference:
        return ""
    if float(np.abs(found.own).max()) < thresholds.size:
        return f"less than {thresholds.size:g} of a plain size"
    if found.deviations < thresholds.distance:
        return f"not {thresholds.distance:g} standard deviations from neutral"
    return ""
