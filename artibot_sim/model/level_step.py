"""One rover on a plane, alone: the right-hand side, and the two ways to step it, as `integrators` has them in space.

Coordinates that move and their rates are tuples of ten numbers, which stay in registers: x, y, gamma of the front
module, of the back one, and the motors' angles. Nothing is stored on the way; `level_row` writes down what is kept.
"""

from __future__ import annotations

from typing import NamedTuple

from artibot_sim.model.compiled import inlined
from artibot_sim.model.contact import saturated
from artibot_sim.model.elementary import sincos, turn_by
from artibot_sim.model.integrators import D_DDOT, D_DOT, GEAR, INERTIA, TORQUE_D, D, next_speed
from artibot_sim.model.layout import BACK, BEHIND, FRONT, MOTOR, Z
from artibot_sim.model.level import standing
from artibot_sim.model.planar import Body, Ground, Motion, module_pairs, planar_accelerations
from artibot_sim.model.transmission import PRESCRIBED, axle_torque, follow, motor_equation

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
