"""Ground that resists each wheel where it goes: a skid-steering wheel is held back sideways as well as ahead."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import tanh
from artibot_sim.model.robot.environment import STANDARD_GRAVITY

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

WIDTH = 0.02
"""Speed of a wheel's centre over which the force builds up (tanh), m/s."""


@inlined
def wheel_resist(fx, friction, p_x, p_y):
    """Force on a wheel's centre along and across the wheel, N; `friction` (N) is what eq. 16 holds of it."""
    share = fx.wheel_resistance.share
    if share <= 0.0:
        return 0.0, 0.0
    speed = math.sqrt(p_x * p_x + (p_y * p_y + 1e-30))  # so that there is something to divide by
    scale = -share * friction * tanh(speed * (1.0 / WIDTH)) / speed
    return scale * p_x, scale * p_y


def _adapt(p: Params, values: Values) -> Params:
    """What it adds at most to the damping of a wheel's motion: at rest, where the force builds up."""
    friction = max(body.mu_s * body.m for body in (p.front, p.back)) * STANDARD_GRAVITY / 4.0
    steepest = values["share"] * friction / WIDTH
    return p._replace(
        lateral_damping=p.lateral_damping + steepest, forward_damping=p.forward_damping + steepest
    )  # fmt: skip


EFFECT = Effect(
    id="wheel_resistance",
    acts="contact",
    doc="A force of `share` mu_s F_n on each wheel's centre against its motion over the ground, whatever the wheel "
    "turns: soil that is pushed and pressed down. It acts on the module beside the force of eq. 16, not on the motor.",
    claim="the ground holds each wheel back with {share} of its friction force",
    parameters={"share": number("-", 0.0, 1.0, "of the friction force mu_s F_n")},
    adapt=_adapt,
    hooks={"wheel_resist": wheel_resist},
    search=Search({"share": 0.08}, ((0.3,), (1.0,), (2.5,))),
)
