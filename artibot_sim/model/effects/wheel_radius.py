"""Wheels that are all larger or smaller than the robot's file says: worn, loaded, or soft tyres."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number, with_every_motor

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params


def _adapt(p: Params, values: Values) -> Params:
    """Only what rolls differs; the unloaded radii of eq. 15's springs stay, so that the rover's height does, too."""

    def worn(motor: MotorParams) -> MotorParams:
        return motor._replace(r_w=motor.r_w * values["scale"])

    return with_every_motor(p, worn)


EFFECT = Effect(
    id="wheel_radius",
    acts="contact",
    doc="All wheels have `scale` times the radius r_w of the robot's file.",
    claim="the loaded wheels' radius is {scale-1|larger|smaller} than the robot file's",
    parameters={"scale": number("-", 0.0, 10.0, "true radius over r_w", 1.0, low_open=True)},
    adapt=_adapt,
    search=Search({"scale": 0.02}, ((-1.0,), (1.0,)), logarithmic=True),
)
