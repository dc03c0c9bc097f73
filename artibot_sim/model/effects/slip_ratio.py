"""Wheels whose force follows how much they slip for their speed, not how fast."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import exp, log

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

REFERENCE = 0.5
"""Speed at which the force is eq. 15's, m/s: that of the paper's Test 1 and of Table 6."""

SLOWEST = 0.02
"""Least speed that counts, m/s: at standstill the ground would be infinitely stiff."""


@inlined
def stiffness_by_speed(fx, square):
    """Factor of k_l and k_t of a wheel that moves or turns at the root of `square` (m²/s²)."""
    power = 0.5 * (fx.slip_ratio.exponent - 1.0)
    least = (SLOWEST / REFERENCE) ** 2
    counted = square * (1.0 / REFERENCE**2)
    counted = counted if counted > least else least
    return exp(power * log(counted)) if power != 0.0 else 1.0


def _adapt(p: Params, values: Values) -> Params:
    """How much stiffer the ground is for the slowest wheel, or the fastest that is foreseen (2 m/s)."""
    power = 1.0 - values["exponent"]
    return p._replace(stiffening=p.stiffening * max((REFERENCE / speed) ** power for speed in (SLOWEST, 2.0)))


EFFECT = Effect(
    id="slip_ratio",
    acts="contact",
    doc="k_l and k_t are multiplied by (0.5 m/s over |v|)^(1 − exponent), |v| being the greater of the "
    "speeds of the wheel's centre and its rim, and 0.02 m/s at least. With 1 the force follows the slip speed, as eq. "
    "15 has it, with 0 slip over speed, so that a path does not depend on how fast it is driven.",
    parameters={"exponent": number("-", 0.0, 2.0, "0: slip over speed, 1: slip speed", 1.0)},
    adapt=_adapt,
    hooks={"stiffness_by_speed": stiffness_by_speed},
    search=Search({"exponent": 0.5}, ((-0.5,), (-1.0,), (-2.0,), (1.0,))),
)
