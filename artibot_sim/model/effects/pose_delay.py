"""Positions that are stamped when they arrive, not when they were measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import SensorErrors


def _sensor(errors: SensorErrors, values: Values) -> SensorErrors:
    return errors._replace(delay=errors.delay + values["delay"])


EFFECT = Effect(
    id="pose_delay",
    acts="sensor",
    doc="Positions, and headings that come with them, are stamped this much late.",
    claim="positions are stamped {delay} late",
    parameters={"delay": number("s", 0.0, 10.0, "stamp less time of measurement")},
    sensor=_sensor,
    search=Search({"delay": 0.12}, ((0.5,), (1.0,))),
)
