"""Front motors at the end of their voltage: the faster they turn the less torque is left."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params


@inlined
def limits(fx, theta_dot, low, high):
    """What is left of the torques `low` to `high` (N m) at a speed (rad/s), between two lines that fall with it.

    One is that of the full voltage forward, one of that backward. Motors without a limit, as prescribed ones, stay so.
    """
    sag = fx.battery_sag
    if sag.stall == math.inf or high == math.inf:
        return low, high
    rest, lost = sag.supply * sag.stall, sag.stall / sag.no_load_speed * theta_dot
    return min(max(low, -rest - lost), high), max(min(high, rest - lost), low)


def _adapt(p: Params, values: Values) -> Params:
    """Electronics hold the current to that of a motor that stands; this limit stands for the robot's own.

    The back motors' share of a limited torque needs none, as with `torque_limit`.
    """
    slope = values["stall"] / values["no_load_speed"]

    def limited(motor: MotorParams) -> MotorParams:
        return motor._replace(torque_max=values["supply"] * values["stall"], line=slope)

    return p._replace(
        right_front=limited(p.right_front), left_front=limited(p.left_front),
        right_back=p.right_back._replace(torque_max=math.inf), left_back=p.left_back._replace(torque_max=math.inf),
    )  # fmt: skip


EFFECT = Effect(
    id="battery_sag",
    acts="drive",
    doc="The front motors' torque lies between two parallel lines, stall (± supply − theta_dot/no_load_speed), and "
    "within ± supply · stall: a motor that turns as fast as its voltage lets it has none left. Motors that are "
    "prescribed know no limit, so they are driven instead where no mode is asked for; it stands for the robot's own.",
    parameters={
        "stall": number("N m", 0.0, math.inf, "torque at rest at full supply", math.inf, low_open=True),
        "no_load_speed": number("rad/s", 0.0, math.inf, "motor speed without a load", math.inf, low_open=True),
        "supply": number("-", 0.0, 2.0, "voltage over that of a full supply", 1.0, low_open=True),
    },
    sizes=1,
    adapt=_adapt,
    hooks={"limits": limits},
    drives_front=True,
    search=Search({"stall": 0.2, "no_load_speed": 0.2}, logarithmic=True, views=("command",)),
)
