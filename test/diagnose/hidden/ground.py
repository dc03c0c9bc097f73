"""Recordings that were not made on one soil: no effect, and no force, but a mistake in what belongs together."""

from __future__ import annotations

import numpy as np
from diagnose.hidden.effects import LEAST, Recipe, Rng, Values
from diagnose.hidden.machine import Machine

OTHER_GROUND = "other_ground"
RECORDING = 1
"""Number of the one that is on another soil: the second."""


def _draw(rng: Rng, s: float, track: np.ndarray) -> Values:
    """Softer and slipperier by a fifth, or by as much the other way."""
    factor = max(1.0 - 0.2 * s, LEAST)
    return {"factor": factor if rng.random() < 0.5 else 1.0 / factor}


def _apply(machine: Machine, values: Values) -> Machine:
    soil = machine.rover.soil
    changed = {name: values["factor"] * getattr(soil, name) for name in ("k_l", "k_t", "mu_s", "mu_d")}
    return machine.with_rover(soil=soil._replace(**changed))


RECIPE = Recipe(_draw, _apply)
