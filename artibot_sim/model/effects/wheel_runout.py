"""A wheel that is not round, or not centred on its axle."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, Search, choice, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import sincos

MOTORS = ("front_right", "front_left", "back_right", "back_left")


@inlined
def radius(fx, wheel, angle):
    """Factor of the radius of a wheel at its angle, rad."""
    runout = fx.wheel_runout
    if wheel != runout.wheel or runout.relative == 0.0:
        return 1.0
    sine, _ = sincos(angle + runout.phase)
    return 1.0 + runout.relative * sine


EFFECT = Effect(
    id="wheel_runout",
    acts="contact",
    doc="One wheel's radius is r_w (1 + relative sin(angle + phase)), angle being that of its rotation.",
    parameters={
        "relative": number("-", 0.0, 0.5, "largest departure from r_w, over r_w"),
        "phase": number("rad", -math.inf, math.inf, "of the departure at the angle zero"),
        "wheel": choice(tuple(f"{motor}_{end}" for motor in MOTORS for end in ("front", "back")), "which wheel"),
    },
    hooks={"radius": radius},
    search=Search({"relative": 0.03}, direction="phase"),
)
