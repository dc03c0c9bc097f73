"""Ground that a module ploughs through: a force on the body, where rolling resistance is a torque on its wheels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import tanh

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

WIDTH = 0.05
"""Forward speed over which the force changes its sign, m/s."""


@inlined
def resist(fx, module, forward):
    """Force against a module's forward motion at its forward speed (m/s), N."""
    force = fx.motion_resistance.force
    return force * tanh(forward * (1.0 / WIDTH)) if force > 0.0 else 0.0


def _adapt(p: Params, values: Values) -> Params:
    """What it adds at most to the damping of a module's forward motion, shared by its wheels."""
    return p._replace(forward_damping=p.forward_damping + values["force"] / (4.0 * WIDTH))


EFFECT = Effect(
    id="motion_resistance",
    acts="environment",
    doc="A force of constant size against each module's forward motion: loose ground in front of the wheels, a crust, "
    "high grass. Wheels that hold make up for it with little slip, wheels that slide in a turn with much.",
    claim="the ground holds each module back with {force}",
    parameters={"force": number("N", 0.0, math.inf, "against the forward motion of each module's origin")},
    adapt=_adapt,
    hooks={"resist": resist},
    search=Search({"force": 30.0}, ((0.3,), (1.0,), (2.5,))),
)
