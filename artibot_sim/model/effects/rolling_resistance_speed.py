"""Rolling resistance that grows with speed."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined


@inlined
def lead(fx, p_x, p_y):
    """Factor of u_w for a wheel whose centre moves at p_x along it and p_y across (m/s)."""
    coefficient = fx.rolling_resistance_speed.coefficient
    return 1.0 + coefficient * math.sqrt(p_x * p_x + p_y * p_y) if coefficient > 0.0 else 1.0


EFFECT = Effect(
    id="rolling_resistance_speed",
    acts="contact",
    doc="u_w becomes u_w (1 + coefficient |v|), v being the velocity of the wheel's centre.",
    parameters={"coefficient": number("s/m", 0.0, math.inf, "growth of u_w with speed")},
    hooks={"lead": lead},
    search=Search({"coefficient": 1.5}, ((0.5,), (1.5,))),
)
