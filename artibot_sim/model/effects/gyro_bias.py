"""A gyroscope that shows a turn where there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import SensorErrors


def _sensor(errors: SensorErrors, values: Values) -> SensorErrors:
    return errors._replace(gyro_bias=errors.gyro_bias + values["bias"])


EFFECT = Effect(
    id="gyro_bias",
    acts="sensor",
    doc="Recorded yaw rates are off by a constant.",
    claim="the gyroscope shows {bias|too much|too little} at rest",
    parameters={"bias": number("rad/s", -1.0, 1.0, "recorded less true yaw rate")},
    sensor=_sensor,
    search=Search({"bias": 0.01}, channels=("yaw_rate",)),
)
