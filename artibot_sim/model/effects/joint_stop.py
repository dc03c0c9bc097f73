"""End stops of the articulation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

STIFFNESS, DAMPING = 4000.0, 40.0
"""Of the stop, N m/rad and N m s/rad."""


@inlined
def joint(fx, angle, rate):
    """Torque against the articulation's yaw, N m; the stop pushes only."""
    stop = fx.joint_stop.angle
    if angle > stop:
        return max(STIFFNESS * (angle - stop) + DAMPING * rate, 0.0)
    if angle < -stop:
        return min(STIFFNESS * (angle + stop) + DAMPING * rate, 0.0)
    return 0.0


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(joint_damping=p.joint_damping + DAMPING, joint_stiffness=p.joint_stiffness + STIFFNESS)


EFFECT = Effect(
    id="joint_stop",
    acts="joint",
    doc="A stiff stop at ±angle of the articulation's yaw.",
    parameters={"angle": number("rad", 0.0, math.inf, "where the stops are", math.inf, low_open=True)},
    adapt=_adapt,
    hooks={"joint": joint},
    search=Search({"angle": 0.1}, ((0.0,), (-0.15,), (-0.5,)), logarithmic=True, reference="articulation"),
)
