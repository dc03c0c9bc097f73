"""What is left when no effect on the list explains the data: which force follows which variable, and in which form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.screening import Around
from artibot_sim.diagnose.policy import FORCE_NATS, TIE, TIE_SHARE
from artibot_sim.diagnose.records import Unexplained
from artibot_sim.diagnose.unlisted.forms import WANDERING, Form, forms, unit
from artibot_sim.diagnose.unlisted.response import WINDOWS, answers, instants, short, whole_answers
from artibot_sim.diagnose.unlisted.ridges import ridges
from artibot_sim.diagnose.unlisted.search import (
    Equations,
    ForceCandidate,
    InForce,
    basis,
    candidates,
    families,
    judged,
    scattered,
    solve,
)
from artibot_sim.diagnose.unlisted.variables import PLACE, Scene, scene
from artibot_sim.diagnose.words import NOTHING, effect_words
from artibot_sim.estimation.parallel import check_time
from artibot_sim.estimation.problem import Problem
from artibot_sim.identify.result import spaced

Array = NDArray[np.float64]

_ROUNDS = 3
_FARTHEST, _WITH_FORCE = 0.15, 0.25
"""Largest change of a parameter's logarithm from one regression to the next, and beside a force."""
_RIVALS = 12
"""Of the best forces so many are kept."""
_SHORTLISTED = 200
"""So many at most has the model to choose from: half of them gain most, the others are proven most."""
_SOIL_LIKE = (
    ("lateral force of each wheel", "own lateral speed", ("linear", "Coulomb-like")),
    ("longitudinal force of each wheel", "own slip", ("linear", "Coulomb-like")),
    ("longitudinal force of each wheel", "own speed", ("linear", "Coulomb-like")),
)  # fmt: skip
"""What a wrong soil looks like."""
_ON_GROUND = (
    "lateral force of each wheel", "longitudinal force of each wheel", "front sway force", "front surge force",
    "front yaw moment",
)  # fmt: skip
"""Forces that may repeat over the ground."""


@dataclass(frozen=True)
class Shortlisted:
    """A force that the regression leaves possible.

    Attributes
    ----------
    candidate : ForceCandidate
    typical : float
        Its root mean square, N or N m.
    per_recording : tuple of (str, float)
        Names, and the same in each.
    span : (float, float)
        Between which values its variable mostly was; of ridges two periods.
    soil : array, shape (p,)
        Coordinates that go with it.
    """

    candidate: ForceCandidate
    typical: float
    per_recording: tuple[tuple[str, float], ...]
    span: tuple[float, float]
    soil: Array


@dataclass(frozen=True)
class ForceFinding:
    """What a regression of the residuals found.

    Attributes
    ----------
    chosen : tuple of ForceCandidate
        The force that it found, then others that were found beside it as laws; none where no force explains enough.
    rivals : tuple of ForceCandidate
        The best ones, best first, the chosen one included.
    typical : float
        Root mean square of the first force, N or N m.
    per_recording : tuple of (str, float)
        Names, and the same in each.
    soil : array, shape (p,)
        Coordinates that go with what was found.
    freed : array, shape (p,)
        Those that go with forces that may be any.
    spans : tuple of (float, float)
        Between which values the variable of each chosen force mostly was; of ridges two periods.
    shortlist : tuple of Shortlisted
        The forces that the model itself has to choose from, which tells more of them than the regression.
    """

    chosen: tuple[ForceCandidate, ...]
    rivals: tuple[ForceCandidate, ...]
    typical: float
    per_recording: tuple[tuple[str, float], ...]
    soil: Array
    freed: Array
    spans: tuple[tuple[float, float], ...] = ()
    shortlist: tuple[Shortlisted, ...] = ()

    def instead(self, chosen: Sequence[Shortlisted]) -> ForceFinding:
        """The finding with other forces chosen."""
        first = chosen[0]
        return replace(
            self, chosen=tuple(one.candidate for one in chosen), typical=first.typical,
            per_recording=first.per_recording, soil=first.soil, spans=tuple(one.span for one in chosen),
        )  # fmt: skip

    def as_large(self, size: float) -> ForceFinding:
        """The finding with the first force as large as whole windows have it."""
        first = self.chosen[0]
        times = abs(size / (first.form.size(first.coefficients) or size))
        each = tuple((name, times * typical) for name, typical in self.per_recording)
        return replace(self, typical=times * self.typical, per_recording=each)


def unexplained(problem: Problem, coordinates: Array, rounds: int = _ROUNDS) -> ForceFinding | None:
    """The forces that may be what a fit does not explain; None if there are none.

    Where one explains enough by itself it is chosen; else it is for the model to say whether any does (`fitting`).
    A force that the fit does not know of has bent the soil to its own ends. Windows of tenths of a second in which
    forces may scatter say less of the soil, and are not bent. So the regression is made again where they would have it;
    the one whose force explains most says which it is.

    Parameters
    ----------
    problem : Problem
        Recordings and parameters, effects among them or not.
    coordinates : array, shape (p,)
        Where the fit ended.
    rounds : int
    """
    best = now = search_forces(problem, coordinates)
    shortlist = now.shortlist
    for _ in range(rounds - 1):
        if not now.rivals:
            break
        now = search_forces(problem, now.freed)
        shortlist += now.shortlist
        if now.chosen and (not best.chosen or now.chosen[0].worth > best.chosen[0].worth):
            best = now
    return replace(best, shortlist=_each_once(shortlist)) if shortlist else None


def _each_once(found: Sequence[Shortlisted]) -> tuple[Shortlisted, ...]:
    """The best of each force in each form, as many as are tried; those that gain most come first."""
    named = dict[tuple[str, ...], Shortlisted]()
    for one in sorted(found, key=lambda one: one.candidate.net_gain):
        form = one.candidate.form
        named[one.candidate.force, form.variable, form.times, form.name] = one
    promising = {id(one) for one in _most_promising([one.candidate for one in named.values()])}
    kept = [one for one in named.values() if id(one.candidate) in promising]
    return tuple(sorted(kept, key=lambda one: -one.candidate.net_gain))


def _most_promising(found: Sequence[ForceCandidate]) -> list[ForceCandidate]:
    """Those that gain most and those that are proven most, as many as are tried."""
    different = different_ones([one for one in found if one.net_gain > 0.0])
    gained, proven = (
        sorted(different, key=key, reverse=True)[: _SHORTLISTED // 2]
        for key in (lambda one: one.net_gain, lambda one: one.worth)
    )
    return [*{id(one): one for one in (*gained, *proven)}.values()]


def different_ones(found: Sequence[ForceCandidate]) -> list[ForceCandidate]:
    """One of those that are just the same.

    The lateral forces at two wheels side by side are the same on a module, if they follow what is the same there.
    """
    different = dict[tuple[str, str, str, str, str], ForceCandidate]()
    for one in found:
        said = f"{one.gain:.6g}", f"{one.coefficients[0]:.6g}"
        different.setdefault((one.form.variable, one.form.times, one.form.name, *said), one)
    return [*different.values()]


def unexplained_of(found: ForceFinding) -> Unexplained:
    """A finding in words."""
    first = found.chosen[0]
    size = first.form.size(first.coefficients)
    return Unexplained(
        first.force, first.form.variable, first.form.name, float(f"{size:.3g}"),
        unit(first.force, first.form.per), _where(found), float(f"{found.typical:.3g}"),
    )  # fmt: skip


def search_forces(problem: Problem, coordinates: Array, windows: int = WINDOWS) -> ForceFinding:
    """What force explains the residuals at `coordinates` (p,), with all that was weighed; so many windows at most."""
    few = short(problem, windows)
    if not len(few):  # too little is measured to tell within tenths of a second which force acts
        return ForceFinding((), (), 0.0, (), coordinates, coordinates)
    equations, of = regression(few, coordinates)
    ranked = weighed(equations, of)
    shortlist = shortlisted(problem, coordinates, _most_promising(ranked), of, few)
    freed = _taken_back(problem, coordinates, equations)
    found = ForceFinding((), tuple(ranked[:_RIVALS]), 0.0, (), coordinates, freed, shortlist=shortlist)
    first = ranked[0]
    return found if first.worth < FORCE_NATS else found.instead(shortlisted(problem, coordinates, [first], of, few))


def shortlisted(
    problem: Problem, coordinates: Array, found: Sequence[ForceCandidate], of: Scene, few: Problem
) -> tuple[Shortlisted, ...]:
    """Forces that a regression of the windows `few` found at `coordinates` (p,), for the model to choose from."""
    return tuple(_shortlisted(problem, coordinates, one, of, few) for one in found)


def _shortlisted(problem: Problem, coordinates: Array, found: ForceCandidate, of: Scene, few: Problem) -> Shortlisted:
    soil = problem.parameters.inside(coordinates + np.clip(found.change, -_WITH_FORCE, _WITH_FORCE))
    return Shortlisted(found, *_sizes(of, found, *few.recordings), _span(of, found), soil)


def _span(of: Scene, found: ForceCandidate) -> tuple[float, float]:
    """Between which values the variable of a force mostly was."""
    form = found.form
    if form.wave is not None:
        return 0.0, 4.0 * np.pi / float(np.hypot(*form.wave))
    if form.variable == NOTHING:
        return 0.0, 1.0
    every = np.concatenate([of[part].follows[form.variable] for part in found.parts])
    low, high = np.quantile(every, (0.02, 0.98)).tolist()
    return low, high


def regression(few: Problem, coordinates: Array) -> tuple[Equations, Scene]:
    """What recordings in short windows say of forces at `coordinates` (p,), and what forces may follow there.

    Fitted beside any force are the parameters and what a wrong law of contact looks like.
    """
    found, of = answers(few, coordinates), scene(few, coordinates)
    information = few.parameters.prior_information
    equations = scattered(found, few.recordings[1], information, information @ coordinates, few.parameters.robot)
    for force, form in _law_of_contact(of):
        equations = equations.with_columns(_columns(equations, of, families(of)[force], form))
    return equations, of


def promised(base: Around) -> tuple[list[ForceCandidate], Scene]:
    """What sensitivities of whole windows promise of forces around a fit, the one that gains most first.

    Forces on one side of a line are not among them, nor waves in time that fits of others reach.
    """
    (equations, of), found = whole_regression(base), list[ForceCandidate]()
    for force, parts in families(of).items():
        check_time()
        usual = judged(equations, of, force, parts, lambda form: form.edge is None and not form.between)
        found += [one for one, _ in usual]
        repeated = _repeated(equations, of, force, parts)
        found += [repeated] if repeated else []
    changes = np.zeros((len(found), len(base.point.coordinates)))
    changes[:, list(base.free)] = [one.change for one in found]
    whole = [replace(one, change=change) for one, change in zip(found, changes, strict=True)]
    return different_ones(sorted(whole, key=lambda one: -one.net_gain)), of


def _repeated(equations: Equations, of: Scene, force: str, parts: Sequence[str]) -> ForceCandidate | None:
    """The best of a family of forces that repeats over the ground, where all recordings share a map."""
    in_map = any(PLACE in one.follows for one in of.values())
    return ridges(equations, of, force, parts) if in_map and force in _ON_GROUND else None


def whole_regression(base: Around) -> tuple[Equations, Scene]:
    """What recordings in whole windows say of small forces around a fit, and what forces may follow there."""
    problem, point, index = base.problem, base.point, list(base.free)
    at, prior = instants(problem), problem.parameters.prior_information
    slope = (prior @ point.coordinates)[index]
    equations = Equations.of(whole_answers(base, at), problem.recordings[1], prior[np.ix_(index, index)], slope)
    return equations, scene(problem, point.coordinates, at, point.starts)


def acting(equations: Equations, of: Scene, candidate: ForceCandidate) -> Array:
    """A force as it was found, in the components' terms, shape (windows, f)."""
    return np.asarray(_columns(equations, of, candidate.parts, candidate.form) @ candidate.coefficients)


def _taken_back(problem: Problem, coordinates: Array, equations: Equations) -> Array:
    """Coordinates as short windows ask for them, in which forces scatter; not too far at a time."""
    step = np.clip(solve(*equations.among.whole)[: len(coordinates)], -_FARTHEST, _FARTHEST)
    return problem.parameters.inside(coordinates + step)


def _law_of_contact(of: Scene) -> Iterator[tuple[str, Form]]:
    """Forces of all wheels alike as a wrong soil makes them, beyond what is linear in its parameters: fitted beside."""
    for force, variable, names in _SOIL_LIKE:
        parts = families(of).get(force, ())
        if parts:
            every = np.stack([of[part].follows[variable] for part in parts])
            yield from ((force, form) for form in forms(variable, every, 1) if form.name in names)


def _columns(equations: Equations, of: Scene, parts: Sequence[str], form: Form) -> Array:
    """A form of a family of forces in the components' terms, shape (windows, f, b)."""
    inside = InForce(equations, of, parts)
    return np.asarray(inside.T @ inside.basis(form))


def weighed(equations: Equations, of: Scene) -> list[ForceCandidate]:
    """All candidates, best first.

    What many are proven to be worth differs by chance alone, for no window says much for any. Of those that are as
    good as the best, so much being a tie among effects, the one comes first that gains most for its coefficients; what
    wanders in time last, for any of the others may look so.
    """
    found: list[ForceCandidate] = []
    for force, parts in families(of).items():
        check_time()
        found += candidates(equations, of, force, parts)
        repeated = _repeated(equations, of, force, parts)
        found += [repeated] if repeated else []
    level = max(one.worth for one in found)
    level -= max(TIE, TIE_SHARE * level)

    def order(one: ForceCandidate) -> tuple[bool, bool, float]:
        return (False, one.form.name == WANDERING, -one.net_gain) if one.worth >= level else (True, False, -one.worth)

    return sorted(found, key=order)


def _sizes(
    of: Scene, candidate: ForceCandidate, names: Sequence[str], recording: NDArray[np.int64]
) -> tuple[float, tuple[tuple[str, float], ...]]:  # fmt: skip
    """Root mean square of a force over everything, and in each recording."""
    values = basis([of[part] for part in candidate.parts], candidate.form, recording) @ candidate.coefficients
    each = tuple((name, _rms(values[recording == k])) for k, name in enumerate(names))
    return _rms(values), each


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _where(found: ForceFinding) -> str:
    first = found.chosen[0]
    each = ", ".join(f"{name} {size:.2g}" for name, size in found.per_recording)
    text = f"{found.typical:.2g} {spaced(unit(first.force))} on average ({each})"
    for other in found.chosen[1:]:
        text += effect_words(f"; beside it {other.force} against {other.form.variable}, {other.form.name}")
    return text
