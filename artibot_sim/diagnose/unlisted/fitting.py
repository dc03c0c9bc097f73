"""Forces that were found, as terms of the model: translated into laws, and fitted beside soil and starts.

The search for forces (`finding`) is a linear regression over tenths of a second. What it finds is simulated here over
whole windows, as every listed effect is, and stays only if it lowers the same loss by as much as an effect has to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import with_effect, without_effect
from artibot_sim.diagnose.policy import FORCE_NATS
from artibot_sim.diagnose.unlisted.finding import ForceFinding
from artibot_sim.diagnose.unlisted.search import ForceCandidate
from artibot_sim.diagnose.words import NOTHING
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, converge, restarted_windows
from artibot_sim.estimation.solver import evaluate
from artibot_sim.model.effects import LAWS
from artibot_sim.model.effects.base import Search
from artibot_sim.model.effects.force_law import PARAMETERS, PLACES, VARIABLES, place_words, variable_words
from artibot_sim.model.effects.parts import names_of

Array = NDArray[np.float64]

_TURNS = {"periodic, once a turn": 1, "periodic, twice a turn": 2}
_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of what the regression says, from which a fit is begun: in the soil that is there it may be too much."""
_FEW, _MANY = 3, 8
"""Steps of a fit with a law that may not stay, and with all that do."""


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
    """

    problem: Problem
    fit: Fit
    nats: float
    spans: Mapping[str, tuple[float, float]]


@cache
def _places(modules: int) -> dict[str, str]:
    """Words for where a law acts on so many modules → its name there."""
    return {place_words(name): name for name in names_of(tuple(PLACES), modules)}


@cache
def _variables(modules: int) -> dict[str, str]:
    """The same of what it follows."""
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
    if form.name in _TURNS and len(found.coefficients) == 2:
        law |= {"form": "periodic", "scale": 2.0 * math.pi / _TURNS[form.name]}
        return law | {"variable": variable(form.variable)}, _cosine_and_sine(found.coefficients)
    if not form.law:
        return None
    law |= {"variable": variable(form.variable), "form": form.law, "scale": form.scale}
    if form.times:
        law |= {"times": variable(form.times), "times_form": form.times_law, "times_scale": form.times_scale}
    return law, found.coefficients


def _cosine_and_sine(coefficients: Array) -> Array:
    """Of a cos(u) + b sin(u) = size cos(u + phase): size cos(phase) and size sin(phase)."""
    return coefficients * np.array([1.0, -1.0])


def extension_of(name: str, law: dict[str, Any], size: Array) -> Extension:
    """The law of this name in a fit: its coordinate is 1 where it is as large as was found."""
    typical = float(np.hypot(*size)) if len(size) == 2 else abs(float(size[0]))
    search = Search({"size": typical}, direction="phase" if len(size) == 2 else "")
    fixed = {key: one.neutral for key, one in PARAMETERS.items() if key not in ("size", search.direction)}
    return Extension(name, fixed | law, own=search)


def fitted_laws(
    problem: Problem, fit: Fit, found: ForceFinding, tick: Callable[[], None] = lambda: None
) -> FittedLaws | None:
    """The forces of a finding as laws, one after the other, as long as each is worth it; None where none is.

    Parameters
    ----------
    problem, fit : Problem, Fit
        The model without, at whose residuals the forces were found.
    """
    now, spans = (problem, fit), dict[str, tuple[float, float]]()
    free = [name for name in LAWS if name not in problem.parameters.robot.effects]
    for candidate, span in zip(found.chosen, found.spans, strict=True):
        translated = law_of(candidate, len(problem.parameters.robot.modules))
        if translated is not None and len(spans) < len(free):
            name = free[len(spans)]
            more = _with_law(*now, extension_of(name, *translated), translated[1], found.soil)
            if now[1].point.cost - more[1].point.cost > 2.0 * FORCE_NATS:
                now, spans[name] = more, span
        tick()
    if not spans:
        return None
    larger, last = _needed(now[0], converge(now[0], now[1].point, fit.loss, _MANY))
    kept = {law.id: spans[law.id] for law in larger.parameters.extensions if law.id in spans}
    return FittedLaws(larger, last, 0.5 * (fit.point.cost - last.point.cost), kept)


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


def _with_law(problem: Problem, fit: Fit, law: Extension, size: Array, soil: Array) -> tuple[Problem, Fit]:
    """A model with one more law, fitted by a few steps from the best of several beginnings."""
    larger, own = with_effect(problem, law), size / law.search.sizes["size"]
    beginnings = [fit.point.coordinates]
    if len(soil) == len(fit.point.coordinates):
        beginnings.append(soil)
    places = [np.concatenate([at, share * own]) for at in beginnings for share in _SHARES]
    point = min(evaluate(larger, fit.loss, places, fit.point.starts), key=lambda one: one.cost)
    point = restarted_windows(larger, fit.loss, point)
    return larger, converge(larger, point, fit.loss, _FEW)
