"""The right-hand side, and the two ways to step it.

``rk4`` is the classical explicit method. ``semi_implicit`` is symplectic Euler in which the wheel spin, by far the
stiffest part of the model, is solved for implicitly: one right-hand side a step, stable where RK4 is not.

In both, what the paper feeds back from the previous step is held through the step: the efficiencies (eq. 23,
Fig. 7) and the back torques (eq. 30). Flat arrays hold four numbers of each kind, motor by motor: ``drive`` the
commanded angle, speed and acceleration, ``hold`` what stays through the step.
"""

from __future__ import annotations

import numpy as np

from artibot_sim.model.compiled import inlined
from artibot_sim.model.contact import generalised_forces, motor_wheels, saturated, wheel_kinematics
from artibot_sim.model.dynamics import free_acceleration, joint_geometry, jointed, multipliers
from artibot_sim.model.kinematics import attitude
from artibot_sim.model.layout import ACC, ALPHA, BACK, BETA, ETA, GAMMA, LAMBDA, M_M, M_R, THETA_L, THETA_R, X, Y, Z
from artibot_sim.model.transmission import DRIVEN, PRESCRIBED, follow, limited, load_torque, motor_equation, reflect

D, D_DOT, D_DDOT = 0, 4, 8
"""Where `drive` holds angles, speeds and accelerations."""

TORQUE_D, EFFICIENCY, GEAR, INERTIA = 0, 4, 8, 12
"""Where `hold` holds commanded torques, efficiencies, tau/eta and J_m + J_w tau²/eta."""


@inlined
def motor_of(p, motor):
    """Parameters of a motor by its number."""
    if motor == 0:
        return p.right_front
    if motor == 1:
        return p.left_front
    if motor == 2:
        return p.right_back
    return p.left_back


@inlined
def coordinate_of(motor):
    """Where a motor's angle stands in q."""
    return (THETA_R if motor % 2 == 0 else THETA_L) + (BACK if motor > 1 else 0)


@inlined
def motor_count(p):
    """Four, or two for a rigid robot."""
    return 4 if p.two else 2


@inlined
def hold_efficiencies(p, eta, hold):
    """Fix for a step what eq. 21 makes of the efficiencies, which seldom change."""
    for motor in range(motor_count(p)):
        if hold[EFFICIENCY + motor] != eta[motor]:
            gear, J = reflect(motor_of(p, motor), eta[motor])
            hold[EFFICIENCY + motor], hold[GEAR + motor], hold[INERTIA + motor] = eta[motor], gear, J


FRONT, BEHIND = np.int64(0), np.int64(1)
"""The modules. Not Python's integers, for each of whose values numba would compile every function anew."""


@inlined
def turn_motor(p, unit, mode, theta, theta_dot, p_x, p_yf, p_yb, F_n, motor, drive, hold, dt, w):
    """A motor and its two wheels at an instant (eqs 15, 16, 21, 22): into the row, and the forces returned."""
    omega = unit.tau * theta_dot
    forces = motor_wheels(p, omega, p_x, p_yf, p_yb, F_n, motor, w)
    M_r = load_torque(p, omega, forces[0], 2.0 * F_n)
    M_m, theta_ddot = motor_equation(
        unit, p, mode, hold[GEAR + motor], hold[INERTIA + motor], M_r, theta, theta_dot,
        drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor], hold[TORQUE_D + motor],
    )  # fmt: skip
    w[M_R + motor], w[M_M + motor], w[ACC + coordinate_of(motor)] = M_r, M_m, theta_ddot
    w[ETA + motor] = hold[EFFICIENCY + motor]
    return forces


@inlined
def spin_slope(p, omega, p_x, p_yf, p_yb, F_n):
    """Sum of F_l of a motor's wheels, and its secant slope by the wheel speed (N, N s/rad); no force is stored."""
    free = p.k_l * (p.r_w * omega - p_x)
    F_lf, _, held_f = saturated(p, free, -p.k_t * p_yf, F_n)
    F_lb, _, held_b = saturated(p, free, -p.k_t * p_yb, F_n)
    return F_lf + F_lb, p.k_l * p.r_w * (held_f + held_b)


@inlined
def next_speed(unit, p, mode, gear, J, theta, theta_dot, d, d_dot, d_ddot, M_d, p_x, p_yf, p_yb, F_n, dt):
    """Motor speed after a step, the wheels' slip taken implicitly (linearised at the old speed), and its torque.

    A prescribed motor's torque follows from the new forces; zero stands in its place here.
    """
    if mode == PRESCRIBED:
        return theta_dot + dt * follow(p.A_motor, theta, theta_dot, d, d_dot, d_ddot), 0.0
    omega = unit.tau * theta_dot
    F_l, slope = spin_slope(p, omega, p_x, p_yf, p_yb, F_n)
    load = gear * load_torque(p, omega, F_l, 2.0 * F_n)
    inertia = J + dt * gear * p.r_w * slope * unit.tau
    M_m = M_d
    if mode == DRIVEN:
        M_m = inertia * (d_ddot + p.velocity_gain * (d_dot - theta_dot)) + load
    M_m = limited(unit, M_m)
    return theta_dot + dt * (M_m - load) / inertia, M_m


@inlined
def step_motor(p, unit, mode, theta, theta_dot, p_x, p_yf, p_yb, F_n, motor, drive, hold, dt, w):
    """As `turn_motor`, over a step: the forces are those at the new speed."""
    gear, J = hold[GEAR + motor], hold[INERTIA + motor]
    speed, M_m = next_speed(
        unit, p, mode, gear, J, theta, theta_dot, drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor],
        hold[TORQUE_D + motor], p_x, p_yf, p_yb, F_n, dt,
    )  # fmt: skip
    omega = unit.tau * speed
    forces = motor_wheels(p, omega, p_x, p_yf, p_yb, F_n, motor, w)
    M_r = load_torque(p, omega, forces[0], 2.0 * F_n)
    theta_ddot = (speed - theta_dot) / dt
    if mode == PRESCRIBED:
        M_m = J * theta_ddot + gear * M_r
    w[M_R + motor], w[M_M + motor], w[ACC + coordinate_of(motor)] = M_r, M_m, theta_ddot
    w[ETA + motor] = hold[EFFICIENCY + motor]
    return forces


@inlined
def module_forces(move, body, right, left, q, v, p, s_a, c_a, s_g, c_g, module, modes, drive, hold, dt, w):
    """Motors, wheels and ground of one module, into the row; the joint left out.

    Parameters
    ----------
    move : function
        How a motor moves: `turn_motor` or `step_motor`.

    Returns
    -------
    tuple of 5 floats
        Free accelerations of x, y, z, alpha and gamma.
    """
    b, motor = BACK * module, 2 * module
    v_x, v_y = c_g * v[b + X] + s_g * v[b + Y], c_g * v[b + Y] - s_g * v[b + X]
    p_xr, p_xl, p_yf, p_yb, F_r, F_l = wheel_kinematics(
        body, p, v_x, v_y, v[b + Z], v[b + ALPHA], v[b + GAMMA], s_a, c_a, q[b + Z], module, w
    )
    on_right = move(
        p, right, modes[motor], q[b + THETA_R], v[b + THETA_R], p_xr, p_yf, p_yb, F_r, motor, drive, hold, dt, w
    )
    on_left = move(
        p, left, modes[motor + 1], q[b + THETA_L], v[b + THETA_L], p_xl, p_yf, p_yb, F_l, motor + 1, drive, hold, dt, w
    )
    forces = generalised_forces(body, p, s_a, c_a, s_g, c_g, on_right, on_left, F_r, F_l, module, w)
    return free_acceleration(body, p, v[b + X], v[b + Y], v[b + GAMMA], forces, dt)


@inlined
def accelerations(move, q, v, p, modes, drive, hold, dt, w):
    """All of eq. 28 at (q, v): every contribution and the accelerations of all coordinates, into the row."""
    trig = attitude(q)
    geometry = joint_geometry(q, v, p, trig)
    sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b = trig
    front = module_forces(
        move, p.front, p.right_front, p.left_front, q, v, p, sa_f, ca_f, sg_f, cg_f, FRONT, modes, drive, hold, dt, w
    )
    if not p.two:
        for i in range(3):
            w[ACC + i] = front[i]
        w[ACC + ALPHA], w[ACC + GAMMA] = front[3], front[4]
        return
    back = module_forces(
        move, p.back, p.right_back, p.left_back, q, v, p, sa_b, ca_b, sg_b, cg_b, BEHIND, modes, drive, hold, dt, w
    )
    multiplier = multipliers(v, p, geometry, front, back)
    w[LAMBDA], w[LAMBDA + 1], w[LAMBDA + 2], w[LAMBDA + 3] = multiplier
    jointed(p.front, geometry[1], front, -1.0, multiplier, FRONT, w)
    jointed(p.back, geometry[2], back, 1.0, multiplier, BEHIND, w)


@inlined
def right_hand_side(q, v, p, modes, drive, hold, w):
    """Accelerations of all coordinates at (q, v), with every contribution, into the row."""
    accelerations(turn_motor, q, v, p, modes, drive, hold, 0.0, w)


@inlined
def semi_implicit_step(q, v, p, modes, drive, hold, dt, w):
    """Advance (q, v) in place by `dt`; the row then holds the contributions that acted.

    ``drive[D_DDOT:]`` holds the mean acceleration of the commands over the step.
    """
    accelerations(step_motor, q, v, p, modes, drive, hold, dt, w)
    for i in range(16):
        new = v[i] + dt * w[ACC + i]
        c = i % 8
        # where the ground is a spring the new velocity must be used (symplectic); elsewhere the mean is closer
        q[i] += dt * (new if Z <= c <= BETA else 0.5 * (v[i] + new))
        v[i] = new
