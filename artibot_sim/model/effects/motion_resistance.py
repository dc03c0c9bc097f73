"""Ground that a module ploughs through: a force on the body, where rolling resistance is a torque on its wheels."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import tanh

WIDTH = 0.05
"""Forward speed over which the force changes its sign, m/s."""


@inlined
def resist(fx, module, forward):
    """Force against a module's forward motion at its forward speed (m/s), N."""
    force = fx.motion_resistance.force
    return force * tanh(forward * (1.0 / WIDTH)) if force > 0.0 else 0.0


EFFECT = Effect(
    id="motion_resistance",
    acts="environment",
    doc="A force of constant size against each module's forward motion: loose ground in front of the wheels, a crust, "
    "high grass. Wheels that hold make up for it with little slip, wheels that slide in a turn with much.",
    parameters={"force": number("N", 0.0, math.inf, "against the forward motion of each module's origin")},
    hooks={"resist": resist},
)
