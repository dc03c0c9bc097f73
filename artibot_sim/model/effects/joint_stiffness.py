"""An articulation that springs back, by its cables say."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params


@inlined
def joint(fx, angle, rate):
    """Torque against the articulation's yaw, N m."""
    return fx.joint_stiffness.stiffness * angle


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(joint_stiffness=p.joint_stiffness + values["stiffness"])


EFFECT = Effect(
    id="joint_stiffness",
    acts="joint",
    doc="A spring torque towards a straight articulation.",
    parameters={"stiffness": number("N m/rad", 0.0, math.inf, "torque per yaw")},
    adapt=_adapt,
    hooks={"joint": joint},
    search=Search({"stiffness": 25.0}, ((0.5,), (1.5,))),
)
