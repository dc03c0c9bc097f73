"""A prism or an antenna that is not where it is taken to be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import SensorErrors


def _sensor(errors: SensorErrors, values: Values) -> SensorErrors:
    return errors._replace(arm_x=errors.arm_x + values["x"], arm_y=errors.arm_y + values["y"])


EFFECT = Effect(
    id="pose_lever_arm",
    acts="sensor",
    doc="The point whose position is recorded sits at (x, y) in the front module, not in its origin.",
    claim="the tracked point is {x|ahead of|behind} the robot's middle and {y|to the left|to the right} of it",
    parameters={
        "x": number("m", -10.0, 10.0, "forward of the origin"),
        "y": number("m", -10.0, 10.0, "left of the origin"),
    },
    sizes=2,
    sensor=_sensor,
    search=Search({"x": 0.12, "y": 0.08}),
)
