"""Encoders whose counts a turn are not what they are taken for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import SensorErrors


def _sensor(errors: SensorErrors, values: Values) -> SensorErrors:
    return errors._replace(encoder_scale=errors.encoder_scale * values["scale"])


EFFECT = Effect(
    id="encoder_scale",
    acts="sensor",
    doc="Recorded motor positions and velocities are `scale` times the true ones.",
    claim="rotations are recorded {scale-1|too large|too small}",
    parameters={"scale": number("-", 0.0, 10.0, "recorded over true rotation", 1.0, low_open=True)},
    sensor=_sensor,
    search=Search({"scale": 0.02}, ((-1.0,), (1.0,)), logarithmic=True, views=("rotation", "command")),
)
