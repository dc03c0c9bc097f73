"""Friction that falls with the slip speed instead of at once."""

from __future__ import annotations

import math

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import exp


@inlined
def early_fall(fx):
    """How far the coefficient has fallen from mu_s before a wheel breaks away: 1 as once it slides."""
    return fx.stribeck.early if fx.stribeck.velocity > 0.0 else 0.0


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
    doc="A wheel that slides has the coefficient mu(s) = mu_d + (mu_s − mu_d) exp(−s/velocity), s being the whole slip "
    "speed. It holds up to (mu_s + early (mu(s) − mu_s)) F_n: with `early` 0 up to mu_s F_n, with 1 friction falls "
    "from the first slip on, and the force does not drop as the wheel breaks away.",
    parameters={
        "velocity": number("m/s", 0.0, math.inf, "slip speed over which friction falls"),
        "early": number("-", 0.0, 1.0, "how far it has fallen before a wheel breaks away: 1 as once it slides"),
    },
    hooks={"early_fall": early_fall, "friction": friction},
    search=Search({"velocity": 0.08}, ((0.3,), (1.0,), (2.5,)), forms={"early": (0.0, 1.0)}, least=0.05),
)
