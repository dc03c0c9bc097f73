"""A brake that drags, a stone in a gear."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, choice, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import tanh

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

WIDTH = 0.5
"""Motor speed over which the drag changes its sign (tanh), rad/s."""


@inlined
def drag(fx, motor, theta_dot):
    """Torque against the rotation of a motor, motor-side, N m."""
    torque = fx.motor_drag.torque if motor == fx.motor_drag.motor else 0.0  # no branch: many lanes at once
    return torque * tanh(theta_dot / WIDTH) if torque > 0.0 else 0.0


def _adapt(p: Params, values: Values) -> Params:
    """How steep the drag is at rest, which limits an explicit step."""
    end, side = str(values["motor"]).split("_")
    name = f"{side}_{end}"
    motor = getattr(p, name)
    return p._replace(**{name: motor._replace(damping=motor.damping + values["torque"] / WIDTH)})


EFFECT = Effect(
    id="motor_drag",
    acts="drive",
    doc="One motor carries a constant extra torque against its rotation.",
    parameters={
        "torque": number("N m", 0.0, math.inf, "motor-side drag"),
        "motor": choice(("front_right", "front_left", "back_right", "back_left"), "which motor"),
    },
    adapt=_adapt,
    hooks={"drag": drag},
    search=Search({"torque": 0.25}, ((0.5,), (1.5,)), channels=("torque_front", "torque_back")),
)
