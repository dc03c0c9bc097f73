"""Forces that were found, as terms of the model: translated into laws, and fitted beside soil and starts.

The search for forces (`finding`) is a linear regression over tenths of a second. What it finds is simulated here over
whole windows, as every listed effect is, and stays only if it lowers the same loss by as much as an effect has to.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import with_effect, without_effect
from artibot_sim.diagnose.candidates.screening import Around, around
from artibot_sim.diagnose.policy import FORCE_NATS, TIE
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.unlisted.along_law import residual_forces
from artibot_sim.diagnose.unlisted.finding import (
    ForceFinding,
    Shortlisted,
    promised,
    shortlisted,
    unexplained,
)
from artibot_sim.diagnose.unlisted.search import ForceCandidate
from artibot_sim.diagnose.words import NOTHING
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parallel import check_time, side_by_side
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem, Sensitivity, clip
from artibot_sim.estimation.search import Fit, converge, restarted_windows
from artibot_sim.estimation.solver import Point, evaluate, step
from artibot_sim.model.effects import LAWS
from artibot_sim.model.effects.base import Search
from artibot_sim.model.effects.force_law import PARAMETERS, PLACES, VARIABLES, place_words, variable_words
from artibot_sim.model.effects.parts import names_of

Array = NDArray[np.float64]

_TURNS = {"periodic, once a turn": 1, "periodic, twice a turn": 2}
_FEW, _MANY = 3, 8
"""Steps of a fit with a law that may not stay, and with all that do."""
_SEARCHES = 3
"""Times at most that all forces are tried for the first law; for others, on a soil that is less bent, once."""
_BEGUN, _PROMISED = 14, 10
"""So many of them as the regression has them, and so many as sensitivities do."""
_ALIKE, _WAVES = 4, 2
"""So many forms of a force that follows the same, and so many waves among them."""
_ADAPTED = (24, 12)
"""How many laws take a step by sensitivities that are known, and how many of them, the best ones so far, another."""
_STAGES = ((3, 6), (6, 2))
"""Steps of the fits by which a law is chosen, and of how many of them: the best ones so far."""
_WINDOWS = 16
"""Windows by which laws are chosen, at most."""


@dataclass(frozen=True)
class FittedLaws:
    """The model with laws, fitted to whole windows.

    Attributes
    ----------
    problem, fit : Problem, Fit
        The laws are the last extensions of its parameters, after the effects beside which they were fitted.
    nats : float
        What they gain together over the model without.
    spans : mapping of str to (float, float)
        Between which values each law's variable mostly was.
    residuals : mapping of str to array
        What short windows ask for beside each law along its variable, see `residual_forces`.
    force : ForceFinding
        The finding, with the laws' forces chosen; with its own where that is no term of the model and is still missing.
    """

    problem: Problem
    fit: Fit
    nats: float
    spans: Mapping[str, tuple[float, float]]
    residuals: Mapping[str, Array]
    force: ForceFinding


@cache
def _places(modules: int) -> dict[str, str]:
    """Words for where a law acts on so many modules → its name there."""
    return {place_words(name): name for name in names_of(tuple(PLACES), modules)}


@cache
def _variables(modules: int) -> dict[str, str]:
    """Words for what a law follows on so many modules → its name there."""
    return {variable_words(name)[0].removeprefix("own "): name for name in names_of(tuple(VARIABLES), modules)}


def law_of(found: ForceCandidate, modules: int = 2) -> tuple[dict[str, Any], Array] | None:
    """A force that was found on a robot of so many modules, as a law: what is fixed of it, and its size.

    Of what is periodic, the size's cosine and sine of the phase.

    None for what the model has no term for: forces towards a point, and those that wander or begin anew in every
    recording.
    """
    form, where = found.form, _places(modules).get(found.force)
    if where is None:
        return None

    def variable(words: str) -> str:
        return "nothing" if words == NOTHING else _variables(modules)[words.removeprefix("own ")]

    law: dict[str, Any] = {"where": where}
    if form.wave is not None:
        along, across = form.wave
        law |= {"variable": "place", "form": "periodic", "scale": 2.0 * math.pi / math.hypot(along, across)}
        return law | {"direction": math.atan2(across, along)}, _cosine_and_sine(found.coefficients)
    if form.law == "periodic":
        law |= {"variable": variable(form.variable), "form": form.law, "scale": form.scale}
        return law, _cosine_and_sine(found.coefficients)
    if form.name in _TURNS and len(found.coefficients) == 2:
        law |= {"form": "periodic", "scale": 2.0 * math.pi / _TURNS[form.name]}
        return law | {"variable": variable(form.variable)}, _cosine_and_sine(found.coefficients)
    if not form.law:
        return None
    law |= {"variable": variable(form.variable), "form": form.law, "scale": form.scale}
    if form.times:
        law |= {"times": variable(form.times), "times_form": form.times_law, "times_scale": form.times_scale}
    if form.edge is not None:
        law |= {"direction": form.edge[0], "offset": form.edge[1]}
    return law, found.coefficients


def _cosine_and_sine(coefficients: Array) -> Array:
    """Of a cos(u) + b sin(u) = size cos(u + phase): size cos(phase) and size sin(phase)."""
    return coefficients * np.array([1.0, -1.0])


def extension_of(name: str, law: dict[str, Any], size: Array, reach: float = 0.0) -> Extension:
    """The law of this name in a fit: its size is 1 where it is as large as was found, 0 where it is absent.

    What its last variable is measured by (a period, where a threshold is, how fast it decays) is fitted with it, up to
    a change of its logarithm by `reach`; of what begins at a place that place, up to so far.
    """
    typical, direction = float(np.linalg.norm(size)), "phase" if len(size) == 2 else ""
    scale = "offset" if "offset" in law else "times_scale" if "times" in law else "scale"
    around = {scale: float(law[scale])} if reach else {}
    search = Search({"size": typical} | dict.fromkeys(around, reach), direction=direction, around=around)
    fixed, own = {key: one.neutral for key, one in PARAMETERS.items()} | law, ("size", direction, *around)
    return Extension(name, {key: value for key, value in fixed.items() if key not in own}, own=search)


def as_found(size: Array) -> dict[str, float]:
    """Size and phase of a law from what the regression says: the size (1,), or its cosine and sine (2,)."""
    if len(size) == 2:
        return {"size": float(np.hypot(*size)), "phase": float(np.arctan2(size[1], size[0]))}
    return {"size": float(size[0])}


def fitted_laws(
    problem: Problem,
    fit: Fit,
    found: ForceFinding,
    tick: Callable[[], None] = lambda: None,
    begin: Point | None = None,
    most: int = len(LAWS),
) -> FittedLaws | None:
    """The forces of a finding as laws, one after the other, as long as each is worth it; None where none is.

    What forces are worth in the regression is limited by how windows scatter, and many tie there that are far from each
    other over whole windows. So the model itself chooses among all that it leaves possible. With one law in the model
    the next is looked for in what that leaves. A force that is no term of the model stays in words, unless laws leave
    no more than noise.

    Parameters
    ----------
    problem, fit : Problem, Fit
        The model without.
    begin : Point, optional
        Of that model, at whose residuals the force was found; where the fit ended by default.
    most : int
        Laws at most.
    """
    begin = begin or fit.point
    now, spans, chosen = (problem, fit), dict[str, tuple[float, float]](), list[Shortlisted]()
    left: ForceFinding | None = found
    for name in [name for name in LAWS if name not in problem.parameters.robot.effects][:most]:
        best = None if left is None else _best_law(now[0], fit.loss, name, left, begin, tick)
        if best is None:
            break
        last = _fitted(now[0], fit.loss, begin, best)
        tick()
        if now[1].point.cost - last[1].point.cost <= 2.0 * FORCE_NATS:
            break
        now, spans[name] = last, best.found.span
        chosen.append(best.found)
        if not leaves_more_than_noise(remains(now[0], now[1].point)):
            break
        begin = now[1].point
        left = unexplained(now[0], begin.coordinates, 1)
    if not spans:
        return None
    larger, last_fit = _needed(now[0], converge(now[0], now[1].point, fit.loss, _MANY))
    kept = {law.id: spans[law.id] for law in larger.parameters.extensions if law.id in spans}
    stayed = [one for one, name in zip(chosen, spans, strict=True) if name in kept]
    residuals = {
        name: residual_forces(larger, last_fit.point.coordinates, name, one.candidate)
        for name, one in zip(kept, stayed, strict=True)
    }
    modules = len(problem.parameters.robot.modules)
    no_term = bool(found.chosen) and law_of(found.chosen[0], modules) is None
    if not (no_term and leaves_more_than_noise(remains(larger, last_fit.point))):
        found = found.instead(stayed)
    return FittedLaws(larger, last_fit, 0.5 * (fit.point.cost - last_fit.point.cost), kept, residuals, found)


@dataclass(frozen=True)
class _Law:
    """A law that may be, in the model of the windows by which one is chosen, as far as it is fitted to them."""

    found: Shortlisted
    extension: Extension
    problem: Problem
    point: Point


def _best_law(
    problem: Problem, loss: Loss, name: str, found: ForceFinding, begin: Point, tick: Callable[[], None]
) -> _Law | None:
    """Which of the forces that may be the model asks for most; None if there is none.

    So many windows tell. A force that the fit does not know of has bent the soil: neither the regression nor
    sensitivities say there with certainty which it is. So forces begin where either has them, and are fitted side by
    side, the best of them further and further. While more than noise is left, all are tried again on the soil that goes
    with the best one.
    """
    rows = np.unique(np.linspace(0, len(problem) - 1, _WINDOWS).round().astype(int))
    part, best, shortlist = problem.part(rows.tolist()), None, found.shortlist
    point = evaluate(part, loss, [begin.coordinates], begin.starts[rows])[0]
    for _ in range(_SEARCHES if name == LAWS[0] else 1):
        base = around(part, loss, point)
        left = [*_by_regression(part, loss, name, shortlist, point), *_by_sensitivities(base, name)]
        for most in _ADAPTED:
            left = sorted(left, key=lambda law: law.point.cost)[:most]
            left = side_by_side(partial(_adapted, base), left, problem.workers, tick)
        for steps, most in _STAGES:
            left = sorted(left, key=lambda law: law.point.cost)[:most]
            left = side_by_side(partial(_further, loss, steps), left, problem.workers, tick)
        now = _simplest(left)
        if now is None or (best is not None and best.point.cost - now.point.cost <= 2.0 * FORCE_NATS):
            break
        best = now
        if not leaves_more_than_noise(remains(best.problem, best.point)):
            break
        _, point = without_effect(best.problem, loss, best.point)
        again = unexplained(problem, point.coordinates, 1)
        shortlist = () if again is None else again.shortlist
    return best


def _by_regression(part: Problem, loss: Loss, name: str, shortlist: Sequence[Shortlisted], point: Point) -> list[_Law]:
    """Those forces of a regression that are best as it has them: as large, on the soil that goes with each."""
    begun = [law for one in shortlist if (law := _begun(part, loss, name, one, point.starts)) is not None]
    begun.sort(key=lambda law: law.point.cost)
    kept = {id(one) for one in _a_few_of_each([law.found.candidate for law in begun])[:_BEGUN]}
    return [law for law in begun if id(law.found.candidate) in kept]


def _by_sensitivities(base: Around, name: str) -> list[_Law]:
    """Those forces, of all that there are, that sensitivities of whole windows promise most of, as these have them.

    On the soil that would go with each, or as it is: far from where they were taken sensitivities tell little of it.
    """
    part, point = base.problem, base.point
    found, of = promised(base)
    terms = [one for one in found if law_of(one, len(part.parameters.robot.modules)) is not None]
    begun = list[_Law]()
    for one in shortlisted(part, point.coordinates, _a_few_of_each(terms)[:_PROMISED], of, part):
        soils = replace(one, soil=point.coordinates), one
        each = [law for at in soils if (law := _begun(part, base.loss, name, at, point.starts)) is not None]
        begun.append(min(each, key=lambda law: law.point.cost))
    return begun


def promise(problem: Problem, fit: Fit) -> float:
    """Nats that sensitivities of whole windows promise of the best law beside a fit, its coefficients paid for."""
    found, _ = promised(around(problem, fit.loss, fit.point))
    modules = len(problem.parameters.robot.modules)
    return max((one.net_gain for one in found if law_of(one, modules) is not None), default=0.0)


def _simplest(laws: Sequence[_Law]) -> _Law | None:
    """The one that explains most; of those that tie with it one with the fewest numbers, and then variables.

    Of a joint that bends to one side only, a spring and friction that grows with the angle are the same force.
    """
    least = min((law.point.cost for law in laws), default=0.0) + 2.0 * TIE
    close = [law for law in laws if law.point.cost <= least]
    return min(
        close,
        key=lambda law: (len(law.extension), law.found.candidate.form.times != "", law.point.cost),
        default=None,
    )


def _a_few_of_each(found: Sequence[ForceCandidate]) -> list[ForceCandidate]:
    """Of each force that follows the same so many forms at most, one of those that differ in a fitted scale alone.

    The order stays.
    """
    count, kept = Counter[tuple[object, ...]](), list[ForceCandidate]()
    for one in found:
        force, form = one.force, one.form
        across = None if form.edge is None else form.edge[0]
        kinds = (force, form.variable), (force, form.variable, form.law, form.times, form.times_law, across)
        most = _ALIKE, _WAVES if form.law == "periodic" else 1
        if all(count[kind] < limit for kind, limit in zip(kinds, most, strict=True)):
            kept.append(one)
            count.update(kinds)
    return kept


def _extension(name: str, found: ForceCandidate, modules: int) -> Extension | None:
    """A force as a law in a fit; None if it is no term of the model."""
    translated = law_of(found, modules)
    return None if translated is None else extension_of(name, *translated, found.form.reach)


def _begun(part: Problem, loss: Loss, name: str, found: Shortlisted, starts: Array) -> _Law | None:
    """A force as the regression has it; None if it is no term of the model."""
    check_time()
    modules = len(part.parameters.robot.modules)
    extension = _extension(name, found.candidate, modules)
    if extension is None:
        return None
    law, size = law_of(found.candidate, modules) or ({}, np.empty(0))
    larger, own = with_effect(part, extension), extension.coordinates(law | as_found(size))
    return _Law(found, extension, larger, evaluate(larger, loss, [np.concatenate([found.soil, own])], starts)[0])


def _adapted(base: Around, law: _Law) -> _Law:
    """A law one step further: soil and starts by their sensitivities around the fit without it, known for all laws."""
    check_time()
    problem, point = law.problem, law.point
    index = range(len(base.point.coordinates), len(problem.parameters))
    moves = problem.parameters.steps(point.coordinates)[list(index)]
    moved = [
        point.coordinates + move * one for move, one in zip(moves, np.eye(len(point.coordinates))[index], strict=True)
    ]
    own = (problem.flat_residuals(moved, point.starts) - point.residuals.flat) / moves[:, None]
    clip(problem.samples, own)
    known = Sensitivity(np.concatenate([base.sensitivity.parameters, own]), base.sensitivity.starts)
    return replace(law, point=step(problem, base.loss, point, (*base.free, *index), known=known)[0])


def _further(loss: Loss, steps: int, law: _Law) -> _Law:
    check_time()
    return replace(law, point=converge(law.problem, law.point, loss, steps).point)


def _fitted(problem: Problem, loss: Loss, begin: Point, law: _Law) -> tuple[Problem, Fit]:
    """The model with a law, fitted to all windows from where those went by which it was chosen."""
    larger = with_effect(problem, law.extension)
    point = evaluate(larger, loss, [law.point.coordinates], begin.starts)[0]
    return larger, converge(larger, restarted_windows(larger, loss, point), loss, _FEW)


def _needed(problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
    """The model without the laws that the others make up for: found beside them before these were fitted to the end."""
    laws = [law.id for law in problem.parameters.extensions if law.id in LAWS]
    for name in reversed(laws[1:]):
        which = [law.id for law in problem.parameters.extensions].index(name)
        part, point = without_effect(problem, fit.loss, fit.point, which)
        less = converge(part, point, fit.loss, _FEW)
        if less.point.cost - fit.point.cost <= 2.0 * FORCE_NATS:
            problem, fit = part, less
    return problem, fit
