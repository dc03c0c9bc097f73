"""A tracked body, a lidar or a marker that is mounted at an angle to the rover."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import SensorErrors


def _sensor(errors: SensorErrors, values: Values) -> SensorErrors:
    return errors._replace(heading=errors.heading + values["angle"])


EFFECT = Effect(
    id="pose_heading_offset",
    acts="sensor",
    doc="Headings that come with positions are off by a constant; going straight looks like going aside.",
    claim="the tracked body is mounted {angle|to the left|to the right}",
    parameters={"angle": number("rad", -1.0, 1.0, "recorded less true heading")},
    sensor=_sensor,
    search=Search({"angle": 0.03}, channels=("pose",)),
)
