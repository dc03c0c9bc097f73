"""Generalised contact forces (eqs 17-20) by virtual work: the positions of eq. 19 differentiated by complex steps.

Nothing of the model's algebra is used: p_*(x) = p + R_z R_x {p} is written down, its virtual displacement for each
coordinate comes from a complex step (exact to rounding), and its velocity for eqs 15 from another.
"""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.model import MOTORS, WHEELS, initial_state
from artibot_sim.model.reference import contact_forces

COORDINATES = ("x", "y", "z", "alpha", "beta", "gamma")
STEP = 1e-30


def position(pose, local):
    """p_* of eq. 19 for a point `local` of the carriers: pitch disregarded, complex-safe."""
    x, y, z, alpha, _, gamma = pose
    ca, sa, cg, sg = np.cos(alpha), np.sin(alpha), np.cos(gamma), np.sin(gamma)
    return np.array([x, y, z]) + rotation(ca, sa, cg, sg) @ np.asarray(local, dtype=complex)


def rotation(ca, sa, cg, sg):
    R_z = np.array([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
    R_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    return R_z @ R_x


def attitude(pose):
    return rotation(np.cos(pose[3]), np.sin(pose[3]), np.cos(pose[5]), np.sin(pose[5])).real


def virtual_displacements(pose, local):
    """d p_* / d x_i, shape (3, 6)."""
    columns = []
    for i in range(6):
        moved = np.array(pose, dtype=complex)
        moved[i] += 1j * STEP
        columns.append(position(moved, local).imag / STEP)
    return np.array(columns).T


def velocity(pose, rates, local):
    return position(np.asarray(pose) + 1j * STEP * np.asarray(rates), local).imag / STEP


def saturated(contact, F_l, F_t, F_n):
    """Eq. 16."""
    F_h = np.hypot(F_l, F_t)
    scale = contact.mu_d * F_n / F_h if F_h > contact.mu_s * F_n else 1.0
    return scale * F_l, scale * F_t


def expected(robot, q, v):
    """Per wheel (F_l, F_t, F_n) and per module the generalised force (6,)."""
    c = robot.contact
    forces, Q = {}, np.zeros((2, 6))
    for wheel in WHEELS:
        module, side, end = wheel.split("_")
        k = 0 if module == "front" else 1
        body = (robot.front, robot.back)[k]
        drive = (robot.drive.front, robot.drive.back)[k]
        pose, rates = q[8 * k : 8 * k + 6], v[8 * k : 8 * k + 6]
        omega = drive.tau * v[8 * k + (6 if side == "right" else 7)]
        centre = np.array([(0.5 if end == "front" else -0.5) * body.i_x, (0.5 if side == "left" else -0.5) * body.i_y, 0])
        R = attitude(pose)
        slip = R.T @ velocity(pose, rates, centre)
        F_n = c.k_n * (robot.wheel.r_w - position(pose, centre).real[2])
        F_l, F_t = saturated(c, c.k_l * (robot.wheel.r_w * omega - slip[0]), -c.k_t * slip[1], F_n)
        forces[wheel] = F_l, F_t, F_n
        ahead = centre + [c.u_w, 0, 0]
        Q[k] += virtual_displacements(pose, ahead).T @ R @ np.array([F_l, F_t, F_n])
    return forces, Q


def states(robot, n, seed=7, speed=0.02, roll=0.05):
    """Random states near driving ones: some wheels hold, some slide."""
    rng = np.random.default_rng(seed)
    start = initial_state(robot)
    for _ in range(n):
        q, v = start.q.copy(), np.zeros(16)
        for k in (0, 8):
            q[k : k + 3] += rng.uniform(-1, 1, 3) * [5, 5, 1e-3]
            q[k + 3 : k + 6] = rng.uniform(-1, 1, 3) * [roll * 0.1, roll, 3]
            v[k : k + 2] = rng.uniform(-1, 1, 2)
            v[k + 2 : k + 6] = rng.uniform(-0.2, 0.2, 4)
            # wheels turn about as fast as the ground passes, so that both branches of eq. 16 occur
            ahead = v[k] * np.cos(q[k + 5]) + v[k + 1] * np.sin(q[k + 5])
            v[k : k + 2] = ahead * np.cos(q[k + 5]), ahead * np.sin(q[k + 5])
            tau = (robot.drive.front, robot.drive.back)[k // 8].tau
            v[k + 6 : k + 8] = (ahead + speed * rng.uniform(-4, 4, 2)) / (robot.wheel.r_w * tau)
        yield q, v
