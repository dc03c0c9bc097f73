"""Wheel and ground: eqs 15 to 19, wheel by wheel."""

from __future__ import annotations

import math

from artibot_sim.model.compiled import inlined
from artibot_sim.model.layout import F_L, F_N, F_T, P_X, P_Y, Q_C, SAT


@inlined
def wheel_kinematics(body, p, v_x, v_y, v_z, alpha_dot, gamma_dot, s_a, c_a, z, base, w):
    """Velocities p_x, p_y of a module's wheel centres and the normal forces F_n (eqs 15, 19).

    The module's velocity is given in its yaw frame; pitch does not reach the wheels (section 4.3). The ground
    does not pull: F_n is zero where a wheel is off the ground.
    """
    for i in range(4):
        x = body.half_x if i % 2 == 0 else -body.half_x
        y = -body.half_y if i < 2 else body.half_y
        w[P_X + base + i] = v_x - gamma_dot * y * c_a
        w[P_Y + base + i] = c_a * (v_y + gamma_dot * x) + s_a * v_z
        F_n = p.k_n * (body.r_0 - z - y * s_a) - p.c_n * (v_z + alpha_dot * y * c_a)
        w[F_N + base + i] = max(F_n, 0.0)


@inlined
def wheel_force(p, r_omega, p_x, p_y, F_n):
    """Eqs 15 and 16: F_l, F_t of a wheel whose rim moves at `r_omega` (m/s), and whether eq. 16 has cut them."""
    F_l = p.k_l * (r_omega - p_x)
    F_t = -p.k_t * p_y
    F_h2 = F_l * F_l + F_t * F_t
    limit = p.mu_s * F_n
    if F_h2 > limit * limit:
        scale = p.mu_d * F_n / math.sqrt(F_h2)
        return F_l * scale, F_t * scale, 1.0
    return F_l, F_t, 0.0


@inlined
def motor_wheels(p, omega, first, w):
    """Forces of the two wheels `first`, `first + 1` that turn at `omega` (rad/s), into the row.

    Returns
    -------
    tuple of 2 floats
        Sums of F_l and of F_n over the two, N (for eq. 22).
    """
    F_l_sum, F_n_sum = 0.0, 0.0
    for i in range(first, first + 2):
        F_l, F_t, sat = wheel_force(p, p.r_w * omega, w[P_X + i], w[P_Y + i], w[F_N + i])
        w[F_L + i], w[F_T + i], w[SAT + i] = F_l, F_t, sat
        F_l_sum += F_l
        F_n_sum += w[F_N + i]
    return F_l_sum, F_n_sum


@inlined
def generalised_forces(body, p, s_a, c_a, s_g, c_g, base, out, w):
    """Eqs 17, 18: the wheels' forces on one module's x, y, z, alpha, beta, gamma, into the row at `out`.

    They act u_w ahead of the wheel centres (eq. 20).
    """
    f_x, f_y, f_z, m_a, m_g = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        x = (body.half_x if i % 2 == 0 else -body.half_x) + p.u_w
        y = -body.half_y if i < 2 else body.half_y
        F_l, F_t, F_n = w[F_L + base + i], w[F_T + base + i], w[F_N + base + i]
        across = F_t * c_a - F_n * s_a
        f_x += F_l
        f_y += across
        f_z += F_t * s_a + F_n * c_a
        m_a += y * F_n
        m_g += x * across - y * c_a * F_l
    w[Q_C + out] = c_g * f_x - s_g * f_y
    w[Q_C + out + 1] = s_g * f_x + c_g * f_y
    w[Q_C + out + 2] = f_z
    w[Q_C + out + 3] = m_a
    w[Q_C + out + 4] = 0.0
    w[Q_C + out + 5] = m_g
