"""Viscous articulation."""

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
    return fx.joint_damping.coefficient * rate


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(joint_damping=p.joint_damping + values["coefficient"])


EFFECT = Effect(
    id="joint_damping",
    acts="joint",
    doc="A viscous torque in the articulation's yaw.",
    parameters={"coefficient": number("N m s/rad", 0.0, math.inf, "torque per yaw rate")},
    adapt=_adapt,
    hooks={"joint": joint},
    search=Search({"coefficient": 30.0}, ((0.5,), (1.5,))),
)
