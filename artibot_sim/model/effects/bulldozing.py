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
def lateral(fx, p_y):
    """Lateral force on top of eq. 16's, N."""
    return -fx.bulldozing.coefficient * abs(p_y) * p_y


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(lateral_damping=p.lateral_damping + 2.0 * values["coefficient"] * FASTEST)


EFFECT = Effect(
    id="bulldozing",
    acts="contact",
    doc="A lateral force −coefficient |p_y| p_y at each wheel, on top of the saturated one.",
    parameters={"coefficient": number("N s^2/m^2", 0.0, math.inf, "force per squared lateral speed")},
    adapt=_adapt,
    hooks={"lateral": lateral},
    search=Search({"coefficient": 900.0}, ((0.3,), (1.0,), (2.5,))),
)
