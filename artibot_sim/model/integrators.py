"""The right-hand side, and the two ways to step it.

``rk4`` is the classical explicit method. ``semi_implicit`` is symplectic Euler in which the wheel spin, by far the
stiffest part of the model, is solved for implicitly: one right-hand side a step, stable where RK4 is not.

In both, what the paper feeds back from the previous step is held through the step: the efficiencies (eq. 23,
Fig. 7) and the back torques (eq. 30). Flat arrays hold four numbers of each kind, motor by motor: ``drive`` the
commanded angle, speed and acceleration, ``hold`` what stays through the step.
"""

from __future__ import annotations

from artibot_sim.model.compiled import inlined
from artibot_sim.model.contact import motor_wheels, wheel_force
from artibot_sim.model.dynamics import all_wheels, attitude, body_accelerations, joint_geometry
from artibot_sim.model.layout import (
    ACC,
    BACK,
    BETA,
    ETA,
    F_N,
    M_M,
    M_R,
    P_X,
    P_Y,
    THETA_L,
    THETA_R,
    Z,
)
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
    """Fix for a step what eq. 21 makes of the efficiencies."""
    for motor in range(motor_count(p)):
        gear, J = reflect(motor_of(p, motor), eta[motor])
        hold[EFFICIENCY + motor], hold[GEAR + motor], hold[INERTIA + motor] = eta[motor], gear, J


@inlined
def right_hand_side(q, v, p, modes, drive, hold, jac, w):
    """Accelerations of all coordinates at (q, v), with every contribution, into the row."""
    trig = attitude(q)
    bias, factors = joint_geometry(q, v, p, trig, jac)
    all_wheels(q, v, p, trig, w)
    for motor in range(motor_count(p)):
        c = coordinate_of(motor)
        unit = motor_of(p, motor)
        omega = unit.tau * v[c]
        F_l_sum, F_n_sum = motor_wheels(p, omega, 2 * motor, w)
        M_r = load_torque(p, omega, F_l_sum, F_n_sum)
        M_m, theta_ddot = motor_equation(
            unit, p, modes[motor], hold[GEAR + motor], hold[INERTIA + motor], M_r, q[c], v[c],
            drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor], hold[TORQUE_D + motor],
        )  # fmt: skip
        w[M_R + motor], w[M_M + motor], w[ACC + c] = M_r, M_m, theta_ddot
        w[ETA + motor] = hold[EFFICIENCY + motor]
    body_accelerations(v, p, trig, bias, factors, jac, w)


@inlined
def spin_slope(p, omega, first, w):
    """Sum of F_l of two wheels, and its secant slope by the wheel speed (N, N s/rad); no force is stored."""
    total, slope = 0.0, 0.0
    for i in range(first, first + 2):
        rim = p.r_w * omega
        free = p.k_l * (rim - w[P_X + i])
        F_l, _, sat = wheel_force(p, rim, w[P_X + i], w[P_Y + i], w[F_N + i])
        total += F_l
        slope += p.k_l * p.r_w * (F_l / free if sat > 0.0 and free != 0.0 else 1.0)
    return total, slope


@inlined
def next_speed(unit, p, mode, gear, J, theta, theta_dot, d, d_dot, d_ddot, M_d, first, dt, w):
    """Motor speed after a step, the wheels' slip taken implicitly (linearised at the old speed), and its torque.

    A prescribed motor's torque follows from the new forces; zero stands in its place here.
    """
    if mode == PRESCRIBED:
        return theta_dot + dt * follow(p.A_motor, theta, theta_dot, d, d_dot, d_ddot), 0.0
    omega = unit.tau * theta_dot
    F_l, slope = spin_slope(p, omega, first, w)
    load = gear * load_torque(p, omega, F_l, w[F_N + first] + w[F_N + first + 1])
    inertia = J + dt * gear * p.r_w * slope * unit.tau
    M_m = M_d
    if mode == DRIVEN:
        M_m = inertia * (d_ddot + p.velocity_gain * (d_dot - theta_dot)) + load
    M_m = limited(unit, M_m)
    return theta_dot + dt * (M_m - load) / inertia, M_m


@inlined
def semi_implicit_step(q, v, p, modes, drive, hold, dt, jac, w):
    """Advance (q, v) in place by `dt`; the row then holds the contributions that acted.

    ``drive[D_DDOT:]`` holds the mean acceleration of the commands over the step.
    """
    trig = attitude(q)
    bias, factors = joint_geometry(q, v, p, trig, jac)
    all_wheels(q, v, p, trig, w)
    for motor in range(motor_count(p)):
        c, first, mode = coordinate_of(motor), 2 * motor, modes[motor]
        unit, gear, J = motor_of(p, motor), hold[GEAR + motor], hold[INERTIA + motor]
        speed, M_m = next_speed(
            unit, p, mode, gear, J, q[c], v[c],
            drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor], hold[TORQUE_D + motor], first, dt, w,
        )  # fmt: skip
        omega = unit.tau * speed
        F_l_sum, F_n_sum = motor_wheels(p, omega, first, w)
        M_r = load_torque(p, omega, F_l_sum, F_n_sum)
        theta_ddot = (speed - v[c]) / dt
        if mode == PRESCRIBED:
            M_m = J * theta_ddot + gear * M_r
        w[M_R + motor], w[M_M + motor], w[ACC + c] = M_r, M_m, theta_ddot
        w[ETA + motor] = hold[EFFICIENCY + motor]
    body_accelerations(v, p, trig, bias, factors, jac, w)
    for i in range(16 if p.two else 8):
        new = v[i] + dt * w[ACC + i]
        c = i % 8
        # where the ground is a spring the new velocity must be used (symplectic); elsewhere the mean is closer
        q[i] += dt * (new if Z <= c <= BETA else 0.5 * (v[i] + new))
        v[i] = new
