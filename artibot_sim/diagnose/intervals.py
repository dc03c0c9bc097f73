"""A diagnosis' values and how sure they are: where the fit could have ended as well, and what the other view says.

What lies around the fit and what windows weighted at random make of it are found as in an identification
(`estimation/surroundings.py`, `estimation/uncertainty.py`). The mean of all draws is the value, for single places hold
by chance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.records import EffectEstimate
from artibot_sim.estimation.parameters import Extension, ParameterSet
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.estimation.surroundings import Surroundings
from artibot_sim.estimation.uncertainty import from_bootstrap
from artibot_sim.identify.judgement import SYSTEMATIC

Array = NDArray[np.float64]
FromCommands = Mapping[str, Mapping[str, EffectEstimate]]
"""By effect, what another view says of its parameters."""

_OWN_SYSTEMATIC = 0.02
"""Standard deviation, as a share of an effect's coordinate, of what no residual shows."""
_NORMAL = 1.96


@dataclass(frozen=True)
class Uncertain:
    """A fit's coordinates with their covariance.

    Attributes
    ----------
    coordinates : array, shape (p,)
    covariance : array, shape (p, p)
        Of the values' logarithms and the effects' coordinates.
    """

    coordinates: Array
    covariance: Array


def judged(problem: Problem, fit: Fit, around: Surroundings, from_commands: FromCommands | None = None) -> Uncertain:
    """Values and intervals of a fit from what was found around it."""
    parameters, index = problem.parameters, list(fit.free)
    nodes, noise = around.nodes, around.noise
    bootstrap = from_bootstrap(problem, nodes, index, noise)
    mean = np.asarray(np.linalg.solve(parameters.mixing, bootstrap.mean), float)
    best = min(nodes, key=lambda node: noise.cost_without(node.point))
    curvature = np.zeros_like(bootstrap.covariance)
    information = best.reduced.matrix + parameters.prior_information[np.ix_(index, index)]
    curvature[np.ix_(index, index)] = np.linalg.inv(information)
    both = [parameters.mixing @ curvature @ parameters.mixing.T, bootstrap.covariance]
    wider = max(both, key=np.trace)
    sd = np.sqrt(np.maximum(np.diag(both[0]), np.diag(both[1])))
    scale = np.maximum(sd / np.sqrt(np.maximum(np.diag(wider), 1e-30)), 1.0)
    extra = np.full(len(parameters), SYSTEMATIC**2)
    extra[len(parameters.parameters) :] = (_OWN_SYSTEMATIC * mean[len(parameters.parameters) :]) ** 2
    return combined(parameters, Uncertain(mean, wider * np.outer(scale, scale) + np.diag(extra)), from_commands or {})


def combined(parameters: ParameterSet, what: Uncertain, from_commands: FromCommands) -> Uncertain:
    """Values once the command view has measured effects' sizes too; the soil follows by the covariance.

    Views that contradict each other are both less sure of that size than they say (Birge's ratio), and of the rest as
    far as it goes along.
    """
    mean, covariance = parameters.mixing @ what.coordinates, what.covariance
    for extension, part in zip(parameters.extensions, parameters.places, strict=True):
        seen = _measured(extension, from_commands.get(extension.id, {}))
        if seen is not None:
            (value, variance), place = seen, part.start
            total = covariance[place, place] + variance
            away = value - mean[place]
            along = covariance[:, place] / covariance[place, place]
            mean = mean + covariance[:, place] / total * away
            kept = covariance[place, place] * variance / total * max(1.0, away**2 / total)
            covariance = covariance - np.outer(along, covariance[place]) + kept * np.outer(along, along)
    return Uncertain(np.asarray(np.linalg.solve(parameters.mixing, mean), float), covariance)


def _measured(extension: Extension, found: Mapping[str, EffectEstimate]) -> tuple[float, float] | None:
    """The single coordinate of an effect and its variance as another view has them; None where it has none."""
    names = list(extension.search.sizes)
    if len(extension) != 1 or names[0] not in found or found[names[0]].ci95 is None:
        return None
    one = found[names[0]]
    assert one.ci95 is not None
    value, low, high = (float(extension.coordinates({names[0]: v})[0]) for v in (one.value, *one.ci95))
    return value, max(((high - low) / (2.0 * _NORMAL)) ** 2, 1e-12)
