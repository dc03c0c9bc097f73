"""Gears that take torque before they carry any: seals, grease, preloaded teeth."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number, with_every_motor
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import tanh

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params

WIDTH = 4.0
"""Motor speed over which the torque changes its sign (tanh), rad/s."""


@inlined
def gear(fx, theta_dot):
    """Torque that a gear takes of its motor without a load, motor-side, N m."""
    torque = fx.gear_no_load.torque
    return torque * tanh(theta_dot / WIDTH) if torque > 0.0 else 0.0


def _adapt(p: Params, values: Values) -> Params:
    """How steep the torque is at rest, which limits an explicit step."""

    def held(motor: MotorParams) -> MotorParams:
        return motor._replace(damping=motor.damping + motor.geared * values["torque"] / WIDTH)

    return with_every_motor(p, held)


EFFECT = Effect(
    id="gear_no_load",
    acts="drive",
    doc="Every gear takes a constant torque of its motor whatever it carries, beside the losses that eta_d and eta_r "
    "take in proportion to the load.",
    parameters={"torque": number("N m", 0.0, math.inf, "no-load torque of each gear, motor-side")},
    adapt=_adapt,
    hooks={"gear": gear},
    search=Search({"torque": 0.1}, ((0.5,), (1.5,)), channels=("torque_front", "torque_back")),
)
