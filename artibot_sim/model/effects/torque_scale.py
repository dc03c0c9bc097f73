"""Torques that are reckoned from currents with a wrong constant."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import SensorErrors


def _sensor(errors: SensorErrors, values: Values) -> SensorErrors:
    return errors._replace(torque_scale=errors.torque_scale * values["scale"])


EFFECT = Effect(
    id="torque_scale",
    acts="sensor",
    doc="Recorded motor torques are `scale` times the true ones.",
    claim="torques are recorded {scale-1|too large|too small}",
    parameters={"scale": number("-", 0.0, 10.0, "recorded over true torque", 1.0, low_open=True)},
    sensor=_sensor,
    search=Search(
        {"scale": 0.15},
        ((-1.0,), (1.0,)),
        logarithmic=True,
        ridge={f"contact.{name}": -1.0 for name in ("k_l", "k_t", "mu_s", "mu_d", "u_w")},
        channels=("torque_front", "torque_back"),
        views=("rotation", "command"),
    ),
)
