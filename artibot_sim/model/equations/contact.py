"""Wheel and ground: eqs 15 to 19, wheel by wheel.

`fx` is None for the paper's model, and the record of the effects' parameters in the extended one: what stands under
``if fx is not None`` is not even compiled into the former.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from artibot_sim.model.effects import hooks
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.layout import F_L, F_N, F_T, P_X, P_Y, Q_C, SAT


class Pair(NamedTuple):
    """What the two wheels of a motor meet, the front one (f) and the back one (b).

    p_x, p_yf, p_yb are the velocities of their centres, m/s; F_nf, F_nb normal forces, N.
    """

    p_x: float
    p_yf: float
    p_yb: float
    F_nf: float
    F_nb: float


class Soil(NamedTuple):
    """The ground under a pair of wheels: eq. 15's coefficients, and eq. 16's for the front one and the back one.

    u_f, u_b are how far ahead of the wheels' centres the forces act, m.
    """

    u_f: float
    u_b: float
    k_l: float
    k_t: float
    mu_sf: float
    mu_df: float
    mu_sb: float
    mu_db: float


@inlined
def unloaded_radius(body, p, fx, module, end, side):
    """With effects: r_0 of the wheel at `end` (1 in front, −1 behind) and `side` (1 left, −1 right), m.

    A wheel that carries more than a quarter of its module's weight is as much larger as it sinks deeper: so the
    rover stands level, and each wheel has its static load m g/4 (1 ± 2x/i_x)(1 ± 2y/i_y).
    """
    x, y = hooks.centre(fx, module)
    share = (1.0 + end * x / body.half_x) * (1.0 + side * y / body.half_y)
    return body.r_0 - body.m * p.g_z / (4.0 * p.k_n) * (share - 1.0)


@inlined
def normal_force(body, p, fx, module, end, side, v_z, alpha_dot, s_a, c_a, z):
    """F_n of a wheel (eq. 15), see `unloaded_radius`; the ground does not pull, so it is zero for one in the air."""
    y = side * body.half_y
    r_0 = body.r_0
    if fx is not None:
        r_0 = unloaded_radius(body, p, fx, module, end, side)
    return max(p.k_n * (r_0 - z - y * s_a) - p.c_n * (v_z + alpha_dot * y * c_a), 0.0)


@inlined
def wheel_pairs(body, p, fx, v_x, v_y, v_z, alpha_dot, gamma_dot, s_a, c_a, z, module, w):
    """What a module's wheels meet: velocities of their centres (eq. 19) and normal forces (eq. 15).

    The module's velocity is given in its yaw frame. Pitch does not reach the wheels (section 4.3), so p_x and
    (for a mass in the middle) F_n are the same for both wheels of a side, and p_y for both of an axle. All goes into
    the row, too.

    Returns
    -------
    tuple of 2 Pair
        Right and left.
    """
    turn, sweep, slide = gamma_dot * body.half_y * c_a, gamma_dot * body.half_x * c_a, c_a * v_y + s_a * v_z
    right, left = v_x + turn, v_x - turn
    front, back = slide + sweep, slide - sweep
    F_rf = normal_force(body, p, fx, module, 1.0, -1.0, v_z, alpha_dot, s_a, c_a, z)
    F_lf = normal_force(body, p, fx, module, 1.0, 1.0, v_z, alpha_dot, s_a, c_a, z)
    if fx is not None:
        F_rb = normal_force(body, p, fx, module, -1.0, -1.0, v_z, alpha_dot, s_a, c_a, z)
        F_lb = normal_force(body, p, fx, module, -1.0, 1.0, v_z, alpha_dot, s_a, c_a, z)
    else:
        F_rb, F_lb = F_rf, F_lf
    i = 4 * module
    w[P_X + i], w[P_X + i + 1], w[P_X + i + 2], w[P_X + i + 3] = right, right, left, left
    w[P_Y + i], w[P_Y + i + 1], w[P_Y + i + 2], w[P_Y + i + 3] = front, back, front, back
    w[F_N + i], w[F_N + i + 1], w[F_N + i + 2], w[F_N + i + 3] = F_rf, F_rb, F_lf, F_lb
    return Pair(right, front, back, F_rf, F_rb), Pair(left, front, back, F_lf, F_lb)


@inlined
def soil_under(body, p, fx, pair, x, y, s_g, c_g, c_a, side):
    """The soil under the wheels on one `side` (1 left, −1 right) of a module at (x, y) in `map`."""
    if fx is not None:
        soil = hooks.soil(fx)
        out_x, out_y = x - side * s_g * c_a * body.half_y, y + side * c_g * c_a * body.half_y
        on_f = soil * hooks.grip(fx, out_x + c_g * body.half_x, out_y + s_g * body.half_x)
        on_b = soil * hooks.grip(fx, out_x - c_g * body.half_x, out_y - s_g * body.half_x)
        u_f = p.u_w * hooks.lead(fx, math.sqrt(pair.p_x * pair.p_x + pair.p_yf * pair.p_yf))
        u_b = p.u_w * hooks.lead(fx, math.sqrt(pair.p_x * pair.p_x + pair.p_yb * pair.p_yb))
        return Soil(
            u_f, u_b, soil * body.k_l, soil * body.k_t,
            on_f * body.mu_s, on_f * body.mu_d, on_b * body.mu_s, on_b * body.mu_d,
        )  # fmt: skip
    return Soil(p.u_w, p.u_w, body.k_l, body.k_t, body.mu_s, body.mu_d, body.mu_s, body.mu_d)


@inlined
def saturated(body, fx, F_l, F_t, F_n, mu_s, mu_d, slip_l, slip_t):
    """Eq. 16: F_l, F_t within what friction holds, and the share of them that is left: 1 where nothing is cut.

    Without effects mu_d is read only where it is needed: else the compiler would always take the root, and divide.
    """
    F_h2 = F_l * F_l + F_t * F_t
    limit = mu_s * F_n
    if F_h2 > limit * limit:
        if fx is not None:
            mu_d = hooks.friction(fx, mu_s, mu_d, math.sqrt(slip_l * slip_l + slip_t * slip_t))
        else:
            mu_d = body.mu_d
        held = mu_d * F_n / math.sqrt(F_h2)
        return F_l * held, F_t * held, held
    return F_l, F_t, 1.0


@inlined
def relaxed(fx, F_t, p_x, lag, i, dt):
    """With effects: what has built up of the lateral force `F_t` (N) of wheel `i` at the end of `dt` (0 for now), N.

    `lag` holds the forces of eight wheels that lag behind, then their rates, which are written (N/s).
    """
    rate = hooks.follow_rate(fx, p_x)
    if rate > 0.0:
        lag[8 + i] = rate * (F_t - lag[i]) / (1.0 + dt * rate)
        return lag[i] + dt * lag[8 + i]
    return F_t


@inlined
def motor_wheels(body, fx, unit, pair, soil, omega, motor, lag, dt, w):
    """Eqs 15 and 16 for the front and the back wheel of a motor, which turn at `omega` (rad/s), into the row.

    Returns
    -------
    tuple of 3 floats
        Sum of both F_l; F_t in front; F_t behind (N).
    """
    i = 2 * motor
    slip = unit.r_w * omega - pair.p_x
    F_l = soil.k_l * slip
    F_tf, F_tb = -soil.k_t * pair.p_yf, -soil.k_t * pair.p_yb
    if fx is not None:
        F_tf, F_tb = relaxed(fx, F_tf, pair.p_x, lag, i, dt), relaxed(fx, F_tb, pair.p_x, lag, i + 1, dt)
    F_lf, F_tf, held_f = saturated(body, fx, F_l, F_tf, pair.F_nf, soil.mu_sf, soil.mu_df, slip, pair.p_yf)
    F_lb, F_tb, held_b = saturated(body, fx, F_l, F_tb, pair.F_nb, soil.mu_sb, soil.mu_db, slip, pair.p_yb)
    if fx is not None:
        F_tf += hooks.lateral(fx, pair.p_yf)
        F_tb += hooks.lateral(fx, pair.p_yb)
    w[F_L + i], w[F_T + i], w[SAT + i] = F_lf, F_tf, 1.0 if held_f != 1.0 else 0.0
    w[F_L + i + 1], w[F_T + i + 1], w[SAT + i + 1] = F_lb, F_tb, 1.0 if held_b != 1.0 else 0.0
    return F_lf + F_lb, F_tf, F_tb


@inlined
def resistance(body, fx, module, forward, pair_r, pair_l, soil_r, soil_l, c_a):
    """With effects: what the ground does to a module beside eq. 16, and its wheels do not feel.

    The module's origin moves forward at `forward` (m/s).

    Returns
    -------
    tuple of 3 floats
        Force along and across the module, N, and yaw moment, N m.
    """
    rf_x, rf_y = hooks.wheel_resist(fx, soil_r.mu_sf * pair_r.F_nf, pair_r.p_x, pair_r.p_yf)
    rb_x, rb_y = hooks.wheel_resist(fx, soil_r.mu_sb * pair_r.F_nb, pair_r.p_x, pair_r.p_yb)
    lf_x, lf_y = hooks.wheel_resist(fx, soil_l.mu_sf * pair_l.F_nf, pair_l.p_x, pair_l.p_yf)
    lb_x, lb_y = hooks.wheel_resist(fx, soil_l.mu_sb * pair_l.F_nb, pair_l.p_x, pair_l.p_yb)
    right, left, front, back = rf_x + rb_x, lf_x + lb_x, rf_y + lf_y, rb_y + lb_y
    turn = body.half_x * (front - back) + body.half_y * c_a * (right - left)
    return (right + left) - hooks.resist(fx, module, forward), front + back, turn


@inlined
def generalised_forces(body, p, fx, s_a, c_a, s_g, c_g, right, left, pair_r, pair_l, soil_r, soil_l, module, w):
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
    across_f = c_a * (right[1] + left[1]) - s_a * (pair_r.F_nf + pair_l.F_nf)
    across_b = c_a * (right[2] + left[2]) - s_a * (pair_r.F_nb + pair_l.F_nb)
    F_n_right, F_n_left = pair_r.F_nf + pair_r.F_nb, pair_l.F_nf + pair_l.F_nb
    f_x, f_y = right[0] + left[0], across_f + across_b
    m_g = (body.half_x + p.u_w) * across_f - (body.half_x - p.u_w) * across_b + body.half_y * c_a * (right[0] - left[0])
    if fx is not None:
        m_g += (soil_r.u_f - p.u_w) * (c_a * right[1] - s_a * pair_r.F_nf)
        m_g += (soil_r.u_b - p.u_w) * (c_a * right[2] - s_a * pair_r.F_nb)
        m_g += (soil_l.u_f - p.u_w) * (c_a * left[1] - s_a * pair_l.F_nf)
        m_g += (soil_l.u_b - p.u_w) * (c_a * left[2] - s_a * pair_l.F_nb)
    x, y = c_g * f_x - s_g * f_y, s_g * f_x + c_g * f_y
    z = s_a * (right[1] + left[1] + right[2] + left[2]) + c_a * (F_n_right + F_n_left)
    m_a = body.half_y * (F_n_left - F_n_right)
    o = Q_C + 6 * module
    w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 5] = x, y, z, m_a, 0.0, m_g
    return x, y, z, m_a, m_g
