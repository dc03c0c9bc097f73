"""The augmented system (25), (28) of two modules and the joint between them, solved by its structure.

A module's dynamics are taken about its centre of mass, where its mass matrix is diagonal (eq. 8); the state is that of
its origin. Torques in the joint's yaw come from effects only.
"""

from __future__ import annotations

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations.kinematics import joint
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.layout import (
    ACC,
    ALPHA,
    BACK,
    BEHIND,
    BETA,
    FRONT,
    GAMMA,
    LAMBDA,
    LOAD,
    M_J,
    PUSH,
    Q_G,
    Q_J,
    X,
    Y,
    Z,
)

# ----------------------------------------------------------------------
# A module whose centre of mass is off its origin: the dynamics are taken about the centre, the state is the
# origin's.
#
# About its centre a module's mass matrix is diagonal, as eq. 8 has it; the joint sits elsewhere as seen from there.
# ----------------------------------------------------------------------


@inlined
def mass_centre(fx, module, s_g, c_g):
    """From a module's origin to its centre of mass, in `map`, m."""
    x, y = hooks.centre(fx, module)
    return c_g * x - s_g * y, s_g * x + c_g * y


@inlined
def module_loads(body, fx, module, forward, right, left, s_g, c_g, c_a):
    """What effects do to a module at its origin, which moves forward at `forward` (m/s).

    `right` and `left` are what its wheels do (`contact.PairForces`).

    Returns
    -------
    tuple of 5 floats
        Push along x and y of `map` (N); loads along x and y of `map` (N) and yaw moment (N m).
    """
    push_x, push_y = hooks.push(fx, module)
    surge, sway, turn = hooks.load(fx, module)
    front, back = right.R_tf + left.R_tf, right.R_tb + left.R_tb
    surge += (right.R_l + left.R_l) - hooks.resist(fx, module, forward)
    sway += front + back
    turn += body.half_x * (front - back) + body.half_y * c_a * (right.R_l - left.R_l)
    return push_x, push_y, c_g * surge - s_g * sway, s_g * surge + c_g * sway, turn


@inlined
def write_loads(loads, module, w):
    """What `module_loads` gives, into the row."""
    if module == 0:
        w[PUSH], w[PUSH + 1] = loads[0], loads[1]
    o = LOAD + 3 * module
    w[o], w[o + 1], w[o + 2] = loads[2], loads[3], loads[4]


@inlined
def about_mass_centre(body, p, fx, loads, forces, s_g, c_g, module):
    """Forces on a module at its origin (x, y, z, alpha, gamma), the effects' added, moved to its centre of mass.

    `loads` are what `module_loads` gives.
    """
    x, y, z, alpha, gamma = forces[0], forces[1], forces[2], forces[3], forces[4]
    push_x, push_y, load_x, load_y, turn = loads
    x, y, gamma = x + (push_x + load_x), y + (push_y + load_y), gamma + turn
    r_x, r_y = mass_centre(fx, module, s_g, c_g)
    ahead, left = hooks.centre(fx, module)
    alpha, gamma = alpha + body.m * p.g_z * left, gamma - (r_x * y - r_y * x)
    return with_pitch(forces, (x, y, z, alpha, gamma), on_pitch(forces) - p.pitching * body.m * p.g_z * ahead)


@inlined
def on_pitch(numbers):
    """What stands for beta in forces or accelerations of (x, y, z, alpha, gamma): a sixth number on uneven ground."""
    if len(numbers) == 6:
        return numbers[5]
    return 0.0


@inlined
def with_pitch(like, five, beta):
    """Forces or accelerations of (x, y, z, alpha, gamma), and that of beta where `like` has one."""
    if len(like) == 6:
        return five[0], five[1], five[2], five[3], five[4], beta
    return five


@inlined
def turned(free, more):
    """Free accelerations with `more` on gamma (rad/s²)."""
    return with_pitch(free, (free[0], free[1], free[2], free[3], free[4] + more), on_pitch(free))


@inlined
def joint_from_mass_centre(p, fx, v, held, column, module, s_g, c_g):
    """The joint's rows with a module's centre of mass in place of its origin: a_origin = a_centre − γ̈ ẑ×r + γ̇² r.

    Parameters
    ----------
    held : tuple of 4 floats
        Velocity and stabilisation terms of the rows, see `dynamics.joint_geometry`.
    column : tuple of 3 floats
        Derivative of the rows x, y and the fourth by the module's gamma.
    """
    sign = 1.0 if module == 0 else -1.0
    r_x, r_y = mass_centre(fx, module, s_g, c_g)
    r_x, r_y = sign * r_x, sign * r_y
    rate = v[BACK * module + GAMMA]
    damping = 2.0 * p.A_joint * rate
    held = (
        held[0] + rate * rate * r_x - damping * r_y, held[1] + rate * rate * r_y + damping * r_x, held[2], held[3],
    )  # fmt: skip
    return held, (column[0] + r_y, column[1] - r_x, column[2])


@inlined
def back_to_origin(fx, v, s_g, c_g, module, w):
    """The row's accelerations and joint force of a module from its centre of mass back to its origin."""
    r_x, r_y = mass_centre(fx, module, s_g, c_g)
    c, rate = ACC + BACK * module, v[BACK * module + GAMMA]
    w[c + X] += w[c + GAMMA] * r_y + rate * rate * r_x
    w[c + Y] += rate * rate * r_y - w[c + GAMMA] * r_x
    sign = 1.0 if module == 0 else -1.0
    w[Q_J + 6 * module + 5] += sign * (r_y * w[LAMBDA] - r_x * w[LAMBDA + 1])


# ----------------------------------------------------------------------
# The augmented system (25), (28), solved by its structure.
#
# With eq. 8's simplification the mass matrix is constant and diagonal and nothing depends on products of velocities
# but the joint. The motor rows couple to the rest through the contact forces only, so prescribed motors (28) are
# solved one by one, and the joint's multipliers by the 4×4 Schur complement S lambda = Phi_x M⁻¹ n + …
#
# Values pass from function to function as tuples, which stay in registers; the row is only written.
# ----------------------------------------------------------------------


@inlined
def module_gravity(body, p, module, w):
    """Eq. 12: a module's weight, into the row; it never changes."""
    o = Q_G + 6 * module
    w[o], w[o + 1], w[o + 2] = body.m * p.g_x, body.m * p.g_y, body.m * p.g_z


@inlined
def free_acceleration(body, p, fx, s_g, c_g, forces, loads, module):
    """M⁻¹ n of one module's x, y, z, alpha and gamma, the joint left out; beta has none but on uneven ground.

    With effects x and y are those of the centre of mass, and `loads` are what `module_loads` gives.
    """
    acting = forces
    if fx is not None:
        acting = about_mass_centre(body, p, fx, loads, forces, s_g, c_g, module)
    m, J_x, J_y, J_z = body.inverse[0], body.inverse[3], body.inverse[4], body.inverse[5]
    free = (
        p.g_x + m * acting[0], p.g_y + m * acting[1], p.g_z + body.inverse[2] * acting[2], J_x * acting[3],
        J_z * acting[4],
    )  # fmt: skip
    return with_pitch(forces, free, J_y * on_pitch(acting))


@inlined
def factor4(s00, s10, s11, s20, s21, s22, s30, s31, s32, s33):
    """LDLᵀ of a symmetric positive definite 4×4 matrix: l10, l20, l30, l21, l31, l32, and 1/d0 to 1/d3."""
    i0 = 1.0 / s00
    l10, l20, l30 = s10 * i0, s20 * i0, s30 * i0
    i1 = 1.0 / (s11 - l10 * s10)
    t21, t31 = s21 - l10 * s20, s31 - l10 * s30
    l21, l31 = t21 * i1, t31 * i1
    i2 = 1.0 / (s22 - l20 * s20 - l21 * t21)
    t32 = s32 - l20 * s30 - l21 * t31
    l32 = t32 * i2
    i3 = 1.0 / (s33 - l30 * s30 - l31 * t31 - l32 * t32)
    return l10, l20, l30, l21, l31, l32, i0, i1, i2, i3


@inlined
def solve4(factors, b0, b1, b2, b3):
    """Solve with the factors of `factor4`."""
    l10, l20, l30, l21, l31, l32, i0, i1, i2, i3 = factors
    y1 = b1 - l10 * b0
    y2 = (b2 - l20 * b0) - l21 * y1
    y3 = (b3 - l30 * b0) - l31 * y1 - l32 * y2
    x3 = y3 * i3
    x2 = y2 * i2 - l32 * x3
    x1 = (y1 * i1 - l31 * x3) - l21 * x2
    return ((b0 * i0 - l30 * x3) - l20 * x2) - l10 * x1, x1, x2, x3


@inlined
def compliance(body, columns):
    """What one module adds to the Schur complement Phi_x M⁻¹ Phi_xᵀ: its lower triangle, row by row."""
    (a_x, a_y, a_z, a_n), (b_x, b_y, b_z, b_n), (g_x, g_y, g_n) = columns
    m, m_z, J_x, J_y, J_z = body.inverse[0], body.inverse[2], body.inverse[3], body.inverse[4], body.inverse[5]
    A_x, A_y, A_z, A_n = J_x * a_x, J_x * a_y, J_x * a_z, J_x * a_n
    B_x, B_y, B_z, B_n = J_y * b_x, J_y * b_y, J_y * b_z, J_y * b_n
    G_x, G_y, G_n = J_z * g_x, J_z * g_y, J_z * g_n
    return (
        (m + A_x * a_x) + (B_x * b_x + G_x * g_x),
        A_x * a_y + (B_x * b_y + G_x * g_y), (m + A_y * a_y) + (B_y * b_y + G_y * g_y),
        A_x * a_z + B_x * b_z, A_y * a_z + B_y * b_z, m_z + (A_z * a_z + B_z * b_z),
        A_x * a_n + (B_x * b_n + G_x * g_n), A_y * a_n + (B_y * b_n + G_y * g_n), A_z * a_n + B_z * b_n,
        A_n * a_n + (B_n * b_n + G_n * g_n),
    )  # fmt: skip


@inlined
def joint_geometry(q, v, p, fx, trig):
    """All that the joint's force needs and that no other force enters.

    It comes first in the right-hand side, so that its divisions run while the wheel forces are computed.

    Returns
    -------
    bias : tuple of 4 floats
        (d/dt Phi_x) x_dot + A² Phi.
    front, back : tuple
        Columns of Phi_x, see `kinematics.joint`.
    factors : tuple of 10 floats
        Of the Schur complement.
    """
    phi, bias, front, back = joint(q, v, p, trig)
    A2 = p.A_joint * p.A_joint
    held = bias[0] + A2 * phi[0], bias[1] + A2 * phi[1], bias[2] + A2 * phi[2], bias[3] + A2 * phi[3]
    if fx is not None:
        held, gamma_f = joint_from_mass_centre(p, fx, v, held, front[2], FRONT, trig[2], trig[3])
        held, gamma_b = joint_from_mass_centre(p, fx, v, held, back[2], BEHIND, trig[6], trig[7])
        front, back = (front[0], front[1], gamma_f), (back[0], back[1], gamma_b)
    f, b = compliance(p.front, front), compliance(p.back, back)
    factors = factor4(
        f[0] + b[0],
        f[1] + b[1], f[2] + b[2],
        f[3] + b[3], f[4] + b[4], f[5] + b[5],
        f[6] + b[6], f[7] + b[7], f[8] + b[8], f[9] + b[9],
    )  # fmt: skip
    return held, front, back, factors


@inlined
def at_joint(columns, alpha, beta, gamma):
    """Phi_x u for the angular part of u in one module."""
    (a_x, a_y, a_z, a_n), (b_x, b_y, b_z, b_n), (g_x, g_y, g_n) = columns
    return (
        a_x * alpha + (b_x * beta + g_x * gamma),
        a_y * alpha + (b_y * beta + g_y * gamma),
        a_z * alpha + b_z * beta,
        a_n * alpha + (b_n * beta + g_n * gamma),
    )


@inlined
def multipliers(v, p, geometry, free_f, free_b):
    """Lagrange multipliers of the joint: S lambda = Phi_x (M⁻¹ n + 2 A x_dot) + (d/dt Phi_x) x_dot + A² Phi.

    The Baumgarte terms keep eq. 13 from drifting; A = 0 is eq. 25 as printed.
    """
    bias, front, back, factors = geometry
    A, j = 2.0 * p.A_joint, BACK
    f = at_joint(front, free_f[3] + A * v[ALPHA], on_pitch(free_f) + A * v[BETA], free_f[4] + A * v[GAMMA])
    b = at_joint(
        back, free_b[3] + A * v[j + ALPHA], on_pitch(free_b) + A * v[j + BETA], free_b[4] + A * v[j + GAMMA]
    )  # fmt: skip
    return solve4(
        factors,
        (bias[0] + free_f[0] - free_b[0] + A * (v[X] - v[j + X])) + (f[0] + b[0]),
        (bias[1] + free_f[1] - free_b[1] + A * (v[Y] - v[j + Y])) + (f[1] + b[1]),
        (bias[2] + free_f[2] - free_b[2] + A * (v[Z] - v[j + Z])) + (f[2] + b[2]),
        bias[3] + (f[3] + b[3]),
    )


@inlined
def jointed(body, columns, free, push, multiplier, module, w):
    """The joint's generalised forces −Phi_xᵀ lambda on one module and its accelerations, into the row.

    `push` is −1 for the front module and 1 for the back one.
    """
    (a_x, a_y, a_z, a_n), (b_x, b_y, b_z, b_n), (g_x, g_y, g_n) = columns
    l_x, l_y, l_z, l_n = multiplier
    x, y, z = push * l_x, push * l_y, push * l_z
    alpha = -((a_x * l_x + a_y * l_y) + (a_z * l_z + a_n * l_n))
    beta = -((b_x * l_x + b_y * l_y) + (b_z * l_z + b_n * l_n))
    gamma = -((g_x * l_x + g_y * l_y) + g_n * l_n)
    o, c, m = Q_J + 6 * module, ACC + BACK * module, body.inverse[0]
    w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 5] = x, y, z, alpha, beta, gamma
    w[c + X], w[c + Y], w[c + Z] = free[0] + m * x, free[1] + m * y, free[2] + body.inverse[2] * z
    w[c + ALPHA] = free[3] + body.inverse[3] * alpha
    w[c + BETA] = on_pitch(free) + body.inverse[4] * beta
    w[c + GAMMA] = free[4] + body.inverse[5] * gamma


# ----------------------------------------------------------------------
# Torques in the joint's yaw, which only effects bring.
# ----------------------------------------------------------------------


@inlined
def joint_slope(fx, angle, rate):
    """Secant slope of the joint's torque by its yaw rate, N m s/rad."""
    slow = rate if abs(rate) > 1e-9 else 1e-9
    return (hooks.joint(fx, angle, slow) - hooks.joint(fx, angle, 0.0)) / slow


@inlined
def joint_torque(fx, angle, rate, dt):
    """With effects: the torque in a joint's yaw (N m), and what each rad/s² makes of it by the end of a step `dt`.

    In the middle of the step, by the secant slope; at an instant (`dt` None) acceleration makes nothing of it.
    """
    if dt is not None:
        angle += 0.5 * dt * rate
        return hooks.joint(fx, angle, rate), dt * joint_slope(fx, angle, rate)
    return hooks.joint(fx, angle, rate), 0.0


@inlined
def stopped(torque, slope, alone, compliance):
    """The torque at the end of a step, which stops a motion and does not turn it back: friction by its secant.

    `torque` and `slope` are those of `joint_torque`. With that torque the joint's yaw accelerates by `alone` (rad/s²),
    and by `compliance` less for each N m more.
    """
    return torque + slope * alone / (1.0 + slope * compliance)


@inlined
def turned_by_joint(p, fx, v, geometry, front, back, angle, dt, w):
    """Free accelerations of both modules with the effects' torque in the joint's yaw.

    Over a step `dt` (None for the instant) friction is taken implicitly, by its secant, so that it stops a motion and
    does not turn it back: M_J = M(angle, rate) + dt s (acceleration), with the acceleration that M_J leaves.
    """
    torque, slope = joint_torque(fx, angle, v[BACK + GAMMA] - v[GAMMA], dt)
    if dt is not None:
        alone, compliance = yaw_response(p, v, geometry, *twisted(p, front, back, torque))
        torque = stopped(torque, slope, alone, compliance)
    w[M_J] = torque
    return twisted(p, front, back, torque)


@inlined
def twisted(p, front, back, torque):
    """Free accelerations with a `torque` (N m) between the modules that turns the front one left."""
    return turned(front, p.front.inverse[5] * torque), turned(back, -p.back.inverse[5] * torque)


@inlined
def yaw_response(p, v, geometry, front, back):
    """Acceleration of the joint's yaw that the modules take together (rad/s²), and what 1 N m less would make it."""
    _, on_f, on_b, factors = geometry
    i_f, i_b = p.front.inverse[5], p.back.inverse[5]
    (f_x, f_y, f_n), (b_x, b_y, b_n) = on_f[2], on_b[2]
    l_x, l_y, _, l_n = multipliers(v, p, geometry, front, back)
    alone_f = front[4] - i_f * (f_x * l_x + f_y * l_y + f_n * l_n)
    alone_b = back[4] - i_b * (b_x * l_x + b_y * l_y + b_n * l_n)
    f, b = at_joint(on_f, 0.0, 0.0, i_f), at_joint(on_b, 0.0, 0.0, -i_b)
    l_x, l_y, _, l_n = solve4(factors, f[0] + b[0], f[1] + b[1], f[2] + b[2], f[3] + b[3])
    per_f = i_f * (1.0 - (f_x * l_x + f_y * l_y + f_n * l_n))
    per_b = -i_b * (1.0 + (b_x * l_x + b_y * l_y + b_n * l_n))
    return alone_b - alone_f, per_f - per_b
