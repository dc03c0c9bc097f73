"""Friction that falls with the slip speed instead of at once."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import exp


@inlined
def friction(fx, mu_s, mu, slip):
    """Coefficient of a wheel that slides at `slip` (m/s), where it is `mu` otherwise."""
    velocity = fx.stribeck.velocity
    if velocity <= 0.0:
        return mu
    return mu + (mu_s - mu) * exp(-slip / velocity)


EFFECT = Effect(
    id="stribeck",
    acts="contact",
    doc="Once F_h > mu_s F_n the coefficient is mu_d + (mu_s − mu_d) exp(−s/velocity), s being the whole slip speed.",
    parameters={"velocity": number("m/s", 0.0, math.inf, "slip speed over which friction falls")},
    hooks={"friction": friction},
    search=Search({"velocity": 0.08}, ((0.3,), (1.0,), (2.5,)), least=0.05),
)
