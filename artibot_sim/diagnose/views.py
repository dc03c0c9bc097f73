"""What the view driven by commands says of effects, in the terms in which effects are named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from artibot_sim.diagnose.command_view.view import CommandView, ViewEvidence
from artibot_sim.diagnose.contest import Rival
from artibot_sim.diagnose.diagnosis import Found
from artibot_sim.diagnose.evidence import Evidence
from artibot_sim.diagnose.other import Other
from artibot_sim.identify.extension import SPREAD, Extension
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.quantity import Quantity

_NORMAL = 1.96
_SYSTEMATIC = 0.02
"""Standard deviation, as a share of a value's departure from neutral, of what no residual shows."""
_FACTOR = 0.002
"""The same of a factor, beside that: two sensors of the same thing agree no better."""


def others(view: CommandView, named: tuple[str, ...] = ()) -> dict[str, Other]:
    """Log Bayes factors of effects on top of those that are `named`; none where there are no commands.

    Occam's factor is Laplace's: posterior over prior width of each parameter.
    """
    seen = tuple(effect for effect in named if effect in view.evidence)
    evidence = view.given(*seen) if seen else view.evidence
    return {effect: _other(effect, one) for effect, one in evidence.items() if effect in EFFECTS}


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
    heard = view.given(*(name for name in others_ if name in view.evidence)).get(rival.id)
    if heard is not None and heard.values:
        best, width = float(extension.coordinates(heard.values)[0]), _widths(extension, heard)[0]
        its = 1.0 / max(width, 1e-9) ** 2
        tried += [best, (precision * place + its * best) / (precision + its)]
    return own.nats + max(gained(coordinate) for coordinate in tried)


def _other(effect: str, one: ViewEvidence) -> Other:
    if not one.values:
        return Other(0.0, {}, one.excluded_above, one.note, one.excluded_below)
    widths = np.minimum(_widths(Extension(effect), one), SPREAD) / SPREAD
    occam = float(np.log(np.maximum(widths, 1e-12)).sum())
    nats = one.nats + min(0.0, occam)
    return Other(nats, _found(effect, one), one.excluded_above, one.note, one.excluded_below)


def _widths(extension: Extension, one: ViewEvidence) -> list[float]:
    """Standard deviations of an effect's coordinates."""
    widths = []
    for name, size in extension.search.sizes.items():
        sd = one.sd.get(name, np.inf)
        if extension.search.logarithmic:
            sd = sd / abs(one.values[name]) if one.values[name] else np.inf
        widths.append(sd / size)
    return widths


def _found(effect: str, one: ViewEvidence) -> Mapping[str, Found]:
    found = {}
    for name, value in one.values.items():
        parameter = EFFECTS[effect].parameters[name]
        quantity, neutral = parameter.quantity, float(parameter.neutral)
        assert isinstance(quantity, Quantity)
        departure = value - neutral if np.isfinite(neutral) else value
        unseen = np.hypot(_SYSTEMATIC * departure, _FACTOR * value if neutral == 1.0 else 0.0)
        half = _NORMAL * float(np.hypot(one.sd.get(name, 0.0), unseen))
        ends = (float(max(value - half, quantity.low)), float(min(value + half, quantity.high)))
        found[name] = Found(float(value), quantity.unit, ends)
    return found
