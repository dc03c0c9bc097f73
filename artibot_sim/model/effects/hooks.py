"""What compiled code asks of the effects: each question once, answered by all effects that know about it.

An effect answers under the hook's name in its `hooks`. Every function takes the record of all effects' parameters
first (`fx`, see `effects.record`; ``fx.t`` is the time of the instant, s) and SI values after it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.kernels.compilation import inlined

Hook = Callable[..., Any]


def _all(name: str) -> list[Hook]:
    return [effect.hooks[name] for effect in EFFECTS.values() if name in effect.hooks]


def _sum(first: Hook, second: Hook) -> Hook:
    @inlined
    def both(*about):
        return first(*about) + second(*about)

    return both


def _product(first: Hook, second: Hook) -> Hook:
    @inlined
    def both(*about):
        return first(*about) * second(*about)

    return both


def _vector_sum(first: Hook, second: Hook) -> Hook:
    @inlined
    def both(*about):
        x1, y1 = first(*about)
        x2, y2 = second(*about)
        return x1 + x2, y1 + y2

    return both


def _load_sum(first: Hook, second: Hook) -> Hook:
    @inlined
    def both(*about):
        x1, y1, m1 = first(*about)
        x2, y2, m2 = second(*about)
        return x1 + x2, y1 + y2, m1 + m2

    return both


def _chain(first: Hook, second: Hook) -> Hook:
    @inlined
    def both(fx, bound, value, about):
        return second(fx, bound, first(fx, bound, value, about), about)

    return both


soil = reduce(_product, _all("soil"))
"""(fx) → factor of k_l, k_t, mu_s and mu_d."""

grip = reduce(_product, _all("grip"))
"""(fx, x, y) → factor of mu_s and mu_d for a wheel there in `map` (m)."""

friction = reduce(_chain, _all("friction"))
"""(fx, mu_s, mu, slip) → coefficient of a wheel that slides at `slip` (m/s) and would have `mu` without."""

lateral = reduce(_sum, _all("lateral"))
"""(fx, p_y) → lateral force on top of eq. 16's, N."""

lead = reduce(_product, _all("lead"))
"""(fx, speed) → factor of u_w for a wheel whose centre moves at `speed` (m/s)."""

follow_rate = reduce(_sum, _all("follow_rate"))
"""(fx, p_x) → rate at which a wheel's lateral force follows eq. 15's, 1/s; zero for at once."""

drag = reduce(_sum, _all("drag"))
"""(fx, motor, theta_dot) → torque against a motor's rotation, N m; it vanishes at rest."""

joint = reduce(_sum, _all("joint"))
"""(fx, angle, rate) → torque against the articulation's yaw, N m."""

push = reduce(_vector_sum, _all("push"))
"""(fx, module) → force on a module's origin along x and y of `map`, N."""

load = reduce(_load_sum, _all("load"))
"""(fx, module) → force at a module's origin along and across its own frame, N, and yaw moment, N m."""

resist = reduce(_sum, _all("resist"))
"""(fx, module, forward) → force against a module's forward motion, N, its origin moving forward at `forward` (m/s)."""

wheel_resist = reduce(_vector_sum, _all("wheel_resist"))
"""(fx, friction, p_x, p_y) → force along and across a wheel on its centre, N, which moves at p_x and p_y (m/s).

`friction` is what friction holds of it (mu_s F_n, N). The wheel's motor does not feel this force.
"""

centre = reduce(_vector_sum, _all("centre"))
"""(fx, module) → centre of mass of a module in its own frame, x and y, m."""
