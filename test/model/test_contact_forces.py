"""Generalised contact forces (eqs 17-20) by virtual work: the positions of eq. 19 differentiated by complex steps.

Nothing of the model's algebra is used: p_*(x) = p + R_z R_x {p} is written down, its virtual displacement for each
coordinate comes from a complex step (exact to rounding), and its velocity for eqs 15 from another.
"""

from __future__ import annotations

import numpy as np
from model.helpers import GRAVITY

from artibot_sim.model import WHEELS, initial_state
from artibot_sim.model.reference.contact import contact_forces

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
    """Per wheel (F_l, F_t, F_n) and its generalised force (16,)."""
    c = robot.contact
    forces, per_wheel = {}, {}
    for wheel in WHEELS:
        module, side, end = wheel.split("_")
        k = 0 if module == "front" else 1
        body = (robot.front, robot.back)[k]
        drive = (robot.drive.front, robot.drive.back)[k]
        pose, rates = q[8 * k : 8 * k + 6], v[8 * k : 8 * k + 6]
        omega = drive.tau * v[8 * k + (6 if side == "right" else 7)]
        x_w, y_w = (0.5 if end == "front" else -0.5) * body.i_x, (0.5 if side == "left" else -0.5) * body.i_y
        centre = np.array([x_w, y_w, 0.0])
        R = attitude(pose)
        slip = R.T @ velocity(pose, rates, centre)
        # eq. 15 with free radii for which the wheels stand at r_w under their share, so that both modules are level
        share = (body.m + 4 * robot.wheel.m_w) * GRAVITY / 4 * np.cos(robot.effects.get("slope", {}).get("grade", 0.0))
        F_n = max(share + c.k_n * (robot.wheel.r_w - position(pose, centre).real[2]), 0.0)
        F_l, F_t = saturated(c, c.k_l * (robot.wheel.r_w * omega - slip[0]), -c.k_t * slip[1], F_n)
        forces[wheel] = F_l, F_t, F_n
        ahead = centre + [c.u_w, 0, 0]
        Q = np.zeros(16)
        Q[8 * k : 8 * k + 6] = virtual_displacements(pose, ahead).T @ R @ np.array([F_l, F_t, F_n])
        per_wheel[wheel] = Q
    return forces, per_wheel


def states(robot, n, seed=7, speed=0.02, roll=0.05):
    """Random states near driving ones: some wheels hold, some slide, some hang in the air."""
    rng = np.random.default_rng(seed)
    start = initial_state(robot)
    for _ in range(n):
        q, v = start.q.copy(), np.zeros(16)
        for k in (0, 8):
            q[k : k + 3] += rng.uniform(-1, 1, 3) * [5, 5, 8e-3]
            q[k + 3 : k + 6] = rng.uniform(-1, 1, 3) * [roll * 0.1, roll, 3]
            v[k : k + 2] = rng.uniform(-1, 1, 2)
            v[k + 2 : k + 6] = rng.uniform(-0.2, 0.2, 4)
            # wheels turn about as fast as the ground passes, so that both branches of eq. 16 occur
            ahead = v[k] * np.cos(q[k + 5]) + v[k + 1] * np.sin(q[k + 5])
            v[k : k + 2] = ahead * np.cos(q[k + 5]), ahead * np.sin(q[k + 5])
            tau = (robot.drive.front, robot.drive.back)[k // 8].tau
            v[k + 6 : k + 8] = (ahead + speed * rng.uniform(-4, 4, 2)) / (robot.wheel.r_w * tau)
        yield q, v


def test_every_wheels_forces_do_virtual_work(agriq):
    slides = lifted = 0
    for q, v in states(agriq, 60):
        forces, per_wheel = expected(agriq, q, v)
        found = contact_forces(agriq, q, v)
        for i, wheel in enumerate(WHEELS):
            F_l, F_t, F_n = forces[wheel]
            scale = 1.0 + abs(F_l) + abs(F_t) + abs(F_n)
            for name, actual, wanted in (
                ("F_l", found.F_l[i], F_l), ("F_t", found.F_t[i], F_t), ("F_n", found.F_n[i], F_n),
            ):  # fmt: skip
                assert abs(actual - wanted) < 1e-11 * scale, f"{name} of {wheel}: {actual}, expected {wanted}"
            np.testing.assert_allclose(found.Q[i], per_wheel[wheel], atol=1e-11 * scale, err_msg=f"Q of {wheel}")
            lifted += F_n == 0.0
            slides += F_n > 0 and np.isclose(np.hypot(F_l, F_t), agriq.contact.mu_d * F_n)
    assert 50 < slides < 400, f"{slides} of 480 wheels slide: the states must show both branches of eq. 16"
    assert 0 < lifted < 240


def test_single_module_has_four_wheels(husky):
    (q, v) = initial_state(husky).q, np.zeros(16)
    v[[0, 1, 5, 6, 7]] = 0.3, 0.02, 0.1, 2.0, 1.9
    found = contact_forces(husky, q, v)
    assert found.Q.shape == (4, 16)
    assert not found.Q[:, 8:].any()


def test_moment_arm_is_u_w_ahead_of_the_wheel_also_in_reverse(agriq):
    """A module that slips sideways only: its moment is u_w times the lateral force, whichever way it drives."""
    for forward in (0.5, -0.5):
        q, v = initial_state(agriq).q.copy(), np.zeros(16)
        v[0], v[1] = forward, 0.01
        v[[6, 7]] = forward / (agriq.wheel.r_w * agriq.drive.front.tau)
        found = contact_forces(agriq, q, v)
        np.testing.assert_allclose(found.F_t[:4], -agriq.contact.k_t * 0.01, rtol=1e-12)
        moment = found.Q[:4, 5].sum()
        np.testing.assert_allclose(moment, agriq.contact.u_w * found.F_t[:4].sum(), rtol=1e-9)
