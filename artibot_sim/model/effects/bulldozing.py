"""Soil that a wheel pushes aside."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params


FASTEST = 0.5
"""Lateral speed of a wheel up to which a step that is accepted is stable, m/s."""


@inlined
def lateral(fx, p_y, F_n):
    """Lateral force on top of eq. 16's of a wheel that carries F_n, N."""
    return -(fx.bulldozing.coefficient + fx.bulldozing.load * F_n) * abs(p_y) * p_y


def _adapt(p: Params, values: Values) -> Params:
    """How steep the force is at the wheels of the module that carries most."""
    modules = (p.front, p.back)[: 2 if p.two else 1]
    most = p.load * max(body.m for body in modules) * len(modules) / sum(body.m for body in modules)
    steepest = 2.0 * (values["coefficient"] + values["load"] * most) * FASTEST
    return p._replace(lateral_damping=p.lateral_damping + steepest)


EFFECT = Effect(
    id="bulldozing",
    acts="contact",
    doc="A lateral force −(coefficient + load F_n) |p_y| p_y at each wheel, on top of the saturated one: a wheel that "
    "carries more sinks deeper and pushes more soil.",
    parameters={
        "coefficient": number("N s^2/m^2", 0.0, math.inf, "force per squared lateral speed, whatever a wheel carries"),
        "load": number("s^2/m^2", 0.0, math.inf, "the same in proportion to what it carries"),
    },
    sizes=2,
    adapt=_adapt,
    hooks={"lateral": lateral},
    search=Search({"coefficient": 900.0}, ((0.3,), (1.0,), (2.5,))),
)
