"""Wheels of unequal radius right and left: a rover that does not go straight."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params


def _adapt(p: Params, values: Values) -> Params:
    """Only what rolls differs; the unloaded radii of eq. 15's springs stay, so that the rover stands level."""
    half = 0.5 * values["relative"]

    def on(motor: MotorParams, factor: float) -> MotorParams:
        return motor._replace(r_w=motor.r_w * factor)

    return p._replace(
        right_front=on(p.right_front, 1 + half),
        left_front=on(p.left_front, 1 - half),
        right_back=on(p.right_back, 1 + half),
        left_back=on(p.left_back, 1 - half),
    )


EFFECT = Effect(
    id="wheel_radius_mismatch",
    acts="contact",
    doc="Right wheels have radius r_w (1 + relative/2), left ones r_w (1 − relative/2).",
    claim="right wheels are {relative|larger|smaller} than left ones, by tape or by tyre pressure",
    parameters={"relative": number("-", -0.5, 0.5, "right radius less left one, over their mean")},
    adapt=_adapt,
    search=Search({"relative": 0.02}, ((-1.0,), (1.0,))),
)
