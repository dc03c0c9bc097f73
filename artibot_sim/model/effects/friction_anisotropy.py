"""Wheels that hold sideways less, or more, than ahead: lugs, a tread along the wheel."""

from __future__ import annotations

from artibot_sim.model.effects.base import Effect, Search, number
from artibot_sim.model.kernels.compilation import inlined


@inlined
def lateral_grip(fx):
    """Friction across a wheel over that along it."""
    return fx.friction_anisotropy.ratio


EFFECT = Effect(
    id="friction_anisotropy",
    acts="contact",
    doc="Eq. 16's limit is an ellipse: `ratio` times mu_s F_n and mu_d F_n across the wheel, the whole along it.",
    parameters={"ratio": number("-", 0.0, 10.0, "friction across a wheel over that along it", 1.0, low_open=True)},
    hooks={"lateral_grip": lateral_grip},
    search=Search({"ratio": 0.4}, ((-1.0,), (1.0,)), logarithmic=True),
)
