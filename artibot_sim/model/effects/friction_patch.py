"""A puddle, ice, loose gravel: a disc of ground with another friction."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined


@inlined
def grip(fx, x, y):
    """Factor of mu_s and mu_d for a wheel at (x, y) in `map`."""
    patch = fx.friction_patch
    away_x, away_y = x - patch.x, y - patch.y
    return patch.scale if away_x * away_x + away_y * away_y < patch.radius * patch.radius else 1.0


EFFECT = Effect(
    id="friction_patch",
    acts="contact",
    doc="mu_s and mu_d are scaled for wheels whose centres are inside a disc of `map`.",
    parameters={
        "scale": number("-", 0.0, 100.0, "of mu_s and mu_d inside", 1.0, low_open=True),
        "x": number("m", -math.inf, math.inf, "centre of the disc"),
        "y": number("m", -math.inf, math.inf, "centre of the disc"),
        "radius": number("m", 0.0, math.inf, "of the disc"),
    },
    hooks={"grip": grip},
    uniform=False,
    search=Search({"scale": 0.6}, ((-1.0,), (0.7,)), logarithmic=True, disc=("x", "y", "radius")),
)
