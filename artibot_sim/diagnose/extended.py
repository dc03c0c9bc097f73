"""The robot with what was diagnosed: soil and effects with their sources and 95 % intervals."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.patches import Place
from artibot_sim.diagnose.intervals import Uncertain
from artibot_sim.diagnose.records import EffectEstimate
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.problem import Problem
from artibot_sim.model import Robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.model.robot.quantity import Quantity

Array = NDArray[np.float64]

_NORMAL = 1.96


def found_parameters(
    extension: Extension, own: Array, covariance: Array, places: Mapping[str, Place] | None = None
) -> dict[str, EffectEstimate]:
    """Values with intervals of one effect, its choices included; `places` has where on the ground it is.

    Parameters that no search looks for are neutral, and are left out.
    """
    values = extension.values(own)
    low, high = _interval(extension, own, covariance)
    found: dict[str, EffectEstimate] = {}
    for name, parameter in extension.effect.parameters.items():
        quantity = parameter.quantity
        if name not in values:
            continue
        if isinstance(quantity, Choice):
            found[name] = EffectEstimate(str(values[name]))
        elif name in low:
            found[name] = EffectEstimate(float(values[name]), quantity.unit, (low[name], high[name]))
        else:
            value, interval = (places or {}).get(name, (float(values[name]), None))
            found[name] = EffectEstimate(value, quantity.unit, interval)
    return found


def _interval(extension: Extension, own: Array, covariance: Array) -> tuple[dict[str, float], dict[str, float]]:
    """Ends of the 95 % intervals by parameter; those of a size and its direction by their own variances."""
    search, sd = extension.search, np.sqrt(np.diag(covariance))
    names, (low, high) = list(search.sizes), extension.bounds
    first, last = (extension.values(np.clip(own + side * _NORMAL * sd, low, high)) for side in (-1.0, 1.0))
    ends = {name: (float(min(first[name], last[name])), float(max(first[name], last[name]))) for name in names}
    if search.direction:
        ends |= _of_size_and_direction(extension, own[:2], covariance[:2, :2])
    return {name: end for name, (end, _) in ends.items()}, {name: end for name, (_, end) in ends.items()}


def _of_size_and_direction(extension: Extension, own: Array, covariance: Array) -> dict[str, tuple[float, float]]:
    """Ends of the intervals of a size and its direction, from its two components and their covariance."""
    search = extension.search
    size, scale = float(np.hypot(*own)), next(iter(search.sizes.values()))
    along, across = own / size, np.array([-own[1], own[0]]) / size
    wide = _NORMAL * float(np.sqrt(along @ covariance @ along))
    turn = min(np.pi, _NORMAL * float(np.sqrt(across @ covariance @ across)) / size)
    heading, name = float(np.arctan2(own[1], own[0])), next(iter(search.sizes))
    return {
        name: (scale * max(0.0, size - wide), scale * (size + wide)),
        search.direction: (heading - turn, heading + turn),
    }


def robot_of(
    problem: Problem, what: Uncertain, causes: Mapping[str, Mapping[str, EffectEstimate]], names: Sequence[str]
) -> Robot:
    """The robot of a fit with sources and intervals of what was fitted; `causes` are the effects' parameters."""
    parameters = problem.parameters
    robot = parameters.robot_at(what.coordinates)
    where = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    sources, intervals = dict(robot.sources), dict(robot.intervals)
    for i, parameter in enumerate(parameters.parameters):
        value = float(robot.as_vector([parameter.key])[0])
        half = _NORMAL * float(np.sqrt(what.covariance[i, i]))
        sources[parameter.key] = f"identified: from {where}"
        intervals[parameter.key] = (value * float(np.exp(-half)), value * float(np.exp(half)))
    effects: dict[str, dict[str, Any]] = {name: dict(values) for name, values in robot.effects.items()}
    for effect, found in causes.items():
        effects[effect] = {name: entry.value for name, entry in found.items()}
        quantities = EFFECTS[effect].parameters
        measured = {name: one for name, one in found.items() if isinstance(quantities[name].quantity, Quantity)}
        sources |= {f"effects.{effect}.{name}": f"diagnosed: from {where}" for name in measured}
        intervals |= {f"effects.{effect}.{name}": one.ci95 for name, one in measured.items() if one.ci95 is not None}
    return replace(robot, effects=effects, sources=sources, intervals=intervals)


def with_effects_of(robot: Robot, other: Robot, names: Collection[str]) -> Robot:
    """A robot with some of another one's effects, their sources and intervals."""
    mine = {name: other.effects[name] for name in names if name in other.effects}
    theirs = tuple(f"effects.{name}." for name in mine)
    return replace(
        robot,
        effects={**robot.effects, **mine},
        sources={**robot.sources, **{key: text for key, text in other.sources.items() if key.startswith(theirs)}},
        intervals={**robot.intervals, **{key: ends for key, ends in other.intervals.items() if key.startswith(theirs)}},
    )
