"""Ground that holds a wheel at rest: bristles between wheel and ground, which bend and are renewed by rolling."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

TIME = 0.005
"""k_l and k_t over the bristles' stiffness, s: a wheel that is loaded at rest comes to stand within this time."""


@inlined
def bristle(fx, rim):
    """Stiffness of a wheel's bristles over its k_l and k_t, and the rate at which rolling renews them, both 1/s."""
    length = fx.stiction.length
    if length <= 0.0:
        return 0.0, 0.0
    return 1.0 / TIME, abs(rim) / length


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(relaxation=max(p.relaxation, 1.0 / values["length"]), bristle=1.0 / TIME)


EFFECT = Effect(
    id="stiction",
    acts="contact",
    doc="Beside eq. 15's force stands that of bristles of stiffness k_l/5 ms along a wheel and k_t/5 ms across it. "
    "They bend with the slip, are renewed as the wheel rolls `length`, and hold mu_s F_n at most: a wheel at rest "
    "holds without creeping, one that rolls at v with little slip meets k_l and k_t (1 + length/(5 ms v)).",
    parameters={"length": number("m", 0.0, math.inf, "way of rolling over which bristles are renewed")},
    adapt=_adapt,
    hooks={"bristle": bristle},
    search=Search(
        {"length": 0.01},
        ((0.5,), (2.0,), (8.0,)),
        least=0.1,
        ridge={"contact.k_l": -1.0, "contact.k_t": -1.0},
        ridge_from=TIME * 0.5,  # a wheel that rolls at half a metre per second meets k_l (1 + length/ridge_from)
    ),
)
