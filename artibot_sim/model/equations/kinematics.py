"""Rotations and the universal joint: eqs 2, 13 and 14, and the quadratic velocity terms of eq. 25.

The joint's four constraints are linear in the translations, so of its Jacobian (14) only the columns of the six
angles are computed.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.elementary import sincos
from artibot_sim.model.kernels.layout import ALPHA, BACK, BETA, GAMMA, X, Y, Z
from artibot_sim.model.robot.derived import packed, params
from artibot_sim.model.robot.robot import Robot


@inlined
def sincos_small(angle):
    """Sine and cosine, quicker than `sincos` for roll and pitch, which hardly ever leave ±0.01 rad."""
    if abs(angle) > 0.01:
        return sincos(angle)
    y = angle * angle
    s = angle + angle * y * (-1 / 6 + y * (1 / 120 + y * (-1 / 5040)))
    return s, 1.0 + y * (-1 / 2 + y * (1 / 24 + y * (-1 / 720 + y * (1 / 40320))))


@inlined
def arm(body, s_a, c_a, s_b, c_b, s_g, c_g, alpha_dot, beta_dot, gamma_dot):
    """The joint as seen from one module: r = R O (eq. 13), its partials, and its velocity terms.

    Returns
    -------
    r : tuple of 3 floats
        Its partial by gamma is (-r_y, r_x, 0).
    r_alpha, r_beta : tuple of 3 floats
        Partials.
    bias : tuple of 3 floats
        The part of r's second derivative that does not hold accelerations. All in `map`.
    """
    O_x, O_z = body.O_x, body.O_z
    # s = Ry Rx O; r = Rz s
    s_x = c_b * O_x + c_a * s_b * O_z
    s_y = -s_a * O_z
    s_z = -s_b * O_x + c_a * c_b * O_z
    s_x_a, s_y_a, s_z_a = -s_a * s_b * O_z, -c_a * O_z, -s_a * c_b * O_z
    s_x_b, s_z_b = s_z, -s_x
    r = c_g * s_x - s_g * s_y, s_g * s_x + c_g * s_y, s_z
    r_alpha = c_g * s_x_a - s_g * s_y_a, s_g * s_x_a + c_g * s_y_a, s_z_a
    r_beta = c_g * s_x_b, s_g * s_x_b, s_z_b
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
    return r, r_alpha, r_beta, (c_g * b_x - s_g * b_y, s_g * b_x + c_g * b_y, dds_z)


@inlined
def perpendicular(q, v, s_d, c_d, sa_f, ca_f, sb_f, cb_f, sb_b, cb_b):
    """Fourth row of eq. 13: the z axis of {f} stays perpendicular to the x axis of {b}.

    Everything is seen from the front module's yaw frame, where only delta = gamma_b − gamma_f enters.

    Returns
    -------
    value, bias : float
        The row, and its second derivative's velocity terms.
    partials : tuple of 4 floats
        By alpha_f, beta_f, beta_b and delta.
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
    partials = (
        za_x * x_x + za_y * x_y + za_z * x_z,
        zb_x * x_x + zb_z * x_z,
        z_x * xb_x + z_y * xb_y + z_z * xb_z,
        z_x * xd_x + z_y * xd_y,
    )
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
    return value, bias, partials


@inlined
def joint(q, v, p, trig):
    """Eq. 13, the angular block of its Jacobian (14) and the velocity terms of its second derivative.

    Returns
    -------
    phi, bias : tuple of 4 floats
        Phi, and (d/dt Phi_x) x_dot.
    front, back : tuple of 3 tuples of floats
        Columns of Phi_x for alpha, beta (4 each) and gamma (3: its third entry, of z, is zero and left out).
    """
    sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b = trig
    sb_f, cb_f = sincos_small(q[BETA])
    sb_b, cb_b = sincos_small(q[BACK + BETA])
    f, f_a, f_b, df = arm(p.front, sa_f, ca_f, sb_f, cb_f, sg_f, cg_f, v[ALPHA], v[BETA], v[GAMMA])
    b, b_a, b_b, db = arm(p.back, sa_b, ca_b, sb_b, cb_b, sg_b, cg_b, v[BACK + ALPHA], v[BACK + BETA], v[BACK + GAMMA])
    s_d, c_d = sg_b * cg_f - cg_b * sg_f, cg_b * cg_f + sg_b * sg_f  # of delta
    n, dn, (n_fa, n_fb, n_bb, n_d) = perpendicular(q, v, s_d, c_d, sa_f, ca_f, sb_f, cb_f, sb_b, cb_b)
    phi = q[X] + f[0] - q[BACK + X] - b[0], q[Y] + f[1] - q[BACK + Y] - b[1], q[Z] + f[2] - q[BACK + Z] - b[2], n
    bias = df[0] - db[0], df[1] - db[1], df[2] - db[2], dn
    front = (f_a[0], f_a[1], f_a[2], n_fa), (f_b[0], f_b[1], f_b[2], n_fb), (-f[1], f[0], -n_d)
    back = (-b_a[0], -b_a[1], -b_a[2], 0.0), (-b_b[0], -b_b[1], -b_b[2], n_bb), (b[1], -b[0], n_d)
    return phi, bias, front, back


@inlined
def attitude(q):
    """Sines and cosines of roll and yaw of both modules: sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b."""
    sa_f, ca_f = sincos_small(q[ALPHA])
    sa_b, ca_b = sincos_small(q[BACK + ALPHA])
    sg_f, cg_f = sincos(q[GAMMA])
    sg_b, cg_b = sincos(q[BACK + GAMMA])
    return sa_f, ca_f, sg_f, cg_f, sa_b, ca_b, sg_b, cg_b


@kernel
def _evaluate(q, v, p):
    """For arrays that can be written, lest it is compiled twice."""
    return joint(q, v, p, attitude(q))


def articulation(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Yaw and roll of the joint, shape (…, 2): gamma_b − gamma_f and alpha_b − alpha_f.

    Linear in the coordinates, so it serves for coordinates (rad) and velocities (rad/s) alike, both (…, 16).
    """
    return q[..., (BACK + GAMMA, BACK + ALPHA)] - q[..., (GAMMA, ALPHA)]


def articulations(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Yaw and roll of every joint one after the other, shape (…, 2 · joints), as `articulation` of the first."""
    behind, ahead = _joint_places(q.shape[-1])
    moved: NDArray[np.float64] = q[..., behind] - q[..., ahead]
    return moved


@lru_cache
def _joint_places(width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where yaw and roll of the module behind and ahead of each joint stand in a state of this width."""
    ahead = np.array([8 * module + place for module in range(width // 8 - 1) for place in (GAMMA, ALPHA)], dtype=int)
    return ahead + 8, ahead


def constraint(robot: Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phi of eq. 13, shape (4,): the joint's gap in `map` (m) and the fourth row's cosine, at ``q`` (16,)."""
    return np.array(_evaluate(np.array(q), np.zeros(16), packed(params(robot)))[0])


def constraint_jacobian(robot: Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Phi_x of eq. 14, shape (4, 16), at ``q`` (16,)."""
    return constraint_rows(packed(params(robot)), q)[1]


def constraint_rows(p: np.void, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Phi (4,) and Phi_x (4, 16) of a robot whose numbers are at hand as a record."""
    phi, _, front, back = _evaluate(np.array(q), np.zeros(16), p)
    jacobian = np.zeros((4, 16))
    jacobian[:3, X : Z + 1] = np.eye(3)
    jacobian[:3, BACK + X : BACK + Z + 1] = -np.eye(3)
    for (alpha, beta, gamma), module in ((front, 0), (back, BACK)):
        jacobian[:, module + ALPHA] = alpha
        jacobian[:, module + BETA] = beta
        jacobian[[X, Y, 3], module + GAMMA] = gamma
    return np.array(phi), jacobian


def constraint_bias(robot: Robot, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """(d/dt Phi_x) x_dot, shape (4,): minus the right-hand side of eq. 25's lower rows."""
    return np.array(_evaluate(np.array(q), np.array(v), packed(params(robot)))[1])
