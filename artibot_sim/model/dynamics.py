"""The augmented system (25), (28), solved by its structure.

With eq. 8's simplification the mass matrix is constant and diagonal and nothing depends on products of velocities
but the joint. The motor rows couple to the rest through the contact forces only, so prescribed motors (28) are
solved one by one, and the joint's multipliers by the 4×4 Schur complement  S lambda = Phi_x M⁻¹ n + …
"""

from __future__ import annotations

from artibot_sim.model.compiled import inlined
from artibot_sim.model.contact import generalised_forces, wheel_kinematics
from artibot_sim.model.kinematics import JACOBIAN, joint, sincos, sincos_small
from artibot_sim.model.layout import ACC, ALPHA, BACK, GAMMA, LAMBDA, Q_C, Q_G, Q_J, X, Y, Z


@inlined
def attitude(q):
    """Sines and cosines of roll and yaw of both modules: sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b."""
    sa_f, ca_f = sincos_small(q[ALPHA])
    sa_b, ca_b = sincos_small(q[BACK + ALPHA])
    sg_f, cg_f = sincos(q[GAMMA])
    sg_b, cg_b = sincos(q[BACK + GAMMA])
    return sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b


@inlined
def all_wheels(q, v, p, trig, w):
    """Kinematics and normal forces of all wheels (into the row)."""
    sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b = trig
    v_x, v_y = cg_f * v[X] + sg_f * v[Y], cg_f * v[Y] - sg_f * v[X]
    wheel_kinematics(p.front, p, v_x, v_y, v[Z], v[ALPHA], v[GAMMA], sa_f, ca_f, q[Z], 0, w)
    if p.two:
        b = BACK
        v_x, v_y = cg_b * v[b + X] + sg_b * v[b + Y], cg_b * v[b + Y] - sg_b * v[b + X]
        wheel_kinematics(p.back, p, v_x, v_y, v[b + Z], v[b + ALPHA], v[b + GAMMA], sa_b, ca_b, q[b + Z], 4, w)


@inlined
def module_gravity(body, p, out, w):
    """Eq. 12: a module's weight, into the row at `out`."""
    w[Q_G + out] = body.m * p.g_x
    w[Q_G + out + 1] = body.m * p.g_y
    w[Q_G + out + 2] = body.m * p.g_z


@inlined
def free_acceleration(inverse, out, acc, w):
    """M⁻¹ n of one module's six coordinates, the joint left out, into the row's accelerations."""
    for i in range(6):
        w[ACC + acc + i] = (w[Q_G + out + i] + w[Q_C + out + i]) * inverse[i]


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
def divide_by_mass(p, jac):
    """The angular block of Phi_x M⁻¹, behind that of Phi_x."""
    for row in range(4):
        for i in range(3):
            jac[JACOBIAN + 6 * row + i] = jac[6 * row + i] * p.front.inverse[3 + i]
            jac[JACOBIAN + 6 * row + 3 + i] = jac[6 * row + 3 + i] * p.back.inverse[3 + i]


@inlined
def schur(jac, row, col):
    """Entry (row, col) of the angular part of Phi_x M⁻¹ Phi_xᵀ."""
    a, b = JACOBIAN + 6 * row, 6 * col
    front = jac[a] * jac[b] + jac[a + 1] * jac[b + 1] + jac[a + 2] * jac[b + 2]
    back = jac[a + 3] * jac[b + 3] + jac[a + 4] * jac[b + 4] + jac[a + 5] * jac[b + 5]
    return front + back


@inlined
def joint_geometry(q, v, p, trig, jac):
    """All that the joint's force needs and that no other force enters.

    It comes first in the right-hand side, so that its divisions run while the wheel forces are computed.

    Returns
    -------
    tuple of 4 floats, tuple of 10 floats
        (d/dt Phi_x) x_dot + A² Phi, and the factors of the Schur complement.
    """
    sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b = trig
    h0, h1, h2, h3, b0, b1, b2, b3 = joint(q, v, p, sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b, jac)
    divide_by_mass(p, jac)
    move = p.front.inverse[0] + p.back.inverse[0]
    factors = factor4(
        move + schur(jac, 0, 0),
        schur(jac, 1, 0), move + schur(jac, 1, 1),
        schur(jac, 2, 0), schur(jac, 2, 1), move + schur(jac, 2, 2),
        schur(jac, 3, 0), schur(jac, 3, 1), schur(jac, 3, 2), schur(jac, 3, 3),
    )  # fmt: skip
    A2 = p.A_joint * p.A_joint
    return (b0 + A2 * h0, b1 + A2 * h1, b2 + A2 * h2, b3 + A2 * h3), factors


@inlined
def cancel(v, p, jac, row, bias, w):
    """Row of Phi_x (M⁻¹ n + 2 A x_dot) + (d/dt Phi_x) x_dot + A² Phi: what the joint's force must cancel.

    The Baumgarte terms keep eq. 13 from drifting; A = 0 is eq. 25 as printed.
    """
    a, f, b = 6 * row, ACC + ALPHA, ACC + BACK + ALPHA
    A = 2.0 * p.A_joint
    front, back = 0.0, bias
    for i in range(3):
        front += jac[a + i] * (w[f + i] + A * v[ALPHA + i])
        back += jac[a + 3 + i] * (w[b + i] + A * v[BACK + ALPHA + i])
    if row < 3:
        front += w[ACC + row] - w[ACC + BACK + row] + A * (v[row] - v[BACK + row])
    return front + back


@inlined
def joint_forces(v, p, bias, factors, jac, w):
    """Multipliers of the joint (25) and its generalised forces −Phi_xᵀ lambda, added to the accelerations."""
    l0, l1, l2, l3 = solve4(
        factors,
        cancel(v, p, jac, 0, bias[0], w),
        cancel(v, p, jac, 1, bias[1], w),
        cancel(v, p, jac, 2, bias[2], w),
        cancel(v, p, jac, 3, bias[3], w),
    )
    w[LAMBDA], w[LAMBDA + 1], w[LAMBDA + 2], w[LAMBDA + 3] = l0, l1, l2, l3
    for i in range(3):
        w[Q_J + i] = -w[LAMBDA + i]
        w[Q_J + 6 + i] = w[LAMBDA + i]
        w[Q_J + 3 + i] = -((jac[i] * l0 + jac[6 + i] * l1) + (jac[12 + i] * l2 + jac[18 + i] * l3))
        w[Q_J + 9 + i] = -((jac[3 + i] * l0 + jac[9 + i] * l1) + (jac[15 + i] * l2 + jac[21 + i] * l3))
    for i in range(6):
        w[ACC + i] += w[Q_J + i] * p.front.inverse[i]
        w[ACC + BACK + i] += w[Q_J + 6 + i] * p.back.inverse[i]


@inlined
def body_accelerations(v, p, trig, bias, factors, jac, w):
    """Accelerations of both modules from the forces in the row (eqs 12, 17, 18, 25), named parts kept."""
    sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b = trig
    generalised_forces(p.front, p, sa_f, ca_f, sg_f, cg_f, 0, 0, w)
    module_gravity(p.front, p, 0, w)
    free_acceleration(p.front.inverse, 0, 0, w)
    if p.two:
        generalised_forces(p.back, p, sa_b, ca_b, sg_b, cg_b, 4, 6, w)
        module_gravity(p.back, p, 6, w)
        free_acceleration(p.back.inverse, 6, BACK, w)
        joint_forces(v, p, bias, factors, jac, w)
