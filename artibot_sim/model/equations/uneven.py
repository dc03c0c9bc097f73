"""Wheels on uneven ground: eqs 15 to 20 where the ground has a height, a slope and a soil of its own under each wheel.

The ground is a surface (`ground.raster.Surface`) on which the lowest points of the wheels move. Eq. 15's spring stands
upright under each wheel's centre and pushes along the surface's normal, so that its force is the gradient of the energy
that it stores. Forces along and across a wheel lie in the ground's plane. Where the pitch of a module reaches its
wheels (`Params.pitching`), these are fixed to it; else the two of a side sit on a rocker without mass, which tilts with
the ground so that both sink in alike. Slip, friction and what effects make of them are those of `contact.pair_forces`.

Positions and directions are given in a module's yaw frame. This is compiled for uneven ground alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from artibot_sim.model.effects import hooks
from artibot_sim.model.equations.contact import PairSoil, WheelPair, unloaded_radius
from artibot_sim.model.equations.kinematics import sincos_small
from artibot_sim.model.ground.raster import BEYOND, CELL, FACE, NODE, STEEPEST, WALL
from artibot_sim.model.kernels.compilation import called, inlined
from artibot_sim.model.kernels.layout import ALPHA, BETA, GAMMA, Q_C, X, Y, Z


class Attitude(NamedTuple):
    """Sines and cosines of a module's roll, of its pitch as far as wheels feel it, and of its yaw."""

    s_a: float
    c_a: float
    s_b: float
    c_b: float
    s_g: float
    c_g: float


class Footing(NamedTuple):
    """How a wheel stands.

    r_x, r_y, r_z lead from the module's origin to its centre (m). along and across are unit vectors in the ground's
    plane; slope_x, slope_y how steeply the ground rises ahead and to the left. upward is the spring's force (N), sunk
    how far it is pressed (m) and sinking how fast (m/s).
    """

    r_x: float
    r_y: float
    r_z: float
    along: tuple[float, float, float]
    across: tuple[float, float, float]
    slope_x: float
    slope_y: float
    upward: float
    sunk: float
    sinking: float


class Side(NamedTuple):
    """The two wheels of a motor: what they meet, the soil under them, and how the front one and the back one stand."""

    pair: WheelPair
    soil: PairSoil
    front: Footing
    back: Footing


class GroundPoint(NamedTuple):
    """The ground at a point: height (m), slopes in the yaw frame, factors of stiffness and friction; where in `map`."""

    height: float
    slope_x: float
    slope_y: float
    k: float
    mu: float
    x: float
    y: float


@inlined
def note(ground, what, x, y):
    """Write down what ends the run, unless something has already."""
    if ground.found[0] == 0.0:
        ground.found[0], ground.found[1], ground.found[2] = what, x, y


@inlined
def sampled(ground, wheel, x, y):
    """Height (m), its slopes along x and y of `map`, factors of stiffness and friction at (x, y), see `raster.sample`.

    Notes where a point lies beyond the raster, and where a wheel meets a wall. A wheel stays in a cell for many steps,
    so each by its number keeps the polynomials of the one that it is in.
    """
    cells, o = ground.cells, CELL * wheel
    along, across = (x - ground.x) * ground.per_metre, (y - ground.y) * ground.per_metre
    a, b = along - cells[o], across - cells[o + 1]
    if not (a >= 0.0 and a < 1.0 and b >= 0.0 and b < 1.0):  # nor in the first one, which is NaN
        a, b = enter(ground, o, along, across, x, y)
    if cells[o + 26] > 0.0 and cells[o + 27 + (2 if b >= 0.5 else 0) + (1 if a >= 0.5 else 0)] > 0.5:
        note(ground, WALL, x, y)
    twice, thrice = 2.0 * a, 3.0 * a * a
    h0, s0 = cubic(cells, o + 2, a), slope_of(cells, o + 2, twice, thrice)
    h1, s1 = cubic(cells, o + 6, a), slope_of(cells, o + 6, twice, thrice)
    h2, s2 = cubic(cells, o + 10, a), slope_of(cells, o + 10, twice, thrice)
    h3, s3 = cubic(cells, o + 14, a), slope_of(cells, o + 14, twice, thrice)
    height = h0 + b * (h1 + b * (h2 + b * h3))
    h_x = (s0 + b * (s1 + b * (s2 + b * s3))) * ground.per_metre
    h_y = (h1 + b * (2.0 * h2 + 3.0 * b * h3)) * ground.per_metre
    return height, h_x, h_y, bilinear(cells, o + 18, a, b), bilinear(cells, o + 22, a, b)


@inlined
def cubic(c, i, s):
    """Value at `s` of the cubic whose coefficients begin at `i`."""
    return c[i] + s * (c[i + 1] + s * (c[i + 2] + s * c[i + 3]))


@inlined
def slope_of(c, i, twice, thrice):
    """Its derivative; `twice` is 2 s, `thrice` 3 s²."""
    return c[i + 1] + (twice * c[i + 2] + thrice * c[i + 3])


@inlined
def bilinear(c, i, a, b):
    """Value at (a, b) of what is linear in both."""
    return (c[i] + a * c[i + 1]) + b * (c[i + 2] + a * c[i + 3])


@called
def enter(ground, o, along, across, x, y):
    """A wheel enters a cell: its polynomials from `o` on; where in it the wheel is, from 0 to 1 along and across."""
    nodes, cells, nx, ny = ground.nodes, ground.cells, ground.nx, ground.ny
    i, j = math.floor(along), math.floor(across)
    if (i < 0 or j < 0 or i > nx - 2 or j > ny - 2) and not ground.periodic:
        if not (along >= 0.0 and across >= 0.0 and along <= nx - 1.0 and across <= ny - 1.0):
            note(ground, BEYOND, x, y)
        along, across = min(max(along, 0.0), nx - 1.0), min(max(across, 0.0), ny - 1.0)
        i, j = min(max(i, 0), nx - 2), min(max(j, 0), ny - 2)
    cells[o], cells[o + 1] = i, j
    a, b = along - i, across - j
    i, j = i % nx, j % ny
    i_1, j_1 = (i + 1) % nx, (j + 1) % ny
    n00, n01 = NODE * (j * nx + i), NODE * (j * nx + i_1)
    n10, n11 = NODE * (j_1 * nx + i), NODE * (j_1 * nx + i_1)
    c = o + 2
    cubic_into(cells, c, nodes[n00], nodes[n00 + 1], nodes[n01], nodes[n01 + 1])
    cubic_into(cells, c + 4, nodes[n00 + 2], nodes[n00 + 3], nodes[n01 + 2], nodes[n01 + 3])
    cubic_into(cells, c + 8, nodes[n10], nodes[n10 + 1], nodes[n11], nodes[n11 + 1])
    cubic_into(cells, c + 12, nodes[n10 + 2], nodes[n10 + 3], nodes[n11 + 2], nodes[n11 + 3])
    for k in range(c, c + 4):  # across, the cubics between these
        near, rate, far, rate_far = cells[k], cells[k + 4], cells[k + 8], cells[k + 12]
        cells[k + 8], cells[k + 12] = bend(near, rate, far, rate_far)
    for place in range(2):
        k, m = c + 16 + 4 * place, 4 + place
        near, far = nodes[n00 + m], nodes[n10 + m]
        rise, rise_far = nodes[n01 + m] - near, nodes[n11 + m] - far
        cells[k], cells[k + 1], cells[k + 2], cells[k + 3] = near, rise, far - near, rise_far - rise
    walls = nodes[n00 + 6], nodes[n01 + 6], nodes[n10 + 6], nodes[n11 + 6]
    cells[o + 26] = walls[0] + walls[1] + walls[2] + walls[3]
    cells[o + 27], cells[o + 28], cells[o + 29], cells[o + 30] = walls
    return a, b


@inlined
def bend(near, rate, far, rate_far):
    """Third and fourth coefficient of Hermite's cubic on [0, 1]; the first are value and rate at the near end."""
    rise = far - near
    return 3.0 * rise - 2.0 * rate - rate_far, rate + rate_far - 2.0 * rise


@inlined
def cubic_into(c, i, near, rate, far, rate_far):
    """Coefficients of Hermite's cubic on [0, 1], from `i` on."""
    c[i], c[i + 1] = near, rate
    c[i + 2], c[i + 3] = bend(near, rate, far, rate_far)


@inlined
def attitude_of(p, s_a, c_a, beta, s_g, c_g):
    """Of a module whose pitch is `beta` (rad)."""
    s_b, c_b = sincos_small(p.pitching * beta)
    return Attitude(s_a, c_a, s_b, c_b, s_g, c_g)


@inlined
def spot_under(ground, wheel, at, x, y, r_x, r_y):
    """The ground under a wheel that is (r_x, r_y) from a module's origin, which is at (x, y) in `map`."""
    out_x, out_y = x + at.c_g * r_x - at.s_g * r_y, y + at.s_g * r_x + at.c_g * r_y
    height, h_x, h_y, k, mu = sampled(ground, wheel, out_x, out_y)
    return GroundPoint(height, at.c_g * h_x + at.s_g * h_y, at.c_g * h_y - at.s_g * h_x, k, mu, out_x, out_y)


@inlined
def centre_of(body, at, end, side):
    """From a module's origin to the centre of the wheel at `end` (1 in front) and `side` (1 left), before it rocks."""
    out_x, out_y = end * body.half_x, side * body.half_y
    return (
        at.c_b * out_x + at.s_b * at.s_a * out_y,
        at.c_a * out_y,
        at.c_b * at.s_a * out_y - at.s_b * out_x,
    )


@inlined
def velocity_of(p, at, r, v_x, v_y, v_z, alpha_dot, beta_dot, gamma_dot):
    """Of a wheel's centre, before it rocks (eq. 19)."""
    r_x, r_y, r_z = r
    tan = alpha_dot * r_y
    pitch = p.pitching * beta_dot
    return (
        v_x - gamma_dot * r_y + at.s_b * tan + pitch * r_z,
        v_y + gamma_dot * r_x - alpha_dot * rolled(at, r),
        v_z + at.c_b * tan - pitch * r_x,
    )


@inlined
def rolled(at, r):
    """How far a wheel's centre is above its module's plane before that pitches, m."""
    return at.c_b * r[2] + at.s_b * r[0]


@inlined
def wheel_on_ground(body, p, fx, ground, which, at, spot, r, z, u):
    """A wheel whose centre is `r` from the origin, at height `z` (m), and moves at `u` (m/s); and its F_n (N).

    `which` are its module, end and side.
    """
    r_0 = body.r_0
    if fx is not None:
        r_0 = unloaded_radius(body, p, fx, which[0], which[1], which[2])
    g_x, g_y = spot.slope_x, spot.slope_y
    sunk, sinking = r_0 + spot.height - z, g_x * u[0] + g_y * u[1] - u[2]
    upward = max(p.k_n * sunk + p.c_n * sinking, 0.0)
    rise2 = g_x * g_x + g_y * g_y
    if rise2 > STEEPEST * STEEPEST and sunk > 0.0:
        note(ground, FACE, spot.x, spot.y)
    stretch = math.sqrt(1.0 + rise2)
    steep = 1.0 / stretch
    a_x, a_y, a_z = at.s_b * at.s_a, at.c_a, at.c_b * at.s_a  # the axle; across it and in the ground's plane is ahead
    l_x, l_y, l_z = a_y + a_z * g_y, -a_z * g_x - a_x, a_y * g_x - a_x * g_y
    scale = 1.0 / math.sqrt(l_x * l_x + l_y * l_y + l_z * l_z)
    l_x, l_y, l_z = scale * l_x, scale * l_y, scale * l_z
    across = steep * (-g_y * l_z - l_y), steep * (l_x + g_x * l_z), steep * (g_y * l_x - g_x * l_y)
    return Footing(r[0], r[1], r[2], (l_x, l_y, l_z), across, g_x, g_y, upward, sunk, sinking), upward * stretch


@inlined
def dot(a, b):
    """Of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def standing(body, p, fx, ground, module, side, at, x, y, z, rates):
    """The two wheels on one `side` (1 left, −1 right) of a module whose origin is at (x, y, z) in `map` (`Side`).

    `rates` are the module's velocity in its yaw frame, and those of roll, pitch and yaw.
    """
    v_x, v_y, v_z, alpha_dot, beta_dot, gamma_dot = rates
    r_f, r_b = centre_of(body, at, 1.0, side), centre_of(body, at, -1.0, side)
    wheel = 4 * module + (2 if side > 0.0 else 0)
    on_f = spot_under(ground, wheel, at, x, y, r_f[0], r_f[1])
    on_b = spot_under(ground, wheel + 1, at, x, y, r_b[0], r_b[1])
    u_f = velocity_of(p, at, r_f, v_x, v_y, v_z, alpha_dot, beta_dot, gamma_dot)
    u_b = velocity_of(p, at, r_b, v_x, v_y, v_z, alpha_dot, beta_dot, gamma_dot)
    rock = 0.5 * (1.0 - p.pitching)
    tilt = rock * (on_f.height - on_b.height)
    turn = rock * (
        on_f.slope_x * u_f[0] + on_f.slope_y * u_f[1] - on_b.slope_x * u_b[0] - on_b.slope_y * u_b[1]
    )  # fmt: skip
    u_f, u_b = (u_f[0], u_f[1], u_f[2] + turn), (u_b[0], u_b[1], u_b[2] - turn)
    front, F_nf = wheel_on_ground(body, p, fx, ground, (module, 1.0, side), at, on_f, r_f, z + r_f[2] + tilt, u_f)
    back, F_nb = wheel_on_ground(body, p, fx, ground, (module, -1.0, side), at, on_b, r_b, z + r_b[2] - tilt, u_b)
    pair = WheelPair(
        dot(u_f, front.along), dot(u_b, back.along), dot(u_f, front.across), dot(u_b, back.across), F_nf, F_nb,
        F_nf, F_nb,
    )  # fmt: skip
    return Side(pair, soil_on(body, p, fx, pair, on_f, on_b), front, back)


@inlined
def soil_on(body, p, fx, pair, on_f, on_b):
    """The soil under the two wheels of a motor: the robot's by the ground's factors, and what effects make of it."""
    mu_f, mu_b, k, u_f, u_b = on_f.mu, on_b.mu, 1.0, p.u_w, p.u_w
    if fx is not None:
        k = hooks.soil(fx)
        mu_f, mu_b = k * mu_f * hooks.grip(fx, on_f.x, on_f.y), k * mu_b * hooks.grip(fx, on_b.x, on_b.y)
        u_f = p.u_w * hooks.lead(fx, pair.p_xf, pair.p_yf)
        u_b = p.u_w * hooks.lead(fx, pair.p_xb, pair.p_yb)
    return PairSoil(
        u_f, u_b, k * body.k_l, k * body.k_t, mu_f * body.mu_s, mu_f * body.mu_d, mu_b * body.mu_s, mu_b * body.mu_d,
        p.load, 0.5 * (on_f.x + on_b.x), 0.5 * (on_f.y + on_b.y), 0.5 * (on_f.x - on_b.x), 0.5 * (on_f.y - on_b.y),
        on_f.k, on_b.k,
    )  # fmt: skip


@inlined
def pushed(foot, F_l, F_t):
    """Force of the ground on a wheel whose forces along and across are F_l and F_t, in the yaw frame, N."""
    return (
        F_l * foot.along[0] + F_t * foot.across[0] - foot.upward * foot.slope_x,
        F_l * foot.along[1] + F_t * foot.across[1] - foot.upward * foot.slope_y,
        F_l * foot.along[2] + F_t * foot.across[2] + foot.upward,
    )


@inlined
def on_module(p, at, foot, force, rocked):
    """Generalised force of a wheel on a module in its yaw frame: x, y, z, alpha, gamma, beta (eq. 18).

    `rocked` (N) is what the other wheel of a rocker has it lift.
    """
    r = foot.r_x, foot.r_y, foot.r_z
    f_x, f_y = force[0] + rocked * foot.slope_x, force[1] + rocked * foot.slope_y
    f_z = force[2]
    return (
        f_x,
        f_y,
        f_z,
        r[1] * (at.s_b * f_x + at.c_b * f_z) - rolled(at, r) * f_y,
        r[0] * f_y - r[1] * f_x,
        p.pitching * (r[2] * f_x - r[0] * f_z),
    )


@inlined
def lever_below(p, fx, at, force):
    """With effects: moments on alpha, gamma and beta of a force that acts below the wheels' centres, N m."""
    down = hooks.height(fx)
    f_x, f_y, f_z = force
    return (
        down * (at.s_a * (at.s_b * f_x + at.c_b * f_z) + at.c_a * f_y),
        -down * (at.s_a * f_x + at.s_b * at.c_a * f_y),
        p.pitching * down * at.c_a * (at.s_b * f_z - at.c_b * f_x),
    )


@inlined
def add6(a, b):
    """Sum of two tuples of six."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]


@inlined
def side_forces(p, fx, at, side, forces):
    """Generalised forces of the two wheels of a motor in the yaw frame, see `on_module`; `forces` is a PairForces."""
    on_f, on_b = pushed(side.front, forces.F_lf, forces.F_tf), pushed(side.back, forces.F_lb, forces.F_tb)
    lifted = 0.5 * (1.0 - p.pitching) * (on_f[2] - on_b[2])
    total = add6(on_module(p, at, side.front, on_f, lifted), on_module(p, at, side.back, on_b, -lifted))
    ahead = at.c_b * (forces.u_f * on_f[1] + forces.u_b * on_b[1])  # eq. 20
    m_a, m_g, m_b = 0.0, ahead, 0.0
    if fx is not None:
        low = lever_below(p, fx, at, (on_f[0] + on_b[0], on_f[1] + on_b[1], on_f[2] + on_b[2]))
        m_a, m_g, m_b = low[0], ahead + low[1], low[2]
    return add6(total, (0.0, 0.0, 0.0, m_a, m_g, m_b))


@inlined
def generalised_forces(p, fx, at, sides, right, left, module, w):
    """The wheels' forces on a module's x, y, z, alpha, gamma and, at the end, beta (eqs 17, 18), also into the row."""
    f_x, f_y, z, m_a, m_g, m_b = add6(side_forces(p, fx, at, sides[0], right), side_forces(p, fx, at, sides[1], left))
    x, y = at.c_g * f_x - at.s_g * f_y, at.s_g * f_x + at.c_g * f_y
    o = Q_C + 6 * module
    w[o], w[o + 1], w[o + 2], w[o + 3], w[o + 4], w[o + 5] = x, y, z, m_a, m_b, m_g
    return x, y, z, m_a, m_g, m_b


@inlined
def sides_of(body, p, fx, ground, module, at, q, v, b):
    """Both sides (`Side`), right and left, of a module whose coordinates begin at `b`."""
    v_x, v_y = at.c_g * v[b + X] + at.s_g * v[b + Y], at.c_g * v[b + Y] - at.s_g * v[b + X]
    rates = v_x, v_y, v[b + Z], v[b + ALPHA], v[b + BETA], v[b + GAMMA]
    x, y, z = q[b + X], q[b + Y], q[b + Z]
    return (
        standing(body, p, fx, ground, module, -1.0, at, x, y, z, rates),
        standing(body, p, fx, ground, module, 1.0, at, x, y, z, rates),
    )
