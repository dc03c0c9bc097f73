"""Dry friction in the articulation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import tanh

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

WIDTH = 0.01
"""Yaw rate of the articulation over which friction changes its sign (tanh), rad/s."""


@inlined
def joint(fx, angle, rate):
    """Torque against the articulation's yaw, N m."""
    torque = fx.joint_friction.torque
    return torque * tanh(rate / WIDTH) if torque > 0.0 else 0.0


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(joint_damping=p.joint_damping + values["torque"] / WIDTH)


EFFECT = Effect(
    id="joint_friction",
    acts="joint",
    doc="Coulomb torque that opposes the articulation's yaw rate.",
    parameters={"torque": number("N m", 0.0, math.inf, "Coulomb torque")},
    adapt=_adapt,
    hooks={"joint": joint},
    search=Search({"torque": 10.0}, ((0.5,), (1.5,))),
)
