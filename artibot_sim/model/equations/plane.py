"""The model on a plane: eqs 13 to 20 and 25 for a rover that stands level.

Without roll, pitch and heave each wheel keeps its static load, and of the joint's four rows only x and y are left,
with a 2×2 Schur complement. Nothing is approximated: from a level start the sixteen coordinates of `dynamics` stay
level by themselves (`plane_step.level` says which starts are), and both forms agree to rounding, step by step. Both
modules keep coordinates of their own, since a step that only knew one of them would have other errors.

Values pass as tuples. Nothing here branches, so that loops over many rovers (`kernels.lanes`) become vector code; only
eq. 16 is a function that is handed in: `contact.within_friction_lanes` there, `contact.within_friction` for one alone.
`fx` is as in `contact`.
"""

from __future__ import annotations

from typing import NamedTuple

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations.contact import WheelPair, load_transfer, soil_under
from artibot_sim.model.equations.dynamics import joint_torque, mass_centre, module_loads, stopped
from artibot_sim.model.kernels.compilation import inlined
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


class CommonTerms(NamedTuple):
    """What both modules share: u_w (m), gravity's pull along x and y of `map` (m/s²), A of the joint (1/s).

    load is the mean load of the rover's wheels (N). joined is 1, or 0 for a rigid robot, whose back module is not
    there. pitching is 1 where pitch reaches the wheels, else 0.
    """

    u_w: float
    g_x: float
    g_y: float
    A: float
    joined: float
    load: float
    pitching: float


class Motion(NamedTuple):
    """A module's pose in `map` (m, rad) and its rates."""

    x: float
    y: float
    gamma: float
    x_dot: float
    y_dot: float
    gamma_dot: float


@inlined
def module_pairs(body, ground, fx, at, s_g, c_g):
    """What the wheels right and left meet (WheelPair), and the soil under them (Soil)."""
    v_x, v_y = c_g * at.x_dot + s_g * at.y_dot, c_g * at.y_dot - s_g * at.x_dot
    turn, sweep = at.gamma_dot * body.half_y, at.gamma_dot * body.half_x
    right, left, front, back = v_x + turn, v_x - turn, v_y + sweep, v_y - sweep
    pair_r = WheelPair(right, right, front, back, body.F_rf, body.F_rb, body.F_rf, body.F_rb)
    pair_l = WheelPair(left, left, front, back, body.F_lf, body.F_lb, body.F_lf, body.F_lb)
    soil_r = soil_under(body, ground, fx, pair_r, at.x, at.y, s_g, c_g, 1.0, -1.0)
    soil_l = soil_under(body, ground, fx, pair_l, at.x, at.y, s_g, c_g, 1.0, 1.0)
    return pair_r, pair_l, soil_r, soil_l


@inlined
def module_wheels(forces, body, ground, fx, module, at, s_g, c_g, rims, angles, lags):
    """What a module's wheels do at an instant (`contact.PairForces`), right and left.

    Parameters
    ----------
    forces : function
        `contact.pair_forces` at an instant with an eq. 16 that is fit for the loop.
    at : Motion
    s_g, c_g : float
        Sine and cosine of its gamma.
    rims, angles : tuple of 2 floats
        Speeds of the rims right and left, m/s, and the wheels' angles, rad.
    lags : tuple of 4 tuples of 3 floats
        With effects: what the wheels remember (see `contact.pair_forces`), in the order of WHEELS.
    """
    pair_r, pair_l, soil_r, soil_l = module_pairs(body, ground, fx, at, s_g, c_g)
    motor = 2 * module
    if fx is not None and hooks.height(fx) > 0.0:
        pair_r, pair_l = load_transfer(
            forces, body, fx, ground.pitching, (pair_r, pair_l), (soil_r, soil_l), motor, rims, angles, lags
        )  # fmt: skip
    return (
        forces(body, fx, pair_r, soil_r, motor, rims[0], angles[0], lags[0], lags[1]),
        forces(body, fx, pair_l, soil_l, motor + 1, rims[1], angles[1], lags[2], lags[3]),
    )


@inlined
def module_forces(body, ground, fx, module, at, s_g, c_g, right, left):
    """Free accelerations of x, y, gamma (the centre of mass's, with effects), and what brings them about.

    Parameters
    ----------
    right, left : contact.PairForces

    Returns
    -------
    tuple
        Accelerations; the wheels' forces on x, y and gamma; what `dynamics.module_loads` gives.
    """
    across_f, across_b = right.F_tf + left.F_tf, right.F_tb + left.F_tb
    f_x, f_y = right.F_l + left.F_l, across_f + across_b
    u = ground.u_w
    turning = (body.half_x + u) * across_f - (body.half_x - u) * across_b + body.half_y * (right.F_l - left.F_l)
    if fx is not None:
        turning += (right.u_f - u) * right.F_tf + (right.u_b - u) * right.F_tb
        turning += (left.u_f - u) * left.F_tf + (left.u_b - u) * left.F_tb
    x, y = c_g * f_x - s_g * f_y, s_g * f_x + c_g * f_y
    contact, loads = (x, y, turning), (0.0, 0.0, 0.0, 0.0, 0.0)
    if fx is not None:
        loads = module_loads(body, fx, module, c_g * at.x_dot + s_g * at.y_dot, right, left, s_g, c_g, 1.0)
        push_x, push_y, load_x, load_y, turn = loads
        x, y, turning = x + (push_x + load_x), y + (push_y + load_y), turning + turn
        r_x, r_y = mass_centre(fx, module, s_g, c_g)
        turning -= r_x * y - r_y * x
    free = ground.g_x + body.inv_m * x, ground.g_y + body.inv_m * y, body.inv_J * turning
    return free, contact, loads


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
def rigid_accelerations(body, ground, fx, at, s_g, c_g, right, left):
    """What `planar_accelerations` gives of the front module of a rigid robot, which has no other."""
    free, _, _ = module_forces(body, ground, fx, FRONT, at, s_g, c_g, right, left)
    return free if fx is None else from_origin(fx, FRONT, at, s_g, c_g, free)


@inlined
def planar_accelerations(front, back, ground, fx, f, b, trig, forces, dt=None):
    """Eq. 25 on the plane.

    Parameters
    ----------
    front, back : Body
    f, b : Motion
        Of both modules.
    trig : tuple of 4 floats
        Sine and cosine of yaw, of the front module and of the back one.
    forces : tuple of 4 contact.PairForces
        Of the wheels, in the order of MOTORS.
    dt : float, optional
        A semi-implicit step over which friction in the joint is taken at its end, s (see `dynamics.turned_by_joint`).

    Returns
    -------
    on_f, on_b : tuple of 3 floats
        Accelerations of x, y and gamma of both modules.
    contacts : tuple of 2 tuples of 3 floats
        Forces of the wheels on x, y and gamma of both modules.
    joint : tuple of 5 floats
        Multipliers of the joint's rows x and y, its torques on the front module and the back one, and the effects'.
    loads : tuple of 2 tuples of 5 floats
        What `dynamics.module_loads` gives of both modules.
    """
    s_f, c_f, s_b, c_b = trig
    (fx_a, fy_a, fg_a), contact_f, load_f = module_forces(front, ground, fx, FRONT, f, s_f, c_f, forces[0], forces[1])
    there = CommonTerms(
        ground.u_w, ground.joined * ground.g_x, ground.joined * ground.g_y, ground.A, ground.joined, ground.load,
        ground.pitching,
    )  # fmt: skip
    (bx_a, by_a, bg_a), contact_b, load_b = module_forces(back, there, fx, BEHIND, b, s_b, c_b, forces[2], forces[3])
    A = ground.A
    rf_x, rf_y, biasf_x, biasf_y, gf_x, gf_y = joint_end(front, fx, FRONT, f, s_f, c_f, A)
    rb_x, rb_y, biasb_x, biasb_y, gb_x, gb_y = joint_end(back, fx, BEHIND, b, s_b, c_b, A)
    gap_x, gap_y = f.x + rf_x - b.x - rb_x, f.y + rf_y - b.y - rb_y
    m = front.inv_m + back.inv_m
    Gf_x, Gf_y, Gb_x, Gb_y = front.inv_J * gf_x, front.inv_J * gf_y, back.inv_J * gb_x, back.inv_J * gb_y
    s_xx, s_xy, s_yy = m + Gf_x * gf_x + Gb_x * gb_x, Gf_x * gf_y + Gb_x * gb_y, m + Gf_y * gf_y + Gb_y * gb_y
    scale = ground.joined / (s_xx * s_yy - s_xy * s_xy)
    # the joint's rows with what they would do without a force in it (`dynamics.multipliers`)
    held_x, held_y = biasf_x - biasb_x + A * A * gap_x, biasf_y - biasb_y + A * A * gap_y
    row_x = held_x + fx_a - bx_a + 2.0 * A * (f.x_dot - b.x_dot)
    row_y = held_y + fy_a - by_a + 2.0 * A * (f.y_dot - b.y_dot)
    torque = 0.0
    if fx is not None:
        torque, slope = joint_torque(fx, b.gamma - f.gamma, b.gamma_dot - f.gamma_dot, dt)
        torque *= ground.joined
        if dt is not None:
            # the secant times what the joint's yaw does with this torque, and what 1 N m less would make of that
            a_f, a_b = fg_a + front.inv_J * torque, bg_a - back.inv_J * torque
            t_f, t_b = a_f + 2.0 * A * f.gamma_dot, a_b + 2.0 * A * b.gamma_dot
            r_x, r_y = row_x + (gf_x * t_f - gb_x * t_b), row_y + (gf_y * t_f - gb_y * t_b)
            l_x, l_y = scale * (s_yy * r_x - s_xy * r_y), scale * (s_xx * r_y - s_xy * r_x)
            alone = a_b + (Gb_x * l_x + Gb_y * l_y) - (a_f - (Gf_x * l_x + Gf_y * l_y))
            r_x, r_y = Gf_x + Gb_x, Gf_y + Gb_y
            l_x, l_y = scale * (s_yy * r_x - s_xy * r_y), scale * (s_xx * r_y - s_xy * r_x)
            compliance = front.inv_J + back.inv_J - ((Gf_x + Gb_x) * l_x + (Gf_y + Gb_y) * l_y)
            torque = stopped(torque, ground.joined * slope, alone, compliance)
        fg_a, bg_a = fg_a + front.inv_J * torque, bg_a - back.inv_J * torque
    turn_f, turn_b = fg_a + 2.0 * A * f.gamma_dot, bg_a + 2.0 * A * b.gamma_dot
    row_x, row_y = row_x + (gf_x * turn_f - gb_x * turn_b), row_y + (gf_y * turn_f - gb_y * turn_b)
    l_x, l_y = scale * (s_yy * row_x - s_xy * row_y), scale * (s_xx * row_y - s_xy * row_x)
    joint = l_x, l_y, -(gf_x * l_x + gf_y * l_y), gb_x * l_x + gb_y * l_y, torque
    on_f = fx_a - front.inv_m * l_x, fy_a - front.inv_m * l_y, fg_a - (Gf_x * l_x + Gf_y * l_y)
    on_b = bx_a + back.inv_m * l_x, by_a + back.inv_m * l_y, bg_a + (Gb_x * l_x + Gb_y * l_y)
    if fx is not None:
        on_f = from_origin(fx, FRONT, f, s_f, c_f, on_f)
        on_b = from_origin(fx, BEHIND, b, s_b, c_b, on_b)
    return on_f, on_b, (contact_f, contact_b), joint, (load_f, load_b)
