"""What compiled code asks of the effects: each question once, answered by all effects that know about it.

An effect answers under the hook's name in its `hooks`. Every function takes the record of all effects' parameters
first (`fx`, see `effects.record`; ``fx.t`` is the time of the instant, s) and SI values after it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.kernels.compilation import inlined

Hook = Callable[..., Any]


def _sum(first: Hook, second: Hook) -> Hook:
    def both(*about):
        return first(*about) + second(*about)

    return both


def _product(first: Hook, second: Hook) -> Hook:
    def both(*about):
        return first(*about) * second(*about)

    return both


def _vector_sum(first: Hook, second: Hook) -> Hook:
    def both(*about):
        x1, y1 = first(*about)
        x2, y2 = second(*about)
        return x1 + x2, y1 + y2

    return both


def _load_sum(first: Hook, second: Hook) -> Hook:
    def both(*about):
        x1, y1, m1 = first(*about)
        x2, y2, m2 = second(*about)
        return x1 + x2, y1 + y2, m1 + m2

    return both


def _chain(first: Hook, second: Hook) -> Hook:
    def both(fx, bound, value, about):
        return second(fx, bound, first(fx, bound, value, about), about)

    return both


def _stated(first: Hook, second: Hook) -> Hook:
    def both(*about):
        torque = first(*about)
        return torque if torque == torque else second(*about)

    return both


def _largest(first: Hook, second: Hook) -> Hook:
    def both(*about):
        return max(first(*about), second(*about))

    return both


def _in_turn(first: Hook, second: Hook) -> Hook:
    def both(fx, value):
        return second(fx, first(fx, value))

    return both


def _narrowing(first: Hook, second: Hook) -> Hook:
    def both(fx, about, low, high):
        low, high = first(fx, about, low, high)
        return second(fx, about, low, high)

    return both


class Place(NamedTuple):
    """Where effects can act.

    Attributes
    ----------
    combine : callable
        What becomes of the answers of two effects.
    kind : str
        What its answers take, by which versions of the loops over rovers side by side ask here
        (`lane_layout.VERSIONS`): "" little, so that every version asks; "resistance" a root and a quotient for every
        wheel, which most robots that are skid-steered have in all their fits; "motor" what motors with loops and limits
        of their own hold through a step; "speed" and "slip" exponentials and roots for every wheel; "seldom" the same,
        of effects that are tried seldom; "windup" and "bristles" what wheels remember; "transfer" the wheels' forces
        three times over.
    """

    combine: Callable[[Hook, Hook], Hook]
    kind: str = ""


PLACES: dict[str, Place] = {}
"""Every place by its name, in the order of the lines below."""


def _place(name: str, combine: Callable[[Hook, Hook], Hook], kind: str = "") -> Hook:
    """What compiled code calls there: the answers of all effects that have this name among their hooks."""
    PLACES[name] = Place(combine, kind)
    answers = dict.fromkeys(effect.hooks[name] for effect in EFFECTS.values() if name in effect.hooks)  # laws share one
    return reduce(lambda first, second: inlined(combine(first, second)), answers)


soil = _place("soil", _product)
"""(fx) → factor of k_l, k_t, mu_s and mu_d."""

grip = _place("grip", _product)
"""(fx, x, y) → factor of mu_s and mu_d for a wheel there in `map` (m)."""

stiffness_by_load = _place("stiffness_by_load", _product, "seldom")
"""(fx, load) → factor of k_l and k_t of a wheel that carries `load` times the rover's mean."""

stiffness_by_speed = _place("stiffness_by_speed", _product, "speed")
"""(fx, square) → the same of a wheel whose centre or rim, whichever is faster, moves at the root of `square` (m²/s²).

The square is asked about, for it takes no root.
"""

lateral_grip = _place("lateral_grip", _product)
"""(fx) → friction across a wheel over that along it."""

friction = _place("friction", _chain, "slip")
"""(fx, mu_s, mu, slip) → coefficient of a wheel that slides at `slip` (m/s) and would have `mu` without."""

early_fall = _place("early_fall", _largest, "slip")
"""(fx) → how far friction has fallen from mu_s towards `friction` before a wheel breaks away, 0 to 1."""

lateral = _place("lateral", _sum)
"""(fx, p_y, F_n) → lateral force on top of eq. 16's of a wheel that carries F_n, N."""

across = _place("across", _sum)
"""(fx, wheel, own) → lateral force of a law at a wheel (its number), N; `own` (`force_law.Own`) it may follow."""

along = _place("along", _sum)
"""(fx, motor, own) → longitudinal force of a law at both wheels of a motor (its number), N."""

lead = _place("lead", _product, "slip")
"""(fx, p_x, p_y) → factor of u_w for a wheel whose centre moves at p_x along it and p_y across (m/s)."""

follow_rate = _place("follow_rate", _sum, "slip")
"""(fx, p_x) → rate at which a wheel's lateral force follows eq. 15's, 1/s; zero for at once."""

bristle = _place("bristle", _vector_sum, "bristles")
"""(fx, rim) → stiffness of a wheel's bristles over its k_l and k_t, and the rate at which they are renewed, both 1/s.

Its rim moves at `rim` (m/s). Zero without bristles.
"""

windup = _place("windup", _sum, "windup")
"""(fx) → way of slip over which a wheel's longitudinal force builds up after a change of its sign, m; zero for at once.
"""

radius = _place("radius", _product, "seldom")
"""(fx, wheel, angle) → factor of the radius of a wheel (its number in the order of WHEELS) at its `angle` (rad)."""

drag = _place("drag", _sum)
"""(fx, motor, theta_dot) → torque against a motor's rotation, N m; it vanishes at rest."""

gear = _place("gear", _sum, "motor")
"""(fx, theta_dot) → the same of every motor that has a gear, beside `drag`, N m."""

limits = _place("limits", _narrowing, "motor")
"""(fx, theta_dot, low, high) → what is left of a motor's torques from low to high, N m."""

loop = _place("loop", _stated, "motor")
"""(fx, error, behind) → torque (N m) of a motor that is driven at a speed `error` (rad/s), whose integral is `behind`
(rad); NaN for whatever it takes to follow."""

wound = _place("wound", _in_turn, "motor")
"""(fx, behind) → what is left of that integral, rad; zero for a motor that has none."""

shaft = _place("shaft", _sum)
"""(fx, motor, angle, speed) → torque of a law that a motor needs beside its load, N m.

`angle` (rad) is that of its wheels, `speed` (m/s) their rolling speed."""

joint = _place("joint", _sum)
"""(fx, angle, rate) → torque against the articulation's yaw, N m."""

push = _place("push", _vector_sum)
"""(fx, module) → force on a module's origin along x and y of `map`, N."""

load = _place("load", _load_sum)
"""(fx, module) → force at a module's origin along and across its own frame, N, and yaw moment, N m."""

resist = _place("resist", _sum, "slip")
"""(fx, module, forward) → force against a module's forward motion, N, its origin moving forward at `forward` (m/s)."""

height = _place("height", _sum, "transfer")
"""(fx) → height of the modules' centres of mass over the ground, m; 0 where loads stay where they are at rest."""

wheel_resist = _place("wheel_resist", _vector_sum, "resistance")
"""(fx, friction, p_x, p_y) → force along and across a wheel on its centre, N, which moves at p_x and p_y (m/s).

`friction` is what friction holds of it (mu_s F_n, N). The wheel's motor does not feel this force.
"""

centre = _place("centre", _vector_sum)
"""(fx, module) → centre of mass of a module in its own frame, x and y, m."""
