"""The articulated rover in the plane, with the joint eliminated by hand.

An independent second derivation of the model, for the tests alone. It shares no equation with
`artibot_sim.model`: where the model has sixteen coordinates, four constraints and their multipliers, this has the
front module's position (x, y), the two yaws and the motors' angles, and nothing to constrain.

Derivation
----------
With e = (cos gamma, sin gamma) and n = (-sin gamma, cos gamma) of each module, the joint lies at
p_f - l_f e_f = p_b + l_b e_b, so that

    p_b    = p_f - l_f e_f - l_b e_b
    dp_b   = dp_f - l_f gamma_f' n_f - l_b gamma_b' n_b
    ddp_b  = ddp_f - l_f gamma_f'' n_f - l_b gamma_b'' n_b + c,  c = l_f gamma_f'^2 e_f + l_b gamma_b'^2 e_b.

Jourdain's principle, sum of (m a - F) . d(dp)/dq' + (J gamma'' - N) . d(gamma')/dq' = 0 over both modules for
q' = (x', y', gamma_f', gamma_b'), gives the 4 x 4 system of `_accelerations`. The wheels' spin takes part only
through the contact forces, the motors' rows are eq. 21 alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

GRAVITY = 9.81  # m/s^2, |g| of eq. 12
TANH_WIDTH = 0.02  # rad/s of the wheel, the contract's width for rolling resistance


@njit(cache=True)
def _module_wheels(contact, i_x, i_y, F_n, vx, vy, w, om_r, om_l):
    """Body-frame force and moment of a module's four wheels, and the sum of F_l of its right and left pair."""
    k_l, k_t, mu_s, mu_d, u_w, r_w = contact
    X = Y = N = 0.0
    S_r = S_l = 0.0
    for side in (-1.0, 1.0):
        for end in (1.0, -1.0):
            x_w, y_w = 0.5 * end * i_x, 0.5 * side * i_y
            omega = om_r if side < 0.0 else om_l
            F_l = k_l * (r_w * omega - (vx - w * y_w))
            F_t = -k_t * (vy + w * x_w)
            F_h = np.sqrt(F_l * F_l + F_t * F_t)
            if F_h > mu_s * F_n:
                F_l *= mu_d * F_n / F_h
                F_t *= mu_d * F_n / F_h
            X += F_l
            Y += F_t
            N += (x_w + u_w) * F_t - y_w * F_l
            if side < 0.0:
                S_r += F_l
            else:
                S_l += F_l
    return X, Y, N, S_r, S_l


@njit(cache=True)
def _solve(A, b):
    """Gauss without pivoting, as A is a mass matrix. (LAPACK would take seconds to compile.)"""
    n = len(b)
    for k in range(n):
        for i in range(k + 1, n):
            f = A[i, k] / A[k, k]
            for j in range(k, n):
                A[i, j] -= f * A[k, j]
            b[i] -= f * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]
    return b


@njit(cache=True)
def _accelerations(body, contact, q, v, omega, g):
    """(x'', y'', gamma_f'', gamma_b'') and the four motors' sums of F_l; `g` is (pull x, pull y, normal), m/s^2."""
    m_f, J_f, ix_f, iy_f, l_f, m_b, J_b, ix_b, iy_b, l_b, modules = body
    cf, sf, cb, sb = np.cos(q[2]), np.sin(q[2]), np.cos(q[3]), np.sin(q[3])
    wf, wb = v[2], v[3]
    X, Y, N_f, S_fr, S_fl = _module_wheels(
        contact, ix_f, iy_f, m_f * g[2] / 4, cf * v[0] + sf * v[1], -sf * v[0] + cf * v[1], wf, omega[0], omega[1]
    )
    Fx = cf * X - sf * Y + m_f * g[0]
    Fy = sf * X + cf * Y + m_f * g[1]
    S = np.array([S_fr, S_fl, 0.0, 0.0])
    acc = np.zeros(4)
    if modules == 1.0:
        acc[0], acc[1], acc[2] = Fx / m_f, Fy / m_f, N_f / J_f
        return acc, S
    ux = v[0] + l_f * wf * sf + l_b * wb * sb
    uy = v[1] - l_f * wf * cf - l_b * wb * cb
    X, Y, N_b, S[2], S[3] = _module_wheels(
        contact, ix_b, iy_b, m_b * g[2] / 4, cb * ux + sb * uy, -sb * ux + cb * uy, wb, omega[2], omega[3]
    )
    # what pushes the back module, less the part of m_b ddp_b that needs no acceleration
    Gx = cb * X - sb * Y + m_b * (g[0] - l_f * wf**2 * cf - l_b * wb**2 * cb)
    Gy = sb * X + cb * Y + m_b * (g[1] - l_f * wf**2 * sf - l_b * wb**2 * sb)
    A = np.zeros((4, 4))
    A[0, 0] = A[1, 1] = m_f + m_b
    A[0, 2] = A[2, 0] = m_b * l_f * sf
    A[1, 2] = A[2, 1] = -m_b * l_f * cf
    A[0, 3] = A[3, 0] = m_b * l_b * sb
    A[1, 3] = A[3, 1] = -m_b * l_b * cb
    A[2, 2] = J_f + m_b * l_f**2
    A[3, 3] = J_b + m_b * l_b**2
    A[2, 3] = A[3, 2] = m_b * l_f * l_b * (cf * cb + sf * sb)
    rhs = np.array([Fx + Gx, Fy + Gy, N_f - l_f * (-sf * Gx + cf * Gy), N_b - l_b * (-sb * Gx + cb * Gy)])
    return _solve(A, rhs), S


@njit(cache=True)
def _hermite(p0, p1, d0, d1, h, s):
    """Position, velocity and acceleration of the cubic through two knots a time h apart, at fraction s."""
    a, b = 2 * (p0 - p1) + h * (d0 + d1), 3 * (p1 - p0) - h * (2 * d0 + d1)
    return (
        p0 + s * (h * d0 + s * (b + s * a)),
        d0 + s * (2 * b + 3 * s * a) / h,
        (2 * b + 6 * s * a) / h**2,
    )


@njit(cache=True)
def _rates(body, contact, drive, A, y, wish, eta, M_back, g):
    """Derivative of y = (x, y, gamma_f, gamma_b, theta(4), and their rates), and the motors' torques M_m (eq. 21)."""
    tau, J_m, J_w, u_w, r_w, load = drive
    omega = tau * y[12:16]
    acc, S = _accelerations(body, contact, y[0:4], y[8:12], omega, g)
    M_m, theta_dd = np.zeros(4), np.zeros(4)
    for i in range(4 if body[10] == 2.0 else 2):
        M_r = r_w * S[i] + u_w * load[i] * np.tanh(omega[i] / TANH_WIDTH)
        J = J_m[i] + J_w * tau[i] ** 2 / eta[i]
        if i < 2:
            theta_dd[i] = wish[2, i] - 2 * A * (y[12 + i] - wish[1, i]) - A**2 * (y[4 + i] - wish[0, i])
            M_m[i] = J * theta_dd[i] + tau[i] / eta[i] * M_r
        else:
            M_m[i] = M_back[i - 2]
            theta_dd[i] = (M_m[i] - tau[i] / eta[i] * M_r) / J
    return np.concatenate((y[8:16], acc, theta_dd)), M_m


@njit(cache=True)
def _wish(position, velocity, h, segment, s, out):
    for i in range(2):
        out[0, i], out[1, i], out[2, i] = _hermite(
            position[segment, i], position[segment + 1, i], velocity[segment, i], velocity[segment + 1, i], h, s
        )


@njit(cache=True)
def _run(body, contact, drive, A, eta_d, eta_r, share, position, velocity, h, steps_per_knot, n, y, g, every):
    dt = h / steps_per_knot
    eta, M_back = eta_d.copy(), np.zeros(2)
    wish = np.zeros((3, 2))
    rows = np.zeros((n // every + 1, 25))
    for k in range(n + 1):
        segment, j = k // steps_per_knot, k % steps_per_knot
        if segment == position.shape[0] - 1:  # the last instant belongs to the last segment's end
            segment, j = segment - 1, steps_per_knot
        _wish(position, velocity, h, segment, j / steps_per_knot, wish)
        k1, M_m = _rates(body, contact, drive, A, y, wish, eta, M_back, g)
        theta_dot = y[12:16].copy()
        if k % every == 0:
            row = rows[k // every]
            row[0], row[1:17], row[17:21], row[21:25] = k * dt, y, M_m, eta
        if k == n:
            break
        _wish(position, velocity, h, segment, (j + 0.5) / steps_per_knot, wish)
        k2, _ = _rates(body, contact, drive, A, y + 0.5 * dt * k1, wish, eta, M_back, g)
        k3, _ = _rates(body, contact, drive, A, y + 0.5 * dt * k2, wish, eta, M_back, g)
        _wish(position, velocity, h, segment, (j + 1.0) / steps_per_knot, wish)
        k4, _ = _rates(body, contact, drive, A, y + dt * k3, wish, eta, M_back, g)
        y = y + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        # Fig. 7: the next step runs on this one's power flow and front torques, both as they were at its start
        for i in range(4):
            eta[i] = eta_d[i] if M_m[i] * theta_dot[i] >= 0.0 else 1.0 / eta_r[i]
        M_back[:] = 0.5 * share * (M_m[0] + M_m[1])
    return rows


@dataclass(frozen=True)
class PlanarResult:
    """Columns of a planar run: t (n,), q and v (n, 8) = x, y, gamma_f, gamma_b, theta (4); M_m and eta (n, 4)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    M_m: np.ndarray
    eta: np.ndarray


def starred(module, wheel):
    """m*, J_z* of a module with its wheels (eq. 9, four wheels at half the spacings)."""
    return module.m + 4 * wheel.m_w, module.J_z + 4 * wheel.J_wx + wheel.m_w * (module.i_x**2 + module.i_y**2)


def _normal(pull):
    return np.sqrt(GRAVITY**2 - pull[0] ** 2 - pull[1] ** 2)


def parameters(robot, pull=(0.0, 0.0)):
    """What the kernel needs of a robot: body, contact, drive, eta_d, eta_r."""
    wheel, c = robot.wheel, robot.contact
    m_f, J_f = starred(robot.front, wheel)
    body = [m_f, J_f, robot.front.i_x, robot.front.i_y, robot.front.l, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0]
    drives, m_b = [robot.drive.front] * 4, 0.0
    if robot.back is not None:
        m_b, J_b = starred(robot.back, wheel)
        body[5:] = [m_b, J_b, robot.back.i_x, robot.back.i_y, robot.back.l, 2.0]
        drives = [robot.drive.front] * 2 + [robot.drive.back] * 2
    tau, J_m, eta_d, eta_r = (np.array([getattr(d, k) for d in drives]) for k in ("tau", "J_m", "eta_d", "eta_r"))
    load = _normal(pull) / 2 * np.array([m_f, m_f, m_b, m_b])  # F_n of a motor's two wheels
    contact = (c.k_l, c.k_t, c.mu_s, c.mu_d, c.u_w, wheel.r_w)
    drive = (tau, J_m, 2 * wheel.J_wy, c.u_w, wheel.r_w, load)
    return tuple(map(float, body)), contact, drive, eta_d, eta_r


def linearised(robot, speed, eta):
    """Eigenvalues (1/s) of small motions about driving straight on at `speed` (m/s), wheels holding, eta (4,) fixed."""
    body, contact, drive, _, _ = parameters(robot)
    omega = speed / robot.wheel.r_w / drive[0]
    y = np.concatenate([np.zeros(8), [speed, 0, 0, 0], omega])
    wish = np.vstack([np.zeros(2), omega[:2], np.zeros(2)])

    def rates(y):
        g = np.array([0.0, 0.0, GRAVITY])
        return _rates(body, contact, drive, robot.control.A_motor, y, wish, np.asarray(eta, float), np.zeros(2), g)[0]

    h = 1e-6
    return np.linalg.eigvals(np.column_stack([(rates(y + h * e) - rates(y - h * e)) / (2 * h) for e in np.eye(16)]))


def planar_rollout(robot, commands, dt=1e-3, *, kappa=None, pose=(0.0, 0.0, 0.0), duration=None, every=10, pull=(0, 0)):
    """Integrate the planar rover with RK4: front motors prescribed, back motors under eq. 30, start at rest.

    Parameters
    ----------
    robot : artibot_sim.model.Robot
    commands : artibot_sim.model.Commands
        Its knots of position and velocity (motor side) are read as cubic Hermite segments.
    dt : float
        Step (s); the knots' spacing must be a whole number of steps.
    pull : (2,)
        g sin(grade) as a vector in the map (m/s^2).
    """
    body, contact, drive, eta_d, eta_r = parameters(robot, pull)
    kappa = robot.control.kappa if kappa is None else kappa
    share = drive[0][2] / drive[0][0] * (1 / kappa - 1) if robot.back is not None else 0.0
    position = np.ascontiguousarray(commands.position[:, :2], dtype=float)
    velocity = np.ascontiguousarray(commands.velocity[:, :2], dtype=float)
    steps_per_knot = round(commands.dt / dt)
    assert abs(steps_per_knot * dt - commands.dt) < 1e-12, "knots must lie on steps"
    duration = commands.dt * (len(position) - 1) if duration is None else duration
    y = np.zeros(16)
    x, y_map, yaw = pose
    y[0:4] = x, y_map, yaw, yaw
    y[4:6], y[12:14] = position[0], velocity[0]
    rows = _run(
        body, contact, drive, robot.control.A_motor, eta_d, eta_r, share, position, velocity,
        commands.dt, steps_per_knot, round(duration / dt), y, np.array([*pull, _normal(pull)]), every,
    )  # fmt: skip
    return PlanarResult(rows[:, 0], rows[:, 1:9], rows[:, 9:17], rows[:, 17:21], rows[:, 21:25])
