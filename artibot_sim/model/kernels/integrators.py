"""The right-hand side, and the two ways to step it.

``rk4`` is the classical explicit method. ``semi_implicit`` is symplectic Euler in which the wheel spin, by far the
stiffest part of the model, is solved for implicitly: one right-hand side a step, stable where RK4 is not.

In both, what the paper feeds back from the previous step is held through the step: the efficiencies (eq. 23,
Fig. 7) and the back torques (eq. 30). Flat arrays hold four numbers of each kind, motor by motor: ``drive`` the
commanded angle, speed and acceleration, ``hold`` what stays through the step.
"""

from __future__ import annotations

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations.contact import (
    generalised_forces,
    motor_wheels,
    resistance,
    saturated,
    soil_under,
    wheel_pairs,
)
from artibot_sim.model.equations.dynamics import (
    back_to_origin,
    free_acceleration,
    joint_geometry,
    jointed,
    multipliers,
    turned_by_joint,
)
from artibot_sim.model.equations.kinematics import attitude
from artibot_sim.model.equations.transmission import (
    DRIVEN,
    PRESCRIBED,
    follow,
    limited,
    load_torque,
    motor_equation,
    reflect,
)
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.layout import (  # fmt: skip
    ACC,
    ALPHA,
    BACK,
    BEHIND,
    BETA,
    ETA,
    FRONT,
    GAMMA,
    LAMBDA,
    M_D,
    M_M,
    M_R,
    THETA_L,
    THETA_R,
    X,
    Y,
    Z,
)

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


@inlined
def turn_motor(body, p, fx, unit, mode, theta, theta_dot, pair, soil, motor, drive, hold, lag, dt, w):
    """A motor and its two wheels at an instant (eqs 15, 16, 21, 22): into the row, and the forces returned."""
    omega = unit.tau * theta_dot
    forces = motor_wheels(body, fx, unit, pair, soil, omega, motor, lag, dt, w)
    M_r = load_torque(p, fx, unit, pair, soil, omega, forces[0])
    load = hold[GEAR + motor] * M_r
    if fx is not None:
        w[M_D + motor] = hooks.drag(fx, motor, theta_dot)
        load += w[M_D + motor]
    M_m, theta_ddot = motor_equation(
        unit, p, mode, hold[INERTIA + motor], load, theta, theta_dot,
        drive[D + motor], drive[D_DOT + motor], drive[D_DDOT + motor], hold[TORQUE_D + motor],
    )  # fmt: skip
    w[M_R + motor], w[M_M + motor], w[ACC + coordinate_of(motor)] = M_r, M_m, theta_ddot
    w[ETA + motor] = hold[EFFICIENCY + motor]
    return forces


@inlined
def spin_slope(body, fx, unit, pair, soil, omega, motor, lag):
    """Sum of F_l of a motor's wheels, and its secant slope by the wheel speed (N, N s/rad); no force is stored."""
    slip = unit.r_w * omega - pair.p_x
    free = soil.k_l * slip
    F_tf, F_tb = -soil.k_t * pair.p_yf, -soil.k_t * pair.p_yb
    if fx is not None and hooks.follow_rate(fx, pair.p_x) > 0.0:
        F_tf, F_tb = lag[2 * motor], lag[2 * motor + 1]
    F_lf, _, held_f = saturated(body, fx, free, F_tf, pair.F_nf, soil.mu_sf, soil.mu_df, slip, pair.p_yf)
    F_lb, _, held_b = saturated(body, fx, free, F_tb, pair.F_nb, soil.mu_sb, soil.mu_db, slip, pair.p_yb)
    return F_lf + F_lb, soil.k_l * unit.r_w * (held_f + held_b)


@inlined
def next_speed(body, p, fx, unit, mode, gear, J, theta, theta_dot, d, d_dot, d_ddot, M_d, pair, soil, motor, lag, dt):
    """Motor speed after a step, the wheels' slip taken implicitly (linearised at the old speed), and its torque.

    A prescribed motor's torque follows from the new forces; zero stands in its place here.
    """
    if mode == PRESCRIBED:
        return theta_dot + dt * follow(p.A_motor, theta, theta_dot, d, d_dot, d_ddot), 0.0
    omega = unit.tau * theta_dot
    F_l, slope = spin_slope(body, fx, unit, pair, soil, omega, motor, lag)
    load = gear * load_torque(p, fx, unit, pair, soil, omega, F_l)
    inertia = J + dt * gear * unit.r_w * slope * unit.tau
    if fx is not None:
        drag = hooks.drag(fx, motor, theta_dot)
        load += drag
        inertia += dt * drag / theta_dot if theta_dot != 0.0 else 0.0
    M_m = M_d
    if mode == DRIVEN:
        M_m = inertia * (d_ddot + p.velocity_gain * (d_dot - theta_dot)) + load
    M_m = limited(unit, M_m)
    return theta_dot + dt * (M_m - load) / inertia, M_m


@inlined
def step_motor(body, p, fx, unit, mode, theta, theta_dot, pair, soil, motor, drive, hold, lag, dt, w):
    """As `turn_motor`, over a step: the forces are those at the new speed."""
    gear, J = hold[GEAR + motor], hold[INERTIA + motor]
    speed, M_m = next_speed(
        body, p, fx, unit, mode, gear, J, theta, theta_dot, drive[D + motor], drive[D_DOT + motor],
        drive[D_DDOT + motor], hold[TORQUE_D + motor], pair, soil, motor, lag, dt,
    )  # fmt: skip
    omega = unit.tau * speed
    forces = motor_wheels(body, fx, unit, pair, soil, omega, motor, lag, dt, w)
    M_r = load_torque(p, fx, unit, pair, soil, omega, forces[0])
    theta_ddot = (speed - theta_dot) / dt
    load = gear * M_r
    if fx is not None:
        w[M_D + motor] = hooks.drag(fx, motor, speed)
        load += w[M_D + motor]
    if mode == PRESCRIBED:
        M_m = J * theta_ddot + load
    w[M_R + motor], w[M_M + motor], w[ACC + coordinate_of(motor)] = M_r, M_m, theta_ddot
    w[ETA + motor] = hold[EFFICIENCY + motor]
    return forces


@inlined
def module_forces(move, body, right, left, q, v, p, fx, s_a, c_a, s_g, c_g, module, modes, drive, hold, lag, dt, w):
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
    pair_r, pair_l = wheel_pairs(
        body, p, fx, v_x, v_y, v[b + Z], v[b + ALPHA], v[b + GAMMA], s_a, c_a, q[b + Z], module, w
    )
    soil_r = soil_under(body, p, fx, pair_r, q[b + X], q[b + Y], s_g, c_g, c_a, -1.0)
    soil_l = soil_under(body, p, fx, pair_l, q[b + X], q[b + Y], s_g, c_g, c_a, 1.0)
    theta_r, theta_l = b + THETA_R, b + THETA_L
    on_right = move(
        body, p, fx, right, modes[motor], q[theta_r], v[theta_r], pair_r, soil_r, motor, drive, hold, lag, dt, w
    )
    on_left = move(
        body, p, fx, left, modes[motor + 1], q[theta_l], v[theta_l], pair_l, soil_l, motor + 1, drive, hold, lag, dt, w
    )
    forces = generalised_forces(
        body, p, fx, s_a, c_a, s_g, c_g, on_right, on_left, pair_r, pair_l, soil_r, soil_l, module, w
    )
    resisted = 0.0, 0.0, 0.0
    if fx is not None:
        resisted = resistance(body, fx, module, v_x, pair_r, pair_l, soil_r, soil_l, c_a)
    return free_acceleration(body, p, fx, v[b + X], v[b + Y], v[b + GAMMA], s_g, c_g, forces, resisted, module, dt, w)


@inlined
def accelerations(move, q, v, p, fx, modes, drive, hold, lag, dt, w):
    """All of eq. 28 at (q, v): every contribution and the accelerations of all coordinates, into the row."""
    trig = attitude(q)
    geometry = joint_geometry(q, v, p, fx, trig)
    sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b = trig
    front = module_forces(
        move, p.front, p.right_front, p.left_front, q, v, p, fx, sa_f, ca_f, sg_f, cg_f, FRONT, modes, drive, hold,
        lag, dt, w,
    )  # fmt: skip
    if not p.two:
        for i in range(3):
            w[ACC + i] = front[i]
        w[ACC + ALPHA], w[ACC + GAMMA] = front[3], front[4]
        if fx is not None:
            back_to_origin(fx, v, sg_f, cg_f, FRONT, w)
        return
    back = module_forces(
        move, p.back, p.right_back, p.left_back, q, v, p, fx, sa_b, ca_b, sg_b, cg_b, BEHIND, modes, drive, hold,
        lag, dt, w,
    )  # fmt: skip
    if fx is not None:
        front, back = turned_by_joint(p, fx, v, geometry, front, back, q[BACK + GAMMA] - q[GAMMA], dt, w)
    multiplier = multipliers(v, p, geometry, front, back)
    w[LAMBDA], w[LAMBDA + 1], w[LAMBDA + 2], w[LAMBDA + 3] = multiplier
    jointed(p.front, geometry[1], front, -1.0, multiplier, FRONT, w)
    jointed(p.back, geometry[2], back, 1.0, multiplier, BEHIND, w)
    if fx is not None:
        back_to_origin(fx, v, sg_f, cg_f, FRONT, w)
        back_to_origin(fx, v, sg_b, cg_b, BEHIND, w)


@inlined
def right_hand_side(q, v, p, fx, modes, drive, hold, lag, w):
    """Accelerations of all coordinates at (q, v), with every contribution, into the row."""
    accelerations(turn_motor, q, v, p, fx, modes, drive, hold, lag, 0.0, w)


@inlined
def semi_implicit_step(q, v, p, fx, modes, drive, hold, lag, dt, w):
    """Advance (q, v) in place by `dt`; the row then holds the contributions that acted.

    ``drive[D_DDOT:]`` holds the mean acceleration of the commands over the step.
    """
    accelerations(step_motor, q, v, p, fx, modes, drive, hold, lag, dt, w)
    for i in range(16):
        new = v[i] + dt * w[ACC + i]
        c = i % 8
        # where the ground is a spring the new velocity must be used (symplectic); elsewhere the mean is closer
        q[i] += dt * (new if Z <= c <= BETA else 0.5 * (v[i] + new))
        v[i] = new
