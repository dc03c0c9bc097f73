"""Wind, or a tether."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import sincos


@inlined
def push(fx, module):
    """Force on a module's origin along x and y of `map`, N."""
    force = fx.external_force.force if module == 0 else 0.0
    if force == 0.0:
        return 0.0, 0.0
    sine, cosine = sincos(fx.external_force.heading)
    return force * cosine, force * sine


EFFECT = Effect(
    id="external_force",
    acts="environment",
    doc="A constant horizontal force at the front module's origin, fixed in `map`.",
    parameters={
        "force": number("N", -math.inf, math.inf, "horizontal force"),
        "heading": number("rad", -math.inf, math.inf, "its direction in map"),
    },
    hooks={"push": push},
    uniform=False,
    search=Search({"force": 35.0}, direction="heading"),
)
