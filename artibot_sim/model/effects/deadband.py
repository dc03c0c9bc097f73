"""A drive that does not move for small commands."""

from __future__ import annotations

import math

import numpy as np

from artibot_sim.model.effects.base import Array, Effect, Search, Step, Values, number


def outside(speed: Array, threshold: float) -> Array:
    """Commands as far as they move anything, of any shape."""
    return np.where(np.abs(speed) < threshold, 0.0, speed)


def _step(values: Values, h: float, first: Array) -> Step:
    return lambda speed: outside(speed, values["threshold"])


EFFECT = Effect(
    id="deadband",
    acts="command",
    doc="Front velocity commands below the threshold give no motion.",
    parameters={"threshold": number("rad/s", 0.0, math.inf, "motor speed below which nothing moves")},
    command=_step,
    search=Search({"threshold": 45.0}, views=("command",)),
)
