"""Tyres that need some way to build up their lateral force."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

SLOWEST = 0.05
"""Least speed at which the force follows, m/s: at standstill it would not."""


@inlined
def follow_rate(fx, p_x):
    """Rate at which a wheel's lateral force follows eq. 15's, 1/s; zero where it is that of the instant."""
    length = fx.tyre_relaxation.length
    return max(abs(p_x), SLOWEST) / length if length > 0.0 else 0.0


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(relaxation=1.0 / values["length"])


EFFECT = Effect(
    id="tyre_relaxation",
    acts="contact",
    doc="Before saturation the lateral force lags: dF_t/dt = (F_t,steady − F_t) max(|p_x|, 0.05)/length.",
    parameters={"length": number("m", 0.0, math.inf, "relaxation length")},
    adapt=_adapt,
    hooks={"follow_rate": follow_rate},
    search=Search({"length": 0.3}, ((0.3,), (0.7,), (1.5,)), least=0.05),
)
