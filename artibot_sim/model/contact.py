"""Wheel and ground: eqs 15 to 19, wheel by wheel."""

from __future__ import annotations

import math

from artibot_sim.model.compiled import inlined
from artibot_sim.model.layout import F_L, F_N, F_T, P_X, P_Y, Q_C, SAT


@inlined
def normal_force(body, p, y, v_z, alpha_dot, s_a, c_a, z):
    """F_n of a wheel at `y` (eq. 15); the ground does not pull, so it is zero where the wheel is off the ground."""
    return max(p.k_n * (body.r_0 - z - y * s_a) - p.c_n * (v_z + alpha_dot * y * c_a), 0.0)


@inlined
def wheel_kinematics(body, p, v_x, v_y, v_z, alpha_dot, gamma_dot, s_a, c_a, z, module, w):
    """Velocities p_x, p_y of a module's wheel centres and the normal forces F_n (eqs 15, 19), also into the row.

    The module's velocity is given in its yaw frame. Pitch does not reach the wheels (section 4.3), so p_x and F_n
    are the same for both wheels of a side, and p_y for both of an axle.

    Returns
    -------
    tuple of 6 floats
        p_x right and left, p_y in front and behind (m/s), F_n right and left (N).
    """
    turn, sweep, slide = gamma_dot * body.half_y * c_a, gamma_dot * body.half_x * c_a, c_a * v_y + s_a * v_z
    right, left = v_x + turn, v_x - turn
    front, back = slide + sweep, slide - sweep
    F_right = normal_force(body, p, -body.half_y, v_z, alpha_dot, s_a, c_a, z)
    F_left = normal_force(body, p, body.half_y, v_z, alpha_dot, s_a, c_a, z)
    i = 4 * module
    w[P_X + i], w[P_X + i + 1], w[P_X + i + 2], w[P_X + i + 3] = right, right, left, left
    w[P_Y + i], w[P_Y + i + 1], w[P_Y + i + 2], w[P_Y + i + 3] = front, back, front, back
    w[F_N + i], w[F_N + i + 1], w[F_N + i + 2], w[F_N + i + 3] = F_right, F_right, F_left, F_left
    return right, left, front, back, F_right, F_left


@inlined
def saturated(p, F_l, F_t, F_n):
    """Eq. 16: F_l, F_t within what friction holds, and the share of them that is left: 1 where nothing is cut."""
    F_h2 = F_l * F_l + F_t * F_t
    limit = p.mu_s * F_n
    if F_h2 > limit * limit:
        held = p.mu_d * F_n / math.sqrt(F_h2)
        return F_l * held, F_t * held, held
    return F_l, F_t, 1.0


@inlined
def motor_wheels(p, omega, p_x, p_yf, p_yb, F_n, motor, w):
    """Eqs 15 and 16 for the front and the back wheel of a motor, which turn at `omega` (rad/s), into the row.

    Returns
    -------
    tuple of 3 floats
        Sum of both F_l; F_t in front; F_t behind (N).
    """
    F_l = p.k_l * (p.r_w * omega - p_x)
    F_lf, F_tf, held_f = saturated(p, F_l, -p.k_t * p_yf, F_n)
    F_lb, F_tb, held_b = saturated(p, F_l, -p.k_t * p_yb, F_n)
    i = 2 * motor
    w[F_L + i], w[F_T + i], w[SAT + i] = F_lf, F_tf, 1.0 if held_f != 1.0 else 0.0
    w[F_L + i + 1], w[F_T + i + 1], w[SAT + i + 1] = F_lb, F_tb, 1.0 if held_b != 1.0 else 0.0
    return F_lf + F_lb, F_tf, F_tb


@inlined
def generalised_forces(body, p, s_a, c_a, s_g, c_g, right, left, F_n_right, F_n_left, module, w):
    """Eqs 17, 18: the wheels' forces on one module's x, y, z, alpha, beta, gamma, also into the row.

    They act u_w ahead of the wheel centres (eq. 20).

    Parameters
    ----------
    right, left : tuple of 3 floats
        What `motor_wheels` returns for the two sides.

    Returns
    -------
    tuple of 5 floats
        Without that on beta, which is zero.
    """
    F_n = F_n_right + F_n_left
    across_f = c_a * (right[1] + left[1]) - s_a * F_n
    across_b = c_a * (right[2] + left[2]) - s_a * F_n
    f_x, f_y = right[0] + left[0], across_f + across_b
    m_g = (body.half_x + p.u_w) * across_f - (body.half_x - p.u_w) * across_b + body.half_y * c_a * (right[0] - left[0])
    x, y = c_g * f_x - s_g * f_y, s_g * f_x + c_g * f_y
    z = s_a * (right[1] + left[1] + right[2] + left[2]) + 2.0 * c_a * F_n
    m_a = 2.0 * body.half_y * (F_n_left - F_n_right)
    o = Q_C + 6 * module
    w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 5] = x, y, z, m_a, 0.0, m_g
    return x, y, z, m_a, m_g
