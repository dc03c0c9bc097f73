"""Each recording fitted by itself: where all of them together ask for no effect but for several soils."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from artibot_sim.diagnose.records import DECADE, SlowResidual, Unexplained
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.selection.joint_fits import Rounds, settled
from artibot_sim.diagnose.words import RECORDING, effect_words, odds
from artibot_sim.estimation.parallel import side_by_side
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Effort, Fit, search
from artibot_sim.estimation.solver import evaluate, reassessed
from artibot_sim.identify.result import number, spaced
from artibot_sim.model.robot.quantity import Quantity

Array = NDArray[np.float64]

_LEAST_SPREAD = 0.03
"""Differences of a soil's parameter, as a share, that are said."""


@dataclass(frozen=True)
class ByRecording:
    """What recordings say one by one.

    Attributes
    ----------
    names : tuple of str
        Of the recordings.
    soil : tuple of (str, str, array of shape (recordings,))
        Names, units and values of the soil's parameters.
    sizes : tuple of (str, str, array of shape (recordings,))
        The same of the effects that were fitted.
    nats : float
        Log Bayes factor of a soil of its own in each against one for all.
    left : tuple of mapping of str to SlowResidual
        What each fit leaves, by channel.
    effects : mapping of str to array, shape (recordings, k)
        Coordinates of each effect that was fitted.
    """

    names: tuple[str, ...]
    soil: tuple[tuple[str, str, Array], ...]
    sizes: tuple[tuple[str, str, Array], ...]
    nats: float
    left: tuple[Mapping[str, SlowResidual], ...]
    effects: Mapping[str, Array] = field(default_factory=dict)

    def mean(self, effect: str) -> tuple[Array, Array]:
        """Mean of an effect's coordinates over the recordings, shape (k,), and its covariance, shape (k, k).

        The recordings are taken as drawn from all that the rover may make. So few of them say little of how they
        scatter: the covariance is so much wider that 1.96 deviations are Student's 95 %.
        """
        each = self.effects[effect]
        n, wider = len(each), float(stats.t.ppf(0.975, len(each) - 1) / stats.norm.ppf(0.975))
        return each.mean(axis=0), wider**2 * np.atleast_2d(np.cov(each.T)) / n

    @property
    def unexplained_alone(self) -> tuple[str, ...]:
        """Recordings that leave more than noise even by themselves."""
        return tuple(name for name, left in zip(self.names, self.left, strict=True) if leaves_more_than_noise(left))

    @property
    def sufficient(self) -> bool:
        """Whether no recording by itself leaves more than noise."""
        return not self.unexplained_alone

    @property
    def words(self) -> str:
        """The soils, the parameter that differs most first; those that hardly differ left out."""
        ordered = sorted(self.soil, key=lambda one: -_spread(one[2]))
        stated = [one for one in ordered if _spread(one[2]) > _LEAST_SPREAD] or ordered[:1]
        return "; ".join(_listed(self.names, *one) for one in stated)

    @property
    def size_words(self) -> str:
        """The effects as each recording by itself has them; empty where none was fitted."""
        return "; ".join(
            f"{_listed(self.names, *one)} (mean {number(float(one[2].mean()), 3)}, spread "
            f"{number(float(one[2].std(ddof=1)), 2)})" for one in self.sizes
        )  # fmt: skip

    @property
    def unexplained(self) -> Unexplained:
        """Several soils as a cause on no list; its size is the largest difference of a parameter as a share."""
        size = max(_spread(values) for _, _, values in self.soil)
        return Unexplained(
            "contact forces",
            RECORDING,
            f"a soil of its own in each, {odds(self.nats / DECADE)} against one for all",
            float(f"{size:.3g}"),
            "–",
            self.words,
        )


def fitted_by_recording(problem: Problem, fit: Fit, rounds: Rounds | None = None) -> ByRecording:
    """Fit every recording by itself, from where the fit of all of them ended and under its loss.

    A compromise may be a bad place to begin. So where some leave no more than noise, the others are searched anew.
    """
    rounds = rounds or Rounds()
    names, recording = problem.recordings
    loss = replace(fit.loss, firm=True)

    def alone(which: int) -> tuple[Problem, Fit]:
        rows = np.flatnonzero(recording == which)
        part = problem.part(rows.tolist())
        begin = evaluate(part, loss, [fit.point.coordinates], fit.point.starts[rows])[0]
        return part, settled(part, begin, loss, rounds)

    def anew(part: Problem) -> Fit:
        found = search(part, Effort(), effects=fit.point.coordinates[len(part.parameters.parameters) :]).point
        return settled(part, evaluate(part, loss, [found.coordinates], found.starts)[0], loss, rounds)

    fits = side_by_side(alone, range(len(names)), problem.workers)
    poor = [k for k, (part, one) in enumerate(fits) if leaves_more_than_noise(remains(part, one.point))]
    if len(poor) < len(fits):
        for k in poor:
            fits[k] = fits[k][0], min(fits[k][1], anew(fits[k][0]), key=lambda one: one.point.cost)
    together = reassessed(problem, loss, fit.point).cost
    gained = 0.5 * (together - sum(one.point.cost for _, one in fits))
    occam = sum(_occam(part, one) for part, one in fits) - _occam(problem, fit)
    values = np.array([problem.parameters.values(one.point.coordinates) for _, one in fits])
    columns = zip(problem.parameters.parameters, values.T, strict=True)
    soil = tuple((parameter.name, parameter.unit, column) for parameter, column in columns)
    sizes, left = _sizes(problem, [one for _, one in fits]), tuple(remains(part, one.point) for part, one in fits)
    every = zip(problem.parameters.extensions, problem.parameters.places, strict=True)
    effects = {one.id: np.array([fit.point.coordinates[place] for _, fit in fits]) for one, place in every}
    return ByRecording(names, soil, sizes, gained + min(0.0, occam), left, effects)


def _sizes(problem: Problem, fits: Sequence[Fit]) -> tuple[tuple[str, str, Array], ...]:
    """Names, units and values of the effects' parameters that were fitted."""
    found = []
    for extension, part in zip(problem.parameters.extensions, problem.parameters.places, strict=True):
        values = [extension.values(fit.point.coordinates[part]) for fit in fits]
        for name in filter(None, (*extension.search.sizes, extension.search.direction)):
            quantity = extension.effect.parameters[name].quantity
            assert isinstance(quantity, Quantity)
            column = np.array([float(one[name]) for one in values])
            if name == extension.search.direction:  # without a jump by a turn between them
                column = column[0] + (column - column[0] + np.pi) % (2.0 * np.pi) - np.pi
            found.append((f"{effect_words(extension.id)}: {effect_words(name)}", quantity.unit, column))
    return tuple(found)


def _occam(problem: Problem, fit: Fit) -> float:
    """Logarithm of posterior over prior volume of what was fitted (Laplace); mu_s, which is scanned, has no say."""
    prior = problem.parameters.prior_information[np.ix_(fit.free, fit.free)]
    return 0.5 * float(np.linalg.slogdet(prior)[1] - np.linalg.slogdet(fit.reduced.matrix + prior)[1])


def _spread(values: Array) -> float:
    """Largest over least value, less 1."""
    return float(values.max() / values.min()) - 1.0


def _listed(names: Sequence[str], parameter: str, unit: str, values: Array) -> str:
    each = ", ".join(f"{number(float(value), 3)} in {name}" for name, value in zip(names, values, strict=True))
    return f"{parameter} ({spaced(unit)}) {each}" if unit not in ("", "-", "–", "1") else f"{parameter} {each}"
