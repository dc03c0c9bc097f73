"""Load on a module."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, choice, number
from artibot_sim.model.robot.environment import STANDARD_GRAVITY

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params


def _adapt(p: Params, values: Values) -> Params:
    """As every module does, the loaded one stands level: its rolling radius is that under its whole weight."""
    name, mass = values["module"], values["mass"]
    body = p.back if name == "back" else p.front
    m = body.m + mass
    loaded = body._replace(
        m=m, r_0=body.r_0 + mass * STANDARD_GRAVITY / (4 * p.k_n), inverse=(1 / m, 1 / m, 1 / m, *body.inverse[3:])
    )
    return p._replace(back=loaded) if name == "back" else p._replace(front=loaded)


EFFECT = Effect(
    id="payload",
    acts="body",
    doc="An extra point mass at a module's origin, its weight on the module's wheels.",
    claim="a load of {mass} is on the {module} module",
    parameters={
        "mass": number("kg", 0.0, math.inf, "of the load"),
        "module": choice(("front", "back"), "which module carries it"),
    },
    adapt=_adapt,
    search=Search({"mass": 15.0}, ((0.2,), (0.5,), (1.5,))),
)
