"""Velocity loops as drives have them, which know the speed's error and its integral but not the load."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number, with_every_motor
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params


@inlined
def loop(fx, error, behind):
    """Torque (N m) that a drive asks for at a speed `error` (rad/s) whose integral is `behind` (rad)."""
    own = fx.velocity_loop
    return own.gain * (error + own.integral * behind) if own.gain < math.inf else math.nan


@inlined
def wound(fx, behind):
    """What is left of the integral `behind` (rad): its torque stays within the windup limit."""
    own = fx.velocity_loop
    if own.gain == math.inf or own.integral <= 0.0:
        return 0.0
    most = own.windup / (own.gain * own.integral)
    return min(max(behind, -most), most)


def _adapt(p: Params, values: Values) -> Params:
    """How stiff the loop is, which limits a step."""

    def held(motor: MotorParams) -> MotorParams:
        return motor._replace(loop=values["gain"], winding=values["integral"])

    return with_every_motor(p, held)


EFFECT = Effect(
    id="velocity_loop",
    acts="drive",
    doc="The torque of motors that are driven is gain · (error of their speed + integral · ∫ error dt), the second "
    "part within ±windup; it does not know their load, as without this effect it does. Motors that are prescribed have "
    "no loop, so the front ones are driven instead where no mode is asked for.",
    parameters={
        "gain": number("N m s/rad", 0.0, math.inf, "torque per speed error", math.inf, low_open=True),
        "integral": number("1/s", 0.0, math.inf, "integral gain over `gain`: the inverse of the integral time"),
        "windup": number("N m", 0.0, math.inf, "largest torque of the integral part", math.inf),
    },
    adapt=_adapt,
    hooks={"loop": loop, "wound": wound},
    drives_front=True,
    search=Search({"gain": 0.2, "integral": 0.2}, logarithmic=True, views=("command",)),
)
