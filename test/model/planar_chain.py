"""A robot of any number of modules in the plane, with the joints eliminated: a second derivation, for the tests alone.

It shares no equation with `artibot_sim.model`. Coordinates are the front module's position (x, y), the modules' yaws
gamma_i and the angles of their sides; nothing is constrained.

Derivation
----------
Module i + 1 hangs at a distance a_i behind module i's origin and has the joint b_(i+1) ahead of its own:

    p_(i+1) = p_i − a_i e_i − b_(i+1) e_(i+1),   e = (cos gamma, sin gamma), n = (−sin gamma, cos gamma).

So dp_i/dq' = G_i has columns (1, 0), (0, 1) and, for gamma_k, −w n_k with w = b_k for k = i, a_k + b_k for the modules
between, a_0 for the front one; ddp_i = G_i q'' + c_i with c_i the same sum of w gamma_k'² e_k. Jourdain's principle:

    (sum m_i G_iᵀ G_i + diag(0, 0, J)) q'' = sum G_iᵀ (F_i − m_i c_i) + (0, 0, N).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from model.planar import GRAVITY, TANH_WIDTH, _hermite, _module_wheels, _solve, starred
from numba import njit


@njit(cache=True)
def _accelerations(body, contact, q, v, omega):
    """q'' of (x, y, gammas) and each side's sum of F_l; `body` has a row (m, J, i_x, i_y, a, b) a module."""
    n = len(body)
    A, rhs, S = np.zeros((n + 2, n + 2)), np.zeros(n + 2), np.zeros(2 * n)
    G, c = np.zeros((2, n + 2)), np.zeros(2)
    G[0, 0] = G[1, 1] = 1.0
    for i in range(n):
        if i > 0:
            for k, w in ((i - 1, body[i - 1, 4]), (i, body[i, 5])):
                e, f = np.cos(q[2 + k]), np.sin(q[2 + k])
                G[0, 2 + k] += w * f
                G[1, 2 + k] -= w * e
                c[0] += w * v[2 + k] ** 2 * e
                c[1] += w * v[2 + k] ** 2 * f
        m, J, i_x, i_y = body[i, :4]
        cg, sg, w = np.cos(q[2 + i]), np.sin(q[2 + i]), v[2 + i]
        ux = uy = 0.0
        for k in range(n + 2):
            ux += G[0, k] * v[k]
            uy += G[1, k] * v[k]
        X, Y, N, S[2 * i], S[2 * i + 1] = _module_wheels(
            contact, i_x, i_y, m * GRAVITY / 4, cg * ux + sg * uy, cg * uy - sg * ux, w, omega[2 * i], omega[2 * i + 1]
        )
        Fx, Fy = cg * X - sg * Y - m * c[0], sg * X + cg * Y - m * c[1]
        for k in range(n + 2):
            rhs[k] += G[0, k] * Fx + G[1, k] * Fy
            for j in range(n + 2):
                A[k, j] += m * (G[0, k] * G[0, j] + G[1, k] * G[1, j])
        A[2 + i, 2 + i] += J
        rhs[2 + i] += N
    return _solve(A, rhs), S


@njit(cache=True)
def _rates(body, contact, drive, A, y, wish, eta, M, n):
    """Derivative of y = (x, y, gammas, thetas, and their rates); sides after the front two turn under the torques M."""
    tau, J_m, J_w, u_w, r_w = drive
    c, k = n + 2, 3 * n + 2
    omega = tau * y[k + c :]
    acc, S = _accelerations(body, contact, y[:c], y[k : k + c], omega)
    M_m, theta_dd = np.zeros(2 * n), np.zeros(2 * n)
    for i in range(2 * n):
        M_r = r_w * S[i] + u_w * body[i // 2, 0] * GRAVITY / 2 * np.tanh(omega[i] / TANH_WIDTH)
        J = J_m[i] + J_w * tau[i] ** 2 / eta[i]
        if i < 2:
            theta_dd[i] = wish[2, i] - 2 * A * (y[k + c + i] - wish[1, i]) - A**2 * (y[c + i] - wish[0, i])
            M_m[i] = J * theta_dd[i] + tau[i] / eta[i] * M_r
        else:
            M_m[i] = M[i]
            theta_dd[i] = (M[i] - tau[i] / eta[i] * M_r) / J
    return np.concatenate((y[k:], acc, theta_dd)), M_m


@njit(cache=True)
def _run(body, contact, drive, A, eta_d, eta_r, factors, position, velocity, h, steps_per_knot, steps, y, every, n):
    dt, c, k = h / steps_per_knot, n + 2, 3 * n + 2
    eta, M = eta_d.copy(), np.zeros(2 * n)
    wishes = np.zeros((3, 3, 2))
    rows = np.zeros((steps // every + 1, 1 + k + 2 * n))
    for step in range(steps + 1):
        segment, j = step // steps_per_knot, step % steps_per_knot
        if segment == len(position) - 1:
            segment, j = segment - 1, steps_per_knot
        for stage in range(3):
            for i in range(2):
                wishes[stage, 0, i], wishes[stage, 1, i], wishes[stage, 2, i] = _hermite(
                    position[segment, i], position[segment + 1, i], velocity[segment, i], velocity[segment + 1, i], h,
                    (j + 0.5 * stage) / steps_per_knot,
                )  # fmt: skip
        k1, M_m = _rates(body, contact, drive, A, y, wishes[0], eta, M, n)
        if step % every == 0:
            row = rows[step // every]
            row[0], row[1 : 1 + k], row[1 + k :] = step * dt, y[:k], M_m
        if step == steps:
            break
        theta_dot = y[k + c :].copy()
        k2, _ = _rates(body, contact, drive, A, y + 0.5 * dt * k1, wishes[1], eta, M, n)
        k3, _ = _rates(body, contact, drive, A, y + 0.5 * dt * k2, wishes[1], eta, M, n)
        k4, _ = _rates(body, contact, drive, A, y + dt * k3, wishes[2], eta, M, n)
        y = y + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        for i in range(2 * n):
            eta[i] = eta_d[i] if M_m[i] * theta_dot[i] >= 0.0 else 1.0 / eta_r[i]
        M[:] = factors * (M_m[0] + M_m[1])
    return rows


@dataclass(frozen=True)
class ChainResult:
    """Columns of a run: t (n,), x and y (n, 2), yaws (n, modules), torques of the sides (n, 2 modules)."""

    t: np.ndarray
    position: np.ndarray
    yaws: np.ndarray
    M_m: np.ndarray


def chain_rollout(robot, commands, dt, *, kappa, every):
    """Integrate with RK4 from rest: front motors prescribed, those behind under their share of the torque."""
    modules, drives, n = robot.modules, robot.drives, len(robot.modules)
    body = np.zeros((n, 6))
    for i, module in enumerate(modules):
        behind = module.l if i == 0 else (modules[i + 1].hitch.l if i + 1 < n and i > 0 else 0.0)
        body[i] = *starred(module, robot.wheel), module.i_x, module.i_y, behind, module.l
    kinds = [
        (1.0, 0.0, 1.0, 1.0) if drive is None else (drive.tau, drive.J_m, drive.eta_d, drive.eta_r)
        for drive in drives for _ in range(2)
    ]  # fmt: skip
    tau, J_m, eta_d, eta_r = np.array(kinds).T.copy()
    driven = [i for i in range(1, n) if drives[i] is not None]
    factors = np.zeros(2 * n)
    for i in driven:  # each of them carries as much as the others, at the ground
        wheel_side = (1 / kappa - 1) / len(driven) / tau[0]
        factors[[2 * i, 2 * i + 1]] = 0.5 * wheel_side * drives[i].tau
    c = robot.contact
    contact = (c.k_l, c.k_t, c.mu_s, c.mu_d, c.u_w, robot.wheel.r_w)
    drive = (tau, J_m, 2 * robot.wheel.J_wy, c.u_w, robot.wheel.r_w)
    position, velocity = (np.ascontiguousarray(table[:, :2]) for table in (commands.position, commands.velocity))
    y = np.zeros(2 * (3 * n + 2))
    y[n + 2 : n + 4], y[4 * n + 4 : 4 * n + 6] = position[0], velocity[0]
    per_knot, steps = round(commands.dt / dt), round(commands.duration / dt)
    rows = _run(
        body, contact, drive, robot.control.A_motor, eta_d, eta_r, factors, position, velocity, commands.dt, per_knot,
        steps, y, every, n,
    )  # fmt: skip
    return ChainResult(rows[:, 0], rows[:, 1:3], rows[:, 3 : 3 + n], rows[:, 3 * n + 3 :])
