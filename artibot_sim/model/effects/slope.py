"""Sloped ground, as eq. 12 does it: the gravity vector tilts, the ground stays the plane z = 0."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.robot.environment import STANDARD_GRAVITY, gravity

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import ModuleParams, Params


def _adapt(p: Params, values: Values) -> Params:
    """As on flat ground both modules stand level: their rolling radius is that under the load that is left."""
    g_x, g_y, g_z = gravity(**values)

    def level(body: ModuleParams) -> ModuleParams:
        return body._replace(r_0=body.r_0 - body.m * (STANDARD_GRAVITY + g_z) / (4 * p.k_n))

    return p._replace(g_x=g_x, g_y=g_y, g_z=g_z, front=level(p.front), back=level(p.back))


EFFECT = Effect(
    id="slope",
    acts="environment",
    doc="Each module is pulled by m g sin(grade) towards `heading` in `map`.",
    claim="the ground falls by {grade}",
    parameters={
        "grade": number("rad", -0.8, 0.8, "angle of the slope"),
        "heading": number("rad", -math.inf, math.inf, "direction downhill in map"),
    },
    adapt=_adapt,
    uniform=False,
    search=Search({"grade": 0.05}, direction="heading"),
)
