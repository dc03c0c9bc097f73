"""What the view driven by commands says of effects, in the terms in which effects are named."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from artibot_sim.diagnose.command_view import CommandView, ViewEvidence
from artibot_sim.diagnose.diagnosis import Found
from artibot_sim.diagnose.other import Other
from artibot_sim.identify.extension import SPREAD, Extension
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.quantity import Quantity

_NORMAL = 1.96
_SYSTEMATIC = 0.02
"""Standard deviation, as a share of a value, of what no residual shows."""


def others(view: CommandView, named: tuple[str, ...] = ()) -> dict[str, Other]:
    """Log Bayes factors of effects on top of those that are `named`; none where there are no commands.

    Occam's factor is Laplace's: posterior over prior width of each parameter.
    """
    seen = tuple(effect for effect in named if effect in view.evidence)
    evidence = view.given(*seen) if seen else view.evidence
    return {effect: _other(effect, one) for effect, one in evidence.items() if effect in EFFECTS}


def _other(effect: str, one: ViewEvidence) -> Other:
    if not one.values:
        return Other(0.0, {}, one.excluded_above, one.note)
    extension, widths = Extension(effect), []
    for name, size in extension.search.sizes.items():
        sd = one.sd.get(name, np.inf)
        if extension.search.logarithmic:
            sd = sd / abs(one.values[name]) if one.values[name] else np.inf
        widths.append(min(sd / size, SPREAD) / SPREAD)
    occam = float(np.log(np.maximum(widths, 1e-12)).sum())
    return Other(one.nats + min(0.0, occam), _found(effect, one), one.excluded_above, one.note)


def _found(effect: str, one: ViewEvidence) -> Mapping[str, Found]:
    found = {}
    for name, value in one.values.items():
        quantity = EFFECTS[effect].parameters[name].quantity
        assert isinstance(quantity, Quantity)
        half = _NORMAL * float(np.hypot(one.sd.get(name, 0.0), _SYSTEMATIC * value))
        ends = (float(max(value - half, quantity.low)), float(min(value + half, quantity.high)))
        found[name] = Found(float(value), quantity.unit, ends)
    return found
