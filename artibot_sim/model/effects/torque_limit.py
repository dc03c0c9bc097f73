"""Front motors at the end of their strength."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params


def _adapt(p: Params, values: Values) -> Params:
    def limited(motor: MotorParams) -> MotorParams:
        return motor._replace(torque_max=min(motor.torque_max, values["front_max"]))

    return p._replace(right_front=limited(p.right_front), left_front=limited(p.left_front))


EFFECT = Effect(
    id="torque_limit",
    acts="drive",
    doc="The front motors' torque saturates at ±front_max, and their velocity loop catches up after; motors that are "
    "prescribed know no limit, so they are driven instead where no mode is asked for.",
    parameters={"front_max": number("N m", 0.0, math.inf, "largest torque", math.inf, low_open=True)},
    adapt=_adapt,
    drives_front=True,
    search=Search({"front_max": 0.2}, logarithmic=True, views=("command",)),
)
