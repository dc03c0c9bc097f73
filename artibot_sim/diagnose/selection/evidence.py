"""How much the data speak for an effect: log-likelihood gained, less what its freedom would gain by chance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.candidates.hypotheses import Hypothesis
from artibot_sim.diagnose.commands.fit import ViewEvidence
from artibot_sim.diagnose.commands.view import CommandView
from artibot_sim.diagnose.records import EffectEstimate
from artibot_sim.diagnose.selection.joint_fits import Rival
from artibot_sim.estimation.parameters import SPREAD, Extension
from artibot_sim.estimation.search import Fit, free_parameters
from artibot_sim.estimation.solver import reduce
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.robot.quantity import Quantity

# ----------------------------------------------------------------------
# Evidence from outside the fit.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class CommandEvidence:
    """What the view driven by commands says of one effect.

    Attributes
    ----------
    nats : float
        Log Bayes factor.
    found : mapping of str to EffectEstimate
        Its parameters there.
    excluded_above : mapping of str to float
        Departures from neutral that it excludes, by parameter.
    note : str
        Why it says nothing, where it cannot.
    excluded_below : mapping of str to float
        Values below which it excludes limits, by parameter.
    """

    nats: float
    found: Mapping[str, EffectEstimate]
    excluded_above: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    excluded_below: Mapping[str, float] = field(default_factory=dict)


# ----------------------------------------------------------------------
# How much the data speak for an effect: log-likelihood gained, less what its freedom would gain by chance.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """What one view says about an effect that was fitted.

    Attributes
    ----------
    gained : float
        Nats of log-likelihood over the baseline, noise of the rotations taken off (`unbent`).
    occam : float
        Nats that its freedom costs (Laplace's approximation): negative.
    own : array, shape (k,)
        The effect's coordinates, as they would be without that noise.
    covariance : array, shape (k, k)
    by_window : array, shape (windows,)
        What each window gains, nats, parameters' priors left out; empty where it is not known.
    """

    gained: float
    occam: float
    own: Array
    covariance: Array
    by_window: Array = field(default_factory=lambda: np.empty(0))

    @property
    def nats(self) -> float:
        """Logarithm of the Bayes factor."""
        return self.gained + self.occam

    @property
    def sampling_sd(self) -> float:
        """Nats, standard deviation of `gained` by which windows were recorded."""
        return scatter(self.by_window)

    def sampling_sd_beside(self, other: Evidence) -> float:
        """Nats, standard deviation of what is gained more than by another effect; 0 where that is of other windows."""
        same = self.by_window.shape == other.by_window.shape
        return scatter(self.by_window - other.by_window) if same else 0.0

    @property
    def deviations(self) -> float:
        """How many standard deviations the effect is from neutral."""
        squared = float(self.own @ np.linalg.solve(self.covariance, self.own))
        return max(0.0, squared) ** 0.5


def evidence(rival: Rival, best: Fit, excess: float = 0.0) -> Evidence:
    """The evidence of the view that is driven by rotations, over the `best` baseline fitted under the same loss.

    Parameters
    ----------
    rival : Rival
    best : Fit
    excess : float
        Cost of the baseline that is noise of the rotations, and not of the rival (`excess_of`).
    """
    problem, point, loss = rival.problem, rival.fit.point, rival.fit.loss
    free = free_parameters(problem)
    residuals, sensitivity = problem.linearised(point.coordinates, point.starts, free)
    reduced = reduce(problem, loss, residuals, sensitivity, point.starts)
    prior = problem.parameters.prior_information
    covariance = np.asarray(np.linalg.inv(reduced.matrix + prior[np.ix_(list(free), list(free))]), float)
    size = len(rival.effect_coordinates)
    mine = covariance[-size:, -size:]
    gained = 0.5 * (best.point.cost - point.cost)
    by_window = 0.5 * (best.point.losses - point.losses)
    share = unbent(gained, 0.5 * excess)
    own = share * rival.effect_coordinates
    return Evidence(share**2 * gained, occam(rival.trial.hypothesis, mine), own, mine, by_window)


def unbent(gained: float, excess: float) -> float:
    """The share of an effect's size that is left without what noise of the rotations makes of it.

    At the share x of the size that was fitted an effect gains G (1 - (1 - x)²), E x of which the noise alone gives:
    forces that answer the rotations less make less noise of it. What is left is most at x = 1 - E / 2 G, and there
    G x².

    Parameters
    ----------
    gained, excess : float
        G and E, nats.
    """
    return max(0.0, 1.0 - 0.5 * excess / gained) if gained > 0.0 else 1.0


def scatter(gained: Array) -> float:
    """Standard deviation of a sum by chance, of which its negative parts tell.

    Where the model lacks something, a window may be explained better or worse by any effect, mostly because a wheel
    slides there in one model and holds in the other. Chance favours either sign alike, so what windows lose says how
    much others gain by chance. What is there makes few windows worse, though it may act in few.

    Parameters
    ----------
    gained : array, shape (windows,)
        Nats of each.
    """
    return float(np.sqrt(2.0 * (np.minimum(gained, 0.0) ** 2).sum()))


def occam(hypothesis: Hypothesis, covariance: Array) -> float:
    """Logarithm of posterior over prior volume of an effect's coordinates, and of the choices made for it."""
    sd = np.minimum(np.sqrt(np.diag(covariance)), SPREAD)
    correlation = covariance / np.outer(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(covariance)))
    volume = float(np.log(sd / SPREAD).sum()) + 0.5 * float(np.linalg.slogdet(correlation)[1])
    sides = np.log(2.0) * len(covariance) if hypothesis.extension.one_sided else 0.0
    return min(0.0, volume + sides - float(np.log(hypothesis.alternatives)))


# ----------------------------------------------------------------------
# What the view driven by commands says of effects, in the terms in which effects are named.
# ----------------------------------------------------------------------


_NORMAL = 1.96
_SYSTEMATIC = 0.02
"""Standard deviation, as a share of a value's departure from neutral, of what no residual shows."""
_FACTOR = 0.002
"""Standard deviation of a factor, beside that: two sensors of the same quantity agree no better."""


def others(view: CommandView, named: tuple[str, ...] = ()) -> dict[str, CommandEvidence]:
    """Log Bayes factors of effects on top of those that are `named`; none where there are no commands.

    Occam's factor is Laplace's: posterior over prior width of each parameter.
    """
    seen = tuple(effect for effect in named if effect in view.evidence)
    evidence = view.given(*seen) if seen else view.evidence
    return {effect: _command_evidence(effect, one) for effect, one in evidence.items() if effect in EFFECTS}


def together(view: CommandView, rival: Rival, own: Evidence, beside: Mapping[str, Mapping[str, float]]) -> float:
    """Log Bayes factor of a fitted effect from both views, at the value that is best for both.

    The view driven by commands can speak against what rotations ask for. Each view at its own best would count the
    data of both for an effect of which each says something else.

    Parameters
    ----------
    own : Evidence
        Of the view driven by rotations.
    beside : mapping of str to mapping of str to float
        Effects that only the view driven by commands knows.
    """
    extension, place = rival.trial.hypothesis.extension, float(own.own[0])
    if "command" not in extension.search.views:
        return own.nats
    robot = rival.problem.parameters.robot_at(rival.fit.point.coordinates)
    others_ = {name: values for name, values in {**robot.effects, **beside}.items() if name != rival.id}
    before, precision = view.nats(replace(robot, effects=others_)), 1.0 / float(own.covariance[0, 0])

    def gained(coordinate: float) -> float:
        values = extension.values(extension.nearest(np.array([coordinate])))
        seen = view.nats(replace(robot, effects={**others_, rival.id: values}))
        return seen - before - 0.5 * precision * (coordinate - place) ** 2

    tried = [place]
    from_commands = view.given(*(name for name in others_ if name in view.evidence)).get(rival.id)
    if from_commands is not None and from_commands.values:
        best, width = float(extension.coordinates(from_commands.values)[0]), _widths(extension, from_commands)[0]
        its = 1.0 / max(width, 1e-9) ** 2
        tried += [best, (precision * place + its * best) / (precision + its)]
    return own.nats + max(gained(coordinate) for coordinate in tried)


def _command_evidence(effect: str, one: ViewEvidence) -> CommandEvidence:
    if not one.values:
        return CommandEvidence(0.0, {}, one.excluded_above, one.note, one.excluded_below)
    widths = np.minimum(_widths(Extension(effect), one), SPREAD) / SPREAD
    occam = float(np.log(np.maximum(widths, 1e-12)).sum())
    nats = one.nats + min(0.0, occam)
    return CommandEvidence(nats, _found(effect, one), one.excluded_above, one.note, one.excluded_below)


def _widths(extension: Extension, one: ViewEvidence) -> list[float]:
    """Standard deviations of an effect's coordinates."""
    widths = []
    for name, size in extension.search.sizes.items():
        sd = one.sd.get(name, np.inf)
        if extension.search.logarithmic:
            sd = sd / abs(one.values[name]) if one.values[name] else np.inf
        widths.append(sd / size)
    return widths


def _found(effect: str, one: ViewEvidence) -> Mapping[str, EffectEstimate]:
    found = {}
    for name, value in one.values.items():
        parameter = EFFECTS[effect].parameters[name]
        quantity, neutral = parameter.quantity, float(parameter.neutral)
        assert isinstance(quantity, Quantity)
        departure = value - neutral if np.isfinite(neutral) else value
        unseen = np.hypot(_SYSTEMATIC * departure, _FACTOR * value if neutral == 1.0 else 0.0)
        half = _NORMAL * float(np.hypot(one.sd.get(name, 0.0), unseen))
        ends = (float(max(value - half, quantity.low)), float(min(value + half, quantity.high)))
        found[name] = EffectEstimate(float(value), quantity.unit, ends)
    return found
