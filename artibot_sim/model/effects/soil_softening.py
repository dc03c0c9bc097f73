"""Ground that softens as time goes by: rain, or a track that is driven again and again."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined

LEAST = 0.05
"""What is left of the soil in the end."""


@inlined
def soil(fx):
    """Factor of k_l, k_t, mu_s and mu_d at the time ``fx.t``."""
    return max(LEAST, 1.0 - fx.soil_softening.rate * fx.t)


EFFECT = Effect(
    id="soil_softening",
    acts="contact",
    doc="k_l, k_t, mu_s and mu_d shrink as max(0.05, 1 − rate t), t being the state's time, s.",
    parameters={"rate": number("1/s", 0.0, math.inf, "share that is lost a second")},
    hooks={"soil": soil},
    search=Search({"rate": 0.008}, ((0.4,), (1.2,))),
)
