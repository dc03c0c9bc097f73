"""Where the energy goes on a plane: `energy.powers` without what only roll and heave bring."""

from __future__ import annotations

import numpy as np

from artibot_sim.model.compiled import inlined
from artibot_sim.model.elementary import tanh_alone
from artibot_sim.model.integrators import EFFICIENCY
from artibot_sim.model.layout import (
    E_GEAR,
    E_JOINT,
    E_MOTOR,
    E_OFFSET,
    E_ROLLING,
    E_SLIP_L,
    E_SLIP_T,
    MOTOR,
)
from artibot_sim.model.planar import module_pairs
from artibot_sim.model.transmission import ROLLING_WIDTH

FIRST = tuple(map(np.int64, (0, 2, 4, 6)))
"""The first wheel of each motor."""


@inlined
def pair_powers(p, unit, pair, pull, i, omega, gamma_dot, weight, e):
    """Of two wheels that turn at `omega` (rad/s); `i` is the front one's number."""
    rim, lead = unit.r_w * omega - pair.p_x, weight * p.u_w
    sign = tanh_alone(omega * (1.0 / ROLLING_WIDTH))
    roll_f, roll_b = (pull.F_lf, pull.F_lb) if p.literal_eq22 else (pair.F_nf * sign, pair.F_nb * sign)
    e[E_SLIP_L + i] += weight * (pull.F_lf * rim)
    e[E_SLIP_L + i + 1] += weight * (pull.F_lb * rim)
    e[E_SLIP_T + i] -= weight * (pull.F_tf * pair.p_yf)
    e[E_SLIP_T + i + 1] -= weight * (pull.F_tb * pair.p_yb)
    e[E_OFFSET + i] -= lead * (gamma_dot * pull.F_tf)
    e[E_OFFSET + i + 1] -= lead * (gamma_dot * pull.F_tb)
    e[E_ROLLING + i] += lead * (omega * roll_f)
    e[E_ROLLING + i + 1] += lead * (omega * roll_b)


@inlined
def motor_power(unit, motor, speed, acceleration, M_m, M_r, hold, weight, e):
    """Put in by a motor, and lost in its gear."""
    passed = unit.tau * speed * (unit.J_w * unit.tau * acceleration + M_r)
    e[E_MOTOR + motor] += weight * (M_m * speed)
    e[E_GEAR + motor] += weight * ((1.0 / hold[EFFICIENCY + motor] - 1.0) * passed)


@inlined
def level_powers(at, p, motions, trig, v, a, acting, M_m, M_r, hold, weight, e):
    """Add `weight` (s) times the power of every contribution to the energies `e` (ENERGIES,).

    Parameters
    ----------
    motions : tuple of 2 Motion
        At which the forces are.
    v : tuple of 10 floats
        Rates that they act at.
    """
    f, b = motions
    pulls, _, (l_x, l_y, turn_f, turn_b) = acting
    one, two = p.right_front, p.left_front
    pair_r, pair_l, _, _ = module_pairs(at.front, at.ground, None, f, trig[0], trig[1])
    pair_powers(p, one, pair_r, pulls[0], FIRST[0], one.tau * v[6], v[2], weight, e)
    pair_powers(p, two, pair_l, pulls[1], FIRST[1], two.tau * v[7], v[2], weight, e)
    motor_power(one, MOTOR[0], v[6], a[6], M_m[0], M_r[0], hold, weight, e)
    motor_power(two, MOTOR[1], v[7], a[7], M_m[1], M_r[1], hold, weight, e)
    if p.two:
        one, two = p.right_back, p.left_back
        pair_r, pair_l, _, _ = module_pairs(at.back, at.ground, None, b, trig[2], trig[3])
        pair_powers(p, one, pair_r, pulls[2], FIRST[2], one.tau * v[8], v[5], weight, e)
        pair_powers(p, two, pair_l, pulls[3], FIRST[3], two.tau * v[9], v[5], weight, e)
        motor_power(one, MOTOR[2], v[8], a[8], M_m[2], M_r[2], hold, weight, e)
        motor_power(two, MOTOR[3], v[9], a[9], M_m[3], M_r[3], hold, weight, e)
        e[E_JOINT] += weight * (l_x * (v[3] - v[0]) + l_y * (v[4] - v[1]) + (turn_f * v[2] + turn_b * v[5]))
