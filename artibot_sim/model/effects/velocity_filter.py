"""Motor velocities that drives smooth before they send them.

Where motors' angles are recorded, these turn a simulation; where only speeds are, the low-pass is taken off them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import SensorErrors


def _sensor(errors: SensorErrors, values: Values) -> SensorErrors:
    return errors._replace(velocity_filter=values["time_constant"])


EFFECT = Effect(
    id="velocity_filter",
    acts="sensor",
    doc="Recorded motor velocities have been through a first-order low-pass; recorded positions, and the velocity loop "
    "inside a drive, know nothing of it.",
    parameters={"time_constant": number("s", 0.0, 10.0, "of the low-pass")},
    sensor=_sensor,
    search=Search({"time_constant": 0.1}, views=("encoder",)),
)
