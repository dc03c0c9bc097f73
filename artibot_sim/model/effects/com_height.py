"""A centre of mass above the ground: loads move between wheels as a rover turns, gains speed or stands on a slope."""

from __future__ import annotations

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined


@inlined
def above_ground(fx):
    """Of every module's centre of mass over the ground, m."""
    return fx.com_height.height


EFFECT = Effect(
    id="com_height",
    acts="body",
    doc="The ground's forces on a module act `height` below its centre of mass, and the loads of its wheels move until "
    "they balance the moment: between left and right, and with a rigid suspension between front and back. The joint's "
    "force, a push on a module and what laws add are taken to act at the centre's height.",
    parameters={"height": number("m", 0.0, 5.0, "over the ground; 0: every wheel keeps its static load")},
    hooks={"height": above_ground},
    search=Search({"height": 0.3}, ((0.5,), (1.5,))),
)
