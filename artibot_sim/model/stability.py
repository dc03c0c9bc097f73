"""How long a step may be: the fastest modes of the model against each integrator's stability limit."""

from __future__ import annotations

import math
from collections.abc import Sequence

from artibot_sim.model.params import ModuleParams, MotorParams, Params
from artibot_sim.model.transmission import PRESCRIBED

REAL_LIMIT = {"rk4": 2.785, "semi_implicit": 2.0}
"""|lambda| dt up to which a decaying mode is damped."""

OSCILLATION_LIMIT = {"rk4": 2.828, "semi_implicit": 2.0}
"""omega dt up to which an undamped mode does not grow."""


def spin_rate(p: Params, motor: MotorParams) -> float:
    """Decay rate of a free wheel pair's slip (1/s): the stiffest mode; the worse of the two efficiencies."""
    rates = []
    for eta in (motor.eta_d, 1.0 / motor.eta_r):
        gear = motor.tau**2 / eta
        rates.append(2.0 * p.k_l * p.r_w**2 * gear / (motor.J_m + motor.J_w * gear))
    return max(rates)


def _slip_rate(p: Params, body: ModuleParams) -> float:
    turn = 4.0 * (p.k_l * body.half_y**2 + p.k_t * body.half_x**2) / body.J_z
    return max(4.0 * max(p.k_l, p.k_t) / body.m, turn)


def _bounce(p: Params, body: ModuleParams) -> float:
    return max(math.sqrt(4.0 * p.k_n / body.m), math.sqrt(4.0 * p.k_n * body.half_y**2 / body.J_x))


def largest_step(p: Params, integrator: str, modes: Sequence[int]) -> tuple[float, str]:
    """Longest stable step (s), and which mode sets it.

    Rates are those of wheels that hold (eq. 15), module by module; a saturated wheel is slower. Wheel spin
    counts only where it is integrated explicitly: free motors under RK4.
    """
    bodies = (("front", p.front), ("back", p.back))[: 2 if p.two else 1]
    real, bounce = REAL_LIMIT[integrator], OSCILLATION_LIMIT[integrator]
    limits = [(real / _slip_rate(p, body), f"slip of the {name} module") for name, body in bodies]
    limits += [(bounce / _bounce(p, body), f"vertical motion of the {name} module") for name, body in bodies]
    limits.append((2.0 / p.A_motor, "control.A_motor"))
    if p.two and p.A_joint > 0.0:
        limits.append((2.0 / p.A_joint, "control.A_joint"))
    if integrator == "rk4":
        motors = (p.right_front, p.left_front, p.right_back, p.left_back)
        limits += [
            (real / spin_rate(p, motor), "wheel spin of motors that are not prescribed")
            for motor, mode in zip(motors[: 4 if p.two else 2], modes, strict=False)
            if mode != PRESCRIBED
        ]
    return min(limits)
