"""The model on a plane: eqs 13 to 20 and 25 for a rover that stands level.

Without roll, pitch and heave each wheel keeps its static load, and of the joint's four rows only x and y are left,
with a 2×2 Schur complement. Nothing is approximated: from a level start the sixteen coordinates of `dynamics` stay
level by themselves (`plane_step.level` says which starts are), and both forms agree to rounding, step by step. Both
modules keep coordinates of their own, since a step that only knew one of them would have other errors.

Values pass as tuples. Nothing here branches, so that loops over many rovers (`lanes`) become vector code; only eq. 16
is a function that is handed in, `within_friction` there, and for one rover alone (`level_step`) `contact.saturated`,
which takes roots of those wheels only that slide. `fx` is as in `contact`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations.contact import Pair, resistance, soil_under
from artibot_sim.model.equations.dynamics import mass_centre
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import inverse_root
from artibot_sim.model.kernels.layout import BEHIND, FRONT


class Body(NamedTuple):
    """One module: inverse mass and yaw inertia, half spacings, joint, soil (see `params.ModuleParams`), wheel loads.

    F_rf, F_rb, F_lf, F_lb are the loads of the wheels right and left, in front and behind, N.
    """

    inv_m: float
    inv_J: float
    half_x: float
    half_y: float
    O_x: float
    k_l: float
    k_t: float
    mu_s: float
    mu_d: float
    F_rf: float
    F_rb: float
    F_lf: float
    F_lb: float


class Ground(NamedTuple):
    """What both modules share: u_w (m), gravity's pull along x and y of `map` (m/s²), A of the joint (1/s).

    joined is 1, or 0 for a rigid robot, whose back module is not there.
    """

    u_w: float
    g_x: float
    g_y: float
    A: float
    joined: float


class Motion(NamedTuple):
    """A module's pose in `map` (m, rad) and its rates."""

    x: float
    y: float
    gamma: float
    x_dot: float
    y_dot: float
    gamma_dot: float


class Pull(NamedTuple):
    """What the wheels of one side do: sums of F_l and of u F_n of both (N, N m), F_t in front and behind (N).

    u_f, u_b (m) are how far ahead of the wheels the forces act; rate_f, rate_b (N/s) how fast forces that lag build up.
    F_lf, F_lb (N) are the single wheels', held_f, held_b what eq. 16 has left of their forces, 1 where they hold.
    """

    F_l: float
    u_F_n: float
    F_tf: float
    F_tb: float
    u_f: float
    u_b: float
    rate_f: float
    rate_b: float
    F_lf: float
    F_lb: float
    held_f: float
    held_b: float


@inlined
def within_friction(body, fx, F_l, F_t, F_n, mu_s, mu_d, slip_l, slip_t):
    """Eq. 16 as `contact.saturated`, without a branch."""
    F_h2 = F_l * F_l + (F_t * F_t + 1e-30)  # so that there is a root to divide by
    limit = mu_s * F_n
    slides = F_h2 > limit * limit
    if fx is not None:
        mu_d = hooks.friction(fx, mu_s, mu_d, math.sqrt(slip_l * slip_l + slip_t * slip_t))
    held = mu_d * F_n * inverse_root(F_h2)
    held = held if slides else 1.0
    return F_l * held, F_t * held, held


@inlined
def lagging(fx, F_t, p_x, lag):
    """With effects: what has built up of a lateral force (N), and the rate at which it does (N/s)."""
    rate = hooks.follow_rate(fx, p_x)
    behind = rate > 0.0
    return (lag if behind else F_t), (rate * (F_t - lag) if behind else 0.0)


@inlined
def pull_of(limited, body, fx, pair, soil, r_omega, lag_f, lag_b):
    """Eqs 15 and 16 for the wheels of one side, which turn at `r_omega` (m/s at their rims)."""
    slip = r_omega - pair.p_x
    F_l = soil.k_l * slip
    F_tf, F_tb = -soil.k_t * pair.p_yf, -soil.k_t * pair.p_yb
    rate_f = rate_b = 0.0
    if fx is not None:
        F_tf, rate_f = lagging(fx, F_tf, pair.p_x, lag_f)
        F_tb, rate_b = lagging(fx, F_tb, pair.p_x, lag_b)
    F_lf, F_tf, held_f = limited(body, fx, F_l, F_tf, pair.F_nf, soil.mu_sf, soil.mu_df, slip, pair.p_yf)
    F_lb, F_tb, held_b = limited(body, fx, F_l, F_tb, pair.F_nb, soil.mu_sb, soil.mu_db, slip, pair.p_yb)
    if fx is not None:
        F_tf += hooks.lateral(fx, pair.p_yf)
        F_tb += hooks.lateral(fx, pair.p_yb)
    u_F_n = soil.u_f * pair.F_nf + soil.u_b * pair.F_nb
    return Pull(
        F_lf + F_lb, u_F_n, F_tf, F_tb, soil.u_f, soil.u_b, rate_f, rate_b, F_lf, F_lb, held_f, held_b
    )  # fmt: skip


@inlined
def module_pairs(body, ground, fx, at, s_g, c_g):
    """What the wheels right and left meet (Pair), and the soil under them (Soil)."""
    v_x, v_y = c_g * at.x_dot + s_g * at.y_dot, c_g * at.y_dot - s_g * at.x_dot
    turn, sweep = at.gamma_dot * body.half_y, at.gamma_dot * body.half_x
    pair_r = Pair(v_x + turn, v_y + sweep, v_y - sweep, body.F_rf, body.F_rb)
    pair_l = Pair(v_x - turn, v_y + sweep, v_y - sweep, body.F_lf, body.F_lb)
    soil_r = soil_under(body, ground, fx, pair_r, at.x, at.y, s_g, c_g, 1.0, -1.0)
    soil_l = soil_under(body, ground, fx, pair_l, at.x, at.y, s_g, c_g, 1.0, 1.0)
    return pair_r, pair_l, soil_r, soil_l


@inlined
def module_forces(limited, body, ground, fx, module, at, s_g, c_g, rims, lags, sluggish):
    """Free accelerations of x, y, gamma (the centre of mass's, with effects), and what the wheels do.

    Parameters
    ----------
    limited : function
        Eq. 16: `within_friction` or `contact.saturated`.
    at : Motion
    s_g, c_g : float
        Sine and cosine of its gamma.
    rims : tuple of 2 floats
        Speeds of the rims right and left, m/s.
    lags : tuple of 4 floats
        With effects: lateral forces that lag (N), in the order of WHEELS.
    sluggish : float or None
        Mass that a semi-implicit step adds against changes of the velocity (`dynamics.free_acceleration`), kg.

    Returns
    -------
    tuple
        Accelerations; `Pull` of the wheels right and left; forces on x, y and gamma.
    """
    pair_r, pair_l, soil_r, soil_l = module_pairs(body, ground, fx, at, s_g, c_g)
    right = pull_of(limited, body, fx, pair_r, soil_r, rims[0], lags[0], lags[1])
    left = pull_of(limited, body, fx, pair_l, soil_l, rims[1], lags[2], lags[3])
    across_f, across_b = right.F_tf + left.F_tf, right.F_tb + left.F_tb
    f_x, f_y = right.F_l + left.F_l, across_f + across_b
    u = ground.u_w
    turning = (body.half_x + u) * across_f - (body.half_x - u) * across_b + body.half_y * (right.F_l - left.F_l)
    if fx is not None:
        turning += (right.u_f - u) * right.F_tf + (right.u_b - u) * right.F_tb
        turning += (left.u_f - u) * left.F_tf + (left.u_b - u) * left.F_tb
    x, y = c_g * f_x - s_g * f_y, s_g * f_x + c_g * f_y
    forces = x, y, turning
    if fx is not None:
        push_x, push_y = hooks.push(fx, module)
        surge, sway, turn = hooks.load(fx, module)
        forward = c_g * at.x_dot + s_g * at.y_dot
        along, across, turned = resistance(body, fx, module, forward, pair_r, pair_l, soil_r, soil_l, 1.0)
        surge, sway, turn = surge + along, sway + across, turn + turned
        x, y = x + (push_x + (c_g * surge - s_g * sway)), y + (push_y + (s_g * surge + c_g * sway))
        turning += turn
        r_x, r_y = mass_centre(fx, module, s_g, c_g)
        turning -= r_x * y - r_y * x
    if sluggish is not None:
        x -= sluggish * (ground.g_x + at.gamma_dot * at.y_dot)
        y -= sluggish * (ground.g_y - at.gamma_dot * at.x_dot)
    free = ground.g_x + body.inv_m * x, ground.g_y + body.inv_m * y, body.inv_J * turning
    return free, right, left, forces


@inlined
def joint_end(body, fx, module, at, s_g, c_g, A):
    """The joint as seen from one module (eq. 13, without its origin's motion): value, velocity terms, column of gamma.

    The velocity terms hold those of the stabilisation that a centre of mass off the origin brings.
    """
    r_x, r_y = c_g * body.O_x, s_g * body.O_x
    rate2 = at.gamma_dot * at.gamma_dot
    bias_x, bias_y, column_x, column_y = -rate2 * r_x, -rate2 * r_y, -r_y, r_x
    if fx is not None:
        o_x, o_y = mass_centre(fx, module, s_g, c_g)
        damping = 2.0 * A * at.gamma_dot
        bias_x, bias_y = bias_x + rate2 * o_x - damping * o_y, bias_y + rate2 * o_y + damping * o_x
        column_x, column_y = column_x + o_y, column_y - o_x
    return r_x, r_y, bias_x, bias_y, column_x, column_y


@inlined
def from_origin(fx, module, at, s_g, c_g, a):
    """With effects: accelerations of a module's origin from those of its centre of mass."""
    r_x, r_y = mass_centre(fx, module, s_g, c_g)
    rate2 = at.gamma_dot * at.gamma_dot
    return a[0] + a[2] * r_y + rate2 * r_x, a[1] + rate2 * r_y - a[2] * r_x, a[2]


@inlined
def planar_accelerations(limited, front, back, ground, fx, f, b, trig, rims, lags_f, lags_b, sluggish=(None, None)):
    """Eq. 25 on the plane.

    Parameters
    ----------
    limited : function
        Eq. 16, see `module_forces`.
    front, back : Body
    f, b : Motion
        Of both modules.
    trig : tuple of 4 floats
        Sine and cosine of yaw, of the front module and of the back one.
    rims : tuple of 4 floats
        Speeds of the wheels' rims, m/s, in the order of MOTORS.
    lags_f, lags_b : tuple of 4 floats
        With effects: lateral forces that lag, N.
    sluggish : tuple of 2 floats or Nones
        See `module_forces`.

    Returns
    -------
    on_f, on_b : tuple of 3 floats
        Accelerations of x, y and gamma of both modules.
    pulls : tuple of 4 Pull
        In the order of MOTORS.
    contacts : tuple of 2 tuples of 3 floats
        Forces of the wheels on x, y and gamma of both modules.
    joint : tuple of 4 floats
        Multipliers of the joint's rows x and y, and its torques on the front module and the back one.
    """
    s_f, c_f, s_b, c_b = trig
    (fx_a, fy_a, fg_a), front_right, front_left, contact_f = module_forces(
        limited, front, ground, fx, FRONT, f, s_f, c_f, (rims[0], rims[1]), lags_f, sluggish[0]
    )
    there = Ground(ground.u_w, ground.joined * ground.g_x, ground.joined * ground.g_y, ground.A, ground.joined)
    (bx_a, by_a, bg_a), back_right, back_left, contact_b = module_forces(
        limited, back, there, fx, BEHIND, b, s_b, c_b, (rims[2], rims[3]), lags_b, sluggish[1]
    )
    if fx is not None:
        torque = ground.joined * hooks.joint(fx, b.gamma - f.gamma, b.gamma_dot - f.gamma_dot)
        fg_a, bg_a = fg_a + front.inv_J * torque, bg_a - back.inv_J * torque
    A = ground.A
    rf_x, rf_y, biasf_x, biasf_y, gf_x, gf_y = joint_end(front, fx, FRONT, f, s_f, c_f, A)
    rb_x, rb_y, biasb_x, biasb_y, gb_x, gb_y = joint_end(back, fx, BEHIND, b, s_b, c_b, A)
    gap_x, gap_y = f.x + rf_x - b.x - rb_x, f.y + rf_y - b.y - rb_y
    # the joint's rows with what they would do without a force in it (`dynamics.multipliers`)
    turn_f, turn_b = fg_a + 2.0 * A * f.gamma_dot, bg_a + 2.0 * A * b.gamma_dot
    held_x, held_y = biasf_x - biasb_x + A * A * gap_x, biasf_y - biasb_y + A * A * gap_y
    row_x = (held_x + fx_a - bx_a + 2.0 * A * (f.x_dot - b.x_dot)) + (gf_x * turn_f - gb_x * turn_b)
    row_y = (held_y + fy_a - by_a + 2.0 * A * (f.y_dot - b.y_dot)) + (gf_y * turn_f - gb_y * turn_b)
    m = front.inv_m + back.inv_m
    Gf_x, Gf_y, Gb_x, Gb_y = front.inv_J * gf_x, front.inv_J * gf_y, back.inv_J * gb_x, back.inv_J * gb_y
    s_xx, s_xy, s_yy = m + Gf_x * gf_x + Gb_x * gb_x, Gf_x * gf_y + Gb_x * gb_y, m + Gf_y * gf_y + Gb_y * gb_y
    scale = ground.joined / (s_xx * s_yy - s_xy * s_xy)
    l_x, l_y = scale * (s_yy * row_x - s_xy * row_y), scale * (s_xx * row_y - s_xy * row_x)
    joint = l_x, l_y, -(gf_x * l_x + gf_y * l_y), gb_x * l_x + gb_y * l_y
    on_f = fx_a - front.inv_m * l_x, fy_a - front.inv_m * l_y, fg_a - (Gf_x * l_x + Gf_y * l_y)
    on_b = bx_a + back.inv_m * l_x, by_a + back.inv_m * l_y, bg_a + (Gb_x * l_x + Gb_y * l_y)
    if fx is not None:
        on_f = from_origin(fx, FRONT, f, s_f, c_f, on_f)
        on_b = from_origin(fx, BEHIND, b, s_b, c_b, on_b)
    return on_f, on_b, (front_right, front_left, back_right, back_left), (contact_f, contact_b), joint
