"""Back wheels that run in the track of the front ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params


def _adapt(p: Params, values: Values) -> Params:
    scale, soil = values["scale"], p.back
    return p._replace(
        back=soil._replace(k_l=scale * soil.k_l, k_t=scale * soil.k_t, mu_s=scale * soil.mu_s, mu_d=scale * soil.mu_d)
    )


EFFECT = Effect(
    id="back_friction",
    acts="contact",
    doc="k_l, k_t, mu_s and mu_d of the back wheels are scaled.",
    parameters={"scale": number("-", 0.0, 10.0, "of the back wheels' soil", 1.0, low_open=True)},
    adapt=_adapt,
    search=Search({"scale": 0.5}, ((-1.0,), (1.0,)), logarithmic=True, back=True),
)
