"""Rotations and the universal joint: eqs 2, 13 and 14, and the quadratic velocity terms of eq. 25.

The joint's four constraints are linear in the translations, so its Jacobian (14) is held as what is not
trivial: a (4, 6) block, row-major in a flat array, whose columns are alpha_f, beta_f, gamma_f, alpha_b, beta_b,
gamma_b.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.compiled import inlined
from artibot_sim.model.layout import ALPHA, BACK, BETA, GAMMA, X, Y, Z
from artibot_sim.model.params import packed, params
from artibot_sim.model.robot import Robot

JACOBIAN = 24
"""Length of the flat (4, 6) block."""

ANGLES = (ALPHA, BETA, GAMMA, BACK + ALPHA, BACK + BETA, BACK + GAMMA)
"""The coordinates of the block's columns."""


_QUARTER = (math.pi / 2, 6.123233995736766e-17)
"""pi/2 in two parts, for the reduction of an angle to within ±pi/4."""


@inlined
def sincos(angle):
    """Sine and cosine together, to rounding (2e-16) for angles up to 1e4 rad.

    Taylor's series after reduction to ±pi/4, without branches: several times faster than two calls of the C
    library, and the same on every machine.
    """
    n = math.floor(angle * (2.0 / math.pi) + 0.5)
    x = (angle - n * _QUARTER[0]) - n * _QUARTER[1]
    y = x * x
    y2 = y * y
    y4 = y2 * y2
    # summed by halves (Estrin), which shortens the chain that everything else waits for
    s = x + x * y * (
        ((-1 / 6 + y * (1 / 120)) + y2 * (-1 / 5040 + y * (1 / 362880)))
        + y4 * ((-1 / 39916800 + y * (1 / 6227020800)) + y2 * (-1 / 1307674368000))
    )
    c = 1.0 + y * (
        ((-1 / 2 + y * (1 / 24)) + y2 * (-1 / 720 + y * (1 / 40320)))
        + y4 * ((-1 / 3628800 + y * (1 / 479001600)) + y2 * (-1 / 87178291200 + y * (1 / 20922789888000)))
    )
    quadrant = int(n) & 3
    if quadrant & 1:
        s, c = c, s
    return -s if quadrant >= 2 else s, -c if quadrant == 1 or quadrant == 2 else c


@inlined
def sincos_small(angle):
    """As `sincos`, quicker for roll and pitch, which hardly ever leave ±0.01 rad."""
    if abs(angle) > 0.01:
        return sincos(angle)
    y = angle * angle
    s = angle + angle * y * (-1 / 6 + y * (1 / 120 + y * (-1 / 5040)))
    return s, 1.0 + y * (-1 / 2 + y * (1 / 24 + y * (-1 / 720 + y * (1 / 40320))))


@inlined
def arm(body, s_a, c_a, s_b, c_b, s_g, c_g, alpha_dot, beta_dot, gamma_dot, sign, column, jac):
    """The joint as seen from one module: r = R O (eq. 13), its partials, and its velocity terms.

    Writes ``sign`` times the partials of r into the first three rows of `jac`, at `column` and the next two.

    Returns
    -------
    tuple of 6 floats
        r (3) and the part of its second derivative that does not hold accelerations (3), in `map`.
    """
    O_x, O_z = body.O_x, body.O_z
    # s = Ry Rx O; r = Rz s
    s_x = c_b * O_x + c_a * s_b * O_z
    s_y = -s_a * O_z
    s_z = -s_b * O_x + c_a * c_b * O_z
    s_x_a, s_y_a, s_z_a = -s_a * s_b * O_z, -c_a * O_z, -s_a * c_b * O_z
    s_x_b, s_z_b = s_z, -s_x
    r_x, r_y = c_g * s_x - s_g * s_y, s_g * s_x + c_g * s_y
    jac[column] = sign * (c_g * s_x_a - s_g * s_y_a)
    jac[6 + column] = sign * (s_g * s_x_a + c_g * s_y_a)
    jac[12 + column] = sign * s_z_a
    jac[column + 1] = sign * c_g * s_x_b
    jac[6 + column + 1] = sign * s_g * s_x_b
    jac[12 + column + 1] = sign * s_z_b
    jac[column + 2] = -sign * r_y
    jac[6 + column + 2] = sign * r_x
    jac[12 + column + 2] = 0.0
    # rates of s, and its second derivative without accelerations
    ds_x = s_x_a * alpha_dot + s_x_b * beta_dot
    ds_y = s_y_a * alpha_dot
    aa, ab, bb = alpha_dot * alpha_dot, 2.0 * alpha_dot * beta_dot, beta_dot * beta_dot
    dds_x = -c_a * s_b * O_z * aa - s_a * c_b * O_z * ab - s_x * bb
    dds_y = s_a * O_z * aa
    dds_z = -c_a * c_b * O_z * aa + s_a * s_b * O_z * ab - s_z * bb
    g2 = gamma_dot * gamma_dot
    b_x = dds_x - 2.0 * gamma_dot * ds_y - g2 * s_x
    b_y = dds_y + 2.0 * gamma_dot * ds_x - g2 * s_y
    return r_x, r_y, s_z, c_g * b_x - s_g * b_y, s_g * b_x + c_g * b_y, dds_z


@inlined
def perpendicular(q, v, s_d, c_d, sa_f, ca_f, sb_f, cb_f, sb_b, cb_b, jac):
    """Fourth row of eq. 13: the z axis of {f} stays perpendicular to the x axis of {b}.

    Returns its value and its second derivative's velocity terms; writes its partials into `jac`'s last row.
    Everything is seen from the front module's yaw frame, where only delta = gamma_b − gamma_f enters.
    """
    a_dot, b_dot, bb_dot = v[ALPHA], v[BETA], v[BACK + BETA]
    d_dot = v[BACK + GAMMA] - v[GAMMA]
    z_x, z_y, z_z = ca_f * sb_f, -sa_f, ca_f * cb_f
    x_x, x_y, x_z = cb_b * c_d, cb_b * s_d, -sb_b
    # partials of z_f by alpha_f, beta_f and of x_b by beta_b, delta
    za_x, za_y, za_z = -sa_f * sb_f, -ca_f, -sa_f * cb_f
    zb_x, zb_z = ca_f * cb_f, -ca_f * sb_f
    xb_x, xb_y, xb_z = -sb_b * c_d, -sb_b * s_d, -cb_b
    xd_x, xd_y = -x_y, x_x
    by_delta = z_x * xd_x + z_y * xd_y
    jac[18] = za_x * x_x + za_y * x_y + za_z * x_z
    jac[19] = zb_x * x_x + zb_z * x_z
    jac[20] = -by_delta
    jac[21] = 0.0
    jac[22] = z_x * xb_x + z_y * xb_y + z_z * xb_z
    jac[23] = by_delta
    dz_x = za_x * a_dot + zb_x * b_dot
    dz_y = za_y * a_dot
    dz_z = za_z * a_dot + zb_z * b_dot
    dx_x = xb_x * bb_dot + xd_x * d_dot
    dx_y = xb_y * bb_dot + xd_y * d_dot
    dx_z = xb_z * bb_dot
    aa, ab, bb = a_dot * a_dot, 2.0 * a_dot * b_dot, b_dot * b_dot
    ddz_x = -z_x * (aa + bb) - sa_f * cb_f * ab
    ddz_y = sa_f * aa
    ddz_z = -z_z * (aa + bb) + sa_f * sb_f * ab
    ee, ed, dd = bb_dot * bb_dot, 2.0 * bb_dot * d_dot, d_dot * d_dot
    ddx_x = -x_x * (ee + dd) + sb_b * s_d * ed
    ddx_y = -x_y * (ee + dd) - sb_b * c_d * ed
    ddx_z = -x_z * ee
    value = z_x * x_x + z_y * x_y + z_z * x_z
    bias = (
        ddz_x * x_x + ddz_y * x_y + ddz_z * x_z
        + 2.0 * (dz_x * dx_x + dz_y * dx_y + dz_z * dx_z)
        + z_x * ddx_x + z_y * ddx_y + z_z * ddx_z
    )  # fmt: skip
    return value, bias


@inlined
def joint(q, v, p, sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b, jac):
    """Eq. 13, its Jacobian's angular block (into `jac`) and the velocity terms of its second derivative.

    Returns
    -------
    tuple of 8 floats
        Phi (4), then (d/dt Phi_x) x_dot (4).
    """
    sb_f, cb_f = sincos_small(q[BETA])
    sb_b, cb_b = sincos_small(q[BACK + BETA])
    fx, fy, fz, bfx, bfy, bfz = arm(
        p.front, sa_f, ca_f, sb_f, cb_f, sg_f, cg_f, v[ALPHA], v[BETA], v[GAMMA], 1.0, 0, jac
    )
    bx, by, bz, bbx, bby, bbz = arm(
        p.back, sa_b, ca_b, sb_b, cb_b, sg_b, cg_b, v[BACK + ALPHA], v[BACK + BETA], v[BACK + GAMMA], -1.0, 3, jac
    )
    s_d, c_d = sg_b * cg_f - cg_b * sg_f, cg_b * cg_f + sg_b * sg_f  # of delta
    phi_4, bias_4 = perpendicular(q, v, s_d, c_d, sa_f, ca_f, sb_f, cb_f, sb_b, cb_b, jac)
    return (
        q[X] + fx - q[BACK + X] - bx,
        q[Y] + fy - q[BACK + Y] - by,
        q[Z] + fz - q[BACK + Z] - bz,
        phi_4,
        bfx - bbx,
        bfy - bby,
        bfz - bbz,
        bias_4,
    )


@inlined
def _evaluate(q, v, p, jac):
    sa_f, ca_f = sincos_small(q[ALPHA])
    sa_b, ca_b = sincos_small(q[BACK + ALPHA])
    sg_f, cg_f = sincos(q[GAMMA])
    sg_b, cg_b = sincos(q[BACK + GAMMA])
    return joint(q, v, p, sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b, jac)


def constraint(robot: Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phi of eq. 13, shape (4,): the joint's gap in `map` (m) and the fourth row's cosine, at ``q`` (16,)."""
    return np.array(_evaluate(q, np.zeros(16), packed(params(robot)), np.zeros(JACOBIAN))[:4])


def constraint_jacobian(robot: Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phi_x of eq. 14, shape (4, 16), at ``q`` (16,)."""
    block = np.zeros(JACOBIAN)
    _evaluate(q, np.zeros(16), params(robot), block)
    jacobian = np.zeros((4, 16))
    jacobian[:3, X : Z + 1] = np.eye(3)
    jacobian[:3, BACK + X : BACK + Z + 1] = -np.eye(3)
    jacobian[:, ANGLES] = block.reshape(4, 6)
    return jacobian


def constraint_bias(robot: Robot, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """(d/dt Phi_x) x_dot, shape (4,): minus the right-hand side of eq. 25's lower rows."""
    return np.array(_evaluate(q, v, packed(params(robot)), np.zeros(JACOBIAN))[4:])
