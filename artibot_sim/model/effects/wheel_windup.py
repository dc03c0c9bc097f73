"""Tyres or drives that wind up: a wheel's force along it comes back slowly after it has changed its sign."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params


@inlined
def windup(fx):
    """Way over which a wheel's longitudinal force builds up, m; zero where it is eq. 16's at once."""
    return fx.wheel_windup.way


def _adapt(p: Params, values: Values) -> Params:
    return p._replace(relaxation=max(p.relaxation, 1.0 / values["way"]))


EFFECT = Effect(
    id="wheel_windup",
    acts="contact",
    doc="F_l is eq. 16's times (1 + s sign(F_l))/2, with ds/dt = (slip − s |slip|)/way (Dahl's law): after a change of "
    "sign it grows from zero as 1 − exp(−slipped/way), and as much slip as `way` is lost.",
    claim="tyres or drives have play: the force along a wheel turns round over {way} of slip",
    parameters={"way": number("m", 0.0, math.inf, "slip that a wheel loses when the force along it changes its sign")},
    adapt=_adapt,
    hooks={"windup": windup},
    search=Search({"way": 0.02}, ((0.3,), (1.0,), (3.0,)), least=0.05),
)
