"""Worn or cold gears."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number, with_every_motor

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params


def _adapt(p: Params, values: Values) -> Params:
    def worn(motor: MotorParams) -> MotorParams:
        return motor._replace(eta_d=min(values["scale"] * motor.eta_d, 1.0))

    return with_every_motor(p, worn)


EFFECT = Effect(
    id="gear_efficiency",
    acts="drive",
    doc="The direct efficiency of all transmissions is `scale` times the configured one (and at most 1).",
    parameters={"scale": number("-", 0.0, 10.0, "of eta_d", 1.0, low_open=True)},
    adapt=_adapt,
    search=Search(
        {"scale": 0.26},
        ((-1.0,), (-0.4,), (0.6,)),
        logarithmic=True,
        ridge={f"contact.{name}": 1.0 for name in ("k_l", "k_t", "mu_s", "mu_d", "u_w")},
        channels=("torque_front", "torque_back"),
    ),
)
