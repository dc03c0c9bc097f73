"""Sloped ground, as eq. 12 does it: the gravity vector tilts, the ground stays the plane z = 0."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, EffectParameter
from artibot_sim.model.quantity import Quantity

STANDARD_GRAVITY = 9.81
"""|g| of eq. 12, m/s²."""

SLOPE = Effect(
    id="slope",
    acts="environment",
    doc="Each module is pulled by m g sin(grade) towards `heading` in `map`.",
    parameters={
        "grade": EffectParameter(Quantity("rad", -0.8, 0.8, "angle of the slope"), 0.0),
        "heading": EffectParameter(Quantity("rad", -math.inf, math.inf, "direction downhill in map"), 0.0),
    },
)


def gravity(grade: float, heading: float) -> tuple[float, float, float]:
    """Gravitational acceleration in `map` (m/s²): eq. 12's vector, tilted by `grade` towards `heading` (rad)."""
    if grade == 0.0:
        return 0.0, 0.0, -STANDARD_GRAVITY
    along = STANDARD_GRAVITY * math.sin(grade)
    return along * math.cos(heading), along * math.sin(heading), -STANDARD_GRAVITY * math.cos(grade)
