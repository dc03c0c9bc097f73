"""Front motors at the end of their strength."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params


def _adapt(p: Params, values: Values) -> Params:
    """The limit stands for the robot's own, and the back motors' share of a limited torque needs none.

    So the model goes over to the paper's, whose prescribed motors know no limit, as this one grows.
    """

    def limited(motor: MotorParams, torque: float) -> MotorParams:
        return motor._replace(torque_max=torque)

    most = values["front_max"]
    return p._replace(
        right_front=limited(p.right_front, most), left_front=limited(p.left_front, most),
        right_back=limited(p.right_back, math.inf), left_back=limited(p.left_back, math.inf),
    )  # fmt: skip


EFFECT = Effect(
    id="torque_limit",
    acts="drive",
    doc="The front motors' torque saturates at ±front_max, and their velocity loop catches up after; motors that are "
    "prescribed know no limit, so they are driven instead where no mode is asked for; it stands for the robot's own.",
    parameters={"front_max": number("N m", 0.0, math.inf, "largest torque", math.inf, low_open=True)},
    adapt=_adapt,
    drives_front=True,
    search=Search({"front_max": 0.2}, logarithmic=True, views=("command",)),
)
