"""One rover on a plane: which rovers stay level, the right-hand side, both steps, the row of contributions."""

from __future__ import annotations

from typing import NamedTuple

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations.contact import normal_force, saturated
from artibot_sim.model.equations.plane import Body, Ground, Motion, module_pairs, planar_accelerations
from artibot_sim.model.equations.transmission import PRESCRIBED, axle_torque, follow, motor_equation
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import sincos, turn_by
from artibot_sim.model.kernels.integrators import D_DDOT, D_DOT, EFFICIENCY, GEAR, INERTIA, TORQUE_D, D, next_speed
from artibot_sim.model.kernels.layout import (
    ACC,
    ALPHA,
    BACK,
    BEHIND,
    BETA,
    ETA,
    F_L,
    F_N,
    F_T,
    FRONT,
    GAMMA,
    LAMBDA,
    M_M,
    M_R,
    MOTOR,
    MOTOR_COORDINATES,
    P_X,
    P_Y,
    Q_C,
    Q_J,
    SAT,
    X,
    Y,
    Z,
)

# ----------------------------------------------------------------------
# Which rovers stand level, and what of a module matters on a plane (`planar`).
# ----------------------------------------------------------------------


_STILL = 1e-12
"""m, rad and per second, within which a rover stands level and still: what rounding leaves."""

_BALANCED = 1e-9
"""Vertical and roll accelerations (m/s², rad/s²) that move nobody from there."""


@inlined
def static_loads(body, p, fx, module, z):
    """Normal forces (N) of a level module's wheels: right in front and behind, left in front and behind."""
    return (
        normal_force(body, p, fx, module, 1.0, -1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, -1.0, -1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, z),
        normal_force(body, p, fx, module, -1.0, 1.0, 0.0, 0.0, 0.0, 1.0, z),
    )


@inlined
def module_level(body, p, fx, module, q, v):
    """Whether a module stands level, and its wheels carry it so."""
    b = BACK * module
    for c in (Z, ALPHA, BETA):
        if abs(v[b + c]) > _STILL or (c != Z and abs(q[b + c]) > _STILL):
            return False
    right_f, right_b, left_f, left_b = static_loads(body, p, fx, module, q[b + Z])
    left = 0.0
    if fx is not None:
        _, left = hooks.centre(fx, module)
    rising = p.g_z + body.inverse[2] * ((right_f + right_b) + (left_f + left_b))
    rolling = body.inverse[3] * (body.half_y * ((left_f + left_b) - (right_f + right_b)) + body.m * p.g_z * left)
    return abs(rising) < _BALANCED and abs(rolling) < _BALANCED


@inlined
def level(p, fx, q, v):
    """Whether a rover at q and v (16,) moves on a plane only."""
    if not module_level(p.front, p, fx, FRONT, q, v):
        return False
    if not p.two:
        return True
    coplanar = p.front.O_z == 0.0 and p.back.O_z == 0.0 and abs(q[Z] - q[BACK + Z]) < _STILL
    return coplanar and module_level(p.back, p, fx, BEHIND, q, v)


@inlined
def standing(body, p, fx, module, z):
    """A level module's numbers (`planar.Body`), its origin at height `z` (m)."""
    F_rf, F_rb, F_lf, F_lb = static_loads(body, p, fx, module, z)
    return Body(
        body.inverse[0], body.inverse[5], body.half_x, body.half_y, body.O_x, body.k_l, body.k_t, body.mu_s, body.mu_d,
        F_rf, F_rb, F_lf, F_lb,
    )  # fmt: skip


# ----------------------------------------------------------------------
# What a rover on a plane writes down of an instant: the row of `layout.COLUMNS`, as in space.
# ----------------------------------------------------------------------


PLACES = (X, Y, GAMMA, BACK + X, BACK + Y, BACK + GAMMA, *MOTOR_COORDINATES)
"""Where the coordinates that move on a plane stand in q."""


@inlined
def unload(values, two, out):
    """Coordinates, rates or accelerations that move on a plane (10) into `out` (16,)."""
    out[0], out[1], out[5], out[6], out[7] = values[0], values[1], values[2], values[6], values[7]
    if two:
        out[8], out[9], out[13], out[14], out[15] = values[3], values[4], values[5], values[8], values[9]


@inlined
def pair_row(pair, pull, i, w):
    """What two wheels meet and do; `i` is the front one's number."""
    w[P_X + i] = w[P_X + i + 1] = pair.p_x
    w[P_Y + i], w[P_Y + i + 1] = pair.p_yf, pair.p_yb
    w[F_N + i], w[F_N + i + 1] = pair.F_nf, pair.F_nb
    w[F_L + i], w[F_L + i + 1], w[F_T + i], w[F_T + i + 1] = pull.F_lf, pull.F_lb, pull.F_tf, pull.F_tb
    w[SAT + i] = 1.0 if pull.held_f != 1.0 else 0.0
    w[SAT + i + 1] = 1.0 if pull.held_b != 1.0 else 0.0


@inlined
def module_row(body, ground, at, s_g, c_g, module, right, left, contact, l_x, l_y, turn, w):
    """Wheels, contact forces and the joint's force (l_x, l_y N, turn N m) of one module."""
    pair_r, pair_l, _, _ = module_pairs(body, ground, None, at, s_g, c_g)
    pair_row(pair_r, right, 4 * module, w)
    pair_row(pair_l, left, 4 * module + 2, w)
    c, j = Q_C + 6 * module, Q_J + 6 * module
    w[c], w[c + 1], w[c + 5] = contact
    on_right, on_left = body.F_rf + body.F_rb, body.F_lf + body.F_lb
    w[c + Z], w[c + 3] = on_right + on_left, body.half_y * (on_left - on_right)
    w[j], w[j + 1], w[j + 5] = l_x, l_y, turn


@inlined
def write_row(at, two, motions, trig, a, acting, M_m, M_r, hold, w):
    """All of an instant but gravity, which never changes, into `w` (ROW,).

    Parameters
    ----------
    motions : tuple of 2 Motion
    trig : tuple of 4 floats
        Sine and cosine of yaw, front and back.
    a : tuple of 10 floats
        Accelerations.
    acting : tuple
        See `plane_step.level_accelerations`.
    M_m, M_r : tuple of 4 floats
        Torques, N m.
    """
    pulls, contacts, joint = acting
    l_x, l_y, turn_f, turn_b = joint
    unload(a, two, w[ACC : ACC + 16])
    w[M_M], w[M_M + 1], w[M_R], w[M_R + 1] = M_m[0], M_m[1], M_r[0], M_r[1]
    w[ETA], w[ETA + 1] = hold[EFFICIENCY], hold[EFFICIENCY + 1]
    module_row(
        at.front, at.ground, motions[0], trig[0], trig[1], FRONT, pulls[0], pulls[1], contacts[0], -l_x, -l_y, turn_f, w
    )
    if two:
        w[LAMBDA], w[LAMBDA + 1] = l_x, l_y
        w[M_M + 2], w[M_M + 3], w[M_R + 2], w[M_R + 3] = M_m[2], M_m[3], M_r[2], M_r[3]
        w[ETA + 2], w[ETA + 3] = hold[EFFICIENCY + 2], hold[EFFICIENCY + 3]
        module_row(
            at.back, at.ground, motions[1], trig[2], trig[3], BEHIND, pulls[2], pulls[3], contacts[1], l_x, l_y, turn_b,
            w,
        )  # fmt: skip


# ----------------------------------------------------------------------
# One rover on a plane, alone: the right-hand side, and the two ways to step it, as `integrators` has them in
# space.
#
# Coordinates that move and their rates are tuples of ten numbers, which stay in registers: x, y, gamma of the front
# module, of the back one, and the motors' angles. Nothing is stored on the way; `level_row` writes down what is
# kept.
# ----------------------------------------------------------------------


NO_LAG = (0.0, 0.0, 0.0, 0.0)


class Standing(NamedTuple):
    """A rover's modules and what they stand on (see `planar`)."""

    front: Body
    back: Body
    ground: Ground


@inlined
def stand(p, q):
    """A level rover at q (16,)."""
    ground = Ground(p.u_w, p.g_x, p.g_y, p.A_joint, 1.0 if p.two else 0.0)
    return Standing(
        standing(p.front, p, None, FRONT, q[Z]), standing(p.back, p, None, BEHIND, q[BACK + Z]), ground
    )  # fmt: skip


@inlined
def motions(q, v):
    """Both modules' motions from tuples of coordinates and rates."""
    return Motion(q[0], q[1], q[2], v[0], v[1], v[2]), Motion(q[3], q[4], q[5], v[3], v[4], v[5])


@inlined
def heading(q):
    """Sine and cosine of yaw, of the front module and the back one."""
    s_f, c_f = sincos(q[2])
    s_b, c_b = sincos(q[5])
    return s_f, c_f, s_b, c_b


@inlined
def turned(trig, begun, q):
    """As `heading` at `q`, from what it was at `begun`: within a step a module turns by little."""
    s_f, c_f = turn_by(q[2] - begun[2], trig[0], trig[1])
    s_b, c_b = turn_by(q[5] - begun[5], trig[2], trig[3])
    return s_f, c_f, s_b, c_b


@inlined
def near(begun, q):
    """Whether no module has turned by more than `turn_by` knows."""
    return abs(q[2] - begun[2]) < 0.02 and abs(q[5] - begun[5]) < 0.02


@inlined
def rims_of(p, right, left, right_b, left_b):
    """Speeds of the wheels' rims (m/s) at motor speeds (rad/s), in the order of MOTORS."""
    a, b, c, d = p.right_front, p.left_front, p.right_back, p.left_back
    return a.r_w * (a.tau * right), b.r_w * (b.tau * left), c.r_w * (c.tau * right_b), d.r_w * (d.tau * left_b)


@inlined
def torque_of(p, unit, mode, pull, motor, theta, theta_dot, drive, hold):
    """A motor's torque, that on its wheels' axle (N m), and its acceleration (rad/s²): eqs 21, 22, 26 to 28."""
    M_r = axle_torque(p, unit, pull.F_l, pull.u_F_n, unit.tau * theta_dot)
    M_m, theta_ddot = motor_equation(
        unit, p, mode, hold[INERTIA + motor], hold[GEAR + motor] * M_r, theta, theta_dot,
        drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor], hold[TORQUE_D + motor],
    )  # fmt: skip
    return M_m, M_r, theta_ddot


@inlined
def motor_turns(p, unit, mode, pull, motor, theta, theta_dot, drive, hold, torques):
    """As `torque_of`; a prescribed motor needs to know no force unless its torque is asked for, which is zero then."""
    if mode == PRESCRIBED and not torques:
        theta_ddot = follow(p.A_motor, theta, theta_dot, drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor])
        return 0.0, 0.0, theta_ddot
    return torque_of(p, unit, mode, pull, motor, theta, theta_dot, drive, hold)


@inlined
def level_accelerations(at, p, q, v, trig, modes, drive, hold, torques):
    """Accelerations of the ten coordinates, and what brings them about.

    Returns
    -------
    a : tuple of 10 floats
    acting : tuple
        What `planar_accelerations` returns beside.
    M_m, M_r : tuple of 4 floats
        Torques of motors and on axles, N m, in the order of MOTORS; of prescribed ones only where `torques` are wanted.
    """
    f, b = motions(q, v)
    on_f, on_b, pulls, contacts, joint = planar_accelerations(
        saturated, at.front, at.back, at.ground, None, f, b, trig, rims_of(p, v[6], v[7], v[8], v[9]), NO_LAG, NO_LAG
    )
    one, two = p.right_front, p.left_front
    M_0, R_0, a_0 = motor_turns(p, one, modes[0], pulls[0], MOTOR[0], q[6], v[6], drive, hold, torques)
    M_1, R_1, a_1 = motor_turns(p, two, modes[1], pulls[1], MOTOR[1], q[7], v[7], drive, hold, torques)
    M_2 = R_2 = a_2 = M_3 = R_3 = a_3 = 0.0
    if p.two:
        one, two = p.right_back, p.left_back
        M_2, R_2, a_2 = motor_turns(p, one, modes[2], pulls[2], MOTOR[2], q[8], v[8], drive, hold, torques)
        M_3, R_3, a_3 = motor_turns(p, two, modes[3], pulls[3], MOTOR[3], q[9], v[9], drive, hold, torques)
    a = on_f[0], on_f[1], on_f[2], on_b[0], on_b[1], on_b[2], a_0, a_1, a_2, a_3
    return a, (pulls, contacts, joint), (M_0, M_1, M_2, M_3), (R_0, R_1, R_2, R_3)


@inlined
def new_speed(body, p, unit, mode, pair, soil, motor, theta, theta_dot, drive, hold, dt):
    """As `integrators.next_speed`, with what is held for this motor."""
    return next_speed(
        body, p, None, unit, mode, hold[GEAR + motor], hold[INERTIA + motor], theta, theta_dot, drive[D + motor],
        drive[D_DOT + motor], drive[D_DDOT + motor], hold[TORQUE_D + motor], pair, soil, motor, None, dt,
    )  # fmt: skip


@inlined
def torque_after(p, unit, mode, pull, motor, theta_dot, speed, M_m, hold, dt):
    """After a semi-implicit step to `speed`: torque of a motor and on its wheels' axle, N m, with the new forces."""
    M_r = axle_torque(p, unit, pull.F_l, pull.u_F_n, unit.tau * speed)
    if mode == PRESCRIBED:
        M_m = hold[INERTIA + motor] * ((speed - theta_dot) / dt) + hold[GEAR + motor] * M_r
    return M_m, M_r


@inlined
def level_semi_implicit(at, p, q, v, trig, modes, drive, hold, dt):
    """New rates after `dt`, as `integrators.semi_implicit_step` finds them.

    Returns
    -------
    new, a : tuple of 10 floats
        Rates, and accelerations up to there.
    acting : tuple
        See `level_accelerations`.
    M_m, M_r : tuple of 4 floats
        Torques of motors and on axles, N m.
    """
    f, b = motions(q, v)
    pair_r, pair_l, soil_r, soil_l = module_pairs(at.front, at.ground, None, f, trig[0], trig[1])
    right, M_0 = new_speed(at.front, p, p.right_front, modes[0], pair_r, soil_r, MOTOR[0], q[6], v[6], drive, hold, dt)
    left, M_1 = new_speed(at.front, p, p.left_front, modes[1], pair_l, soil_l, MOTOR[1], q[7], v[7], drive, hold, dt)
    right_b = left_b = M_2 = M_3 = 0.0
    if p.two:
        pair_r, pair_l, soil_r, soil_l = module_pairs(at.back, at.ground, None, b, trig[2], trig[3])
        one, two = p.right_back, p.left_back
        right_b, M_2 = new_speed(at.back, p, one, modes[2], pair_r, soil_r, MOTOR[2], q[8], v[8], drive, hold, dt)
        left_b, M_3 = new_speed(at.back, p, two, modes[3], pair_l, soil_l, MOTOR[3], q[9], v[9], drive, hold, dt)
    rims = rims_of(p, right, left, right_b, left_b)
    on_f, on_b, pulls, contacts, joint = planar_accelerations(
        saturated, at.front, at.back, at.ground, None, f, b, trig, rims, NO_LAG, NO_LAG,
        (p.front.sluggish, p.back.sluggish),
    )  # fmt: skip
    M_0, R_0 = torque_after(p, p.right_front, modes[0], pulls[0], MOTOR[0], v[6], right, M_0, hold, dt)
    M_1, R_1 = torque_after(p, p.left_front, modes[1], pulls[1], MOTOR[1], v[7], left, M_1, hold, dt)
    M_2, R_2 = torque_after(p, p.right_back, modes[2], pulls[2], MOTOR[2], v[8], right_b, M_2, hold, dt)
    M_3, R_3 = torque_after(p, p.left_back, modes[3], pulls[3], MOTOR[3], v[9], left_b, M_3, hold, dt)
    a = (
        on_f[0], on_f[1], on_f[2], on_b[0], on_b[1], on_b[2],
        (right - v[6]) / dt, (left - v[7]) / dt, (right_b - v[8]) / dt, (left_b - v[9]) / dt,
    )  # fmt: skip
    new = (
        v[0] + dt * a[0], v[1] + dt * a[1], v[2] + dt * a[2], v[3] + dt * a[3], v[4] + dt * a[4], v[5] + dt * a[5],
        right, left, right_b, left_b,
    )  # fmt: skip
    return new, a, (pulls, contacts, joint), (M_0, M_1, M_2, M_3), (R_0, R_1, R_2, R_3)
