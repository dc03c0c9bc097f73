"""A front module whose centre of mass is off its origin."""

from __future__ import annotations

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined


@inlined
def centre(fx, module):
    """Centre of mass of a module in its own frame, x and y, m."""
    if module == 0:
        return fx.com_offset.x, fx.com_offset.y
    return 0.0, 0.0


EFFECT = Effect(
    id="com_offset",
    acts="body",
    doc="The front module's centre of mass is off its origin: its wheels carry m g/4 (1 ± 2x/i_x)(1 ± 2y/i_y), its "
    "inertia couples, and J_z is about the centre of mass.",
    claim="the front module's centre of mass is {x|ahead of|behind} its middle and {y|to the left|to the right} of it",
    parameters={
        "x": number("m", -1.0, 1.0, "forward of the origin"),
        "y": number("m", -1.0, 1.0, "left of the origin"),
    },
    sizes=2,
    hooks={"centre": centre},
    search=Search({"x": 0.06, "y": 0.04}, ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))),
)
