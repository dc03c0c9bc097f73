"""The compiled integration loop: the only place where speed beats looks."""

from __future__ import annotations

import math

import numpy as np

from artibot_sim.model.compiled import inlined, kernel
from artibot_sim.model.energy import powers
from artibot_sim.model.integrators import (
    D,
    D_DDOT,
    D_DOT,
    RK4,
    coordinate_of,
    motor_count,
    motor_of,
    right_hand_side,
    semi_implicit_step,
)
from artibot_sim.model.kinematics import JACOBIAN
from artibot_sim.model.layout import ACC, ENERGIES, M_M, ROW
from artibot_sim.model.transmission import efficiency

OK, DIVERGED = 0, 1
LIMIT = 1e6
"""A speed (m/s or rad/s) or angle beyond which a rollout has diverged; motors of Epi.q reach 3000 rad/s."""


@inlined
def hermite(position, velocity, knot, h, cubic):
    """Coefficients of the commands' cubic between two knots, motor by motor, into `cubic` (16,)."""
    last = position.shape[0] - 1
    i, j = min(knot, last), min(knot + 1, last)
    for motor in range(4):
        rise = (position[j, motor] - position[i, motor]) / h
        a, b = velocity[i, motor], velocity[j, motor]
        cubic[motor] = position[i, motor]
        cubic[4 + motor] = a
        cubic[8 + motor] = (3.0 * rise - 2.0 * a - b) / h if j > i else 0.0
        cubic[12 + motor] = (a + b - 2.0 * rise) / (h * h) if j > i else 0.0


@inlined
def command_at(cubic, s, drive):
    """Commanded angles, speeds and accelerations `s` seconds after the knot, into `drive` (12,)."""
    for motor in range(4):
        c0, c1, c2, c3 = cubic[motor], cubic[4 + motor], cubic[8 + motor], cubic[12 + motor]
        drive[D + motor] = c0 + s * (c1 + s * (c2 + s * c3))
        drive[D_DOT + motor] = c1 + s * (2.0 * c2 + 3.0 * s * c3)
        drive[D_DDOT + motor] = 2.0 * c2 + 6.0 * s * c3


@inlined
def mean_acceleration(cubic, s, dt, drive):
    """Mean of the commanded accelerations from `s` to ``s + dt``, in place of the instant's."""
    for motor in range(4):
        drive[D_DDOT + motor] = 2.0 * cubic[8 + motor] + 3.0 * cubic[12 + motor] * (2.0 * s + dt)


@inlined
def commanded_torques(torque_d, knot, back_factor, previous, torque):
    """Torques held through a step: commanded ones, or eq. 30 from the step before (NaN commands it)."""
    i = min(knot, torque_d.shape[0] - 1)
    shared = back_factor * (previous[0] + previous[1])
    for motor in range(4):
        given = torque_d[i, motor]
        torque[motor] = given if not math.isnan(given) else (shared if motor > 1 else 0.0)


@inlined
def feed_back(p, v, w, eta):
    """Efficiencies for the next step, from this step's torques and speeds (eq. 23, Fig. 7)."""
    for motor in range(motor_count(p)):
        eta[motor] = efficiency(motor_of(p, motor), w[M_M + motor], v[coordinate_of(motor)])


@inlined
def sound(q, v):
    """Whether a state is finite and within what a rover can do."""
    for i in range(16):
        if not (abs(v[i]) < LIMIT and abs(q[i]) < 1e12):
            return False
    return True


@inlined
def rk4_step(q, v, p, modes, cubic, s, dt, drive, eta, torque, jac, w, scratch, energy, e, pw):
    """Advance (q, v) in place by one step whose first stage is already in the row `w`; accumulate energies."""
    stage, q_s, v_s = scratch[:ROW], scratch[ROW : ROW + 16], scratch[ROW + 16 : ROW + 32]
    sum_q, sum_v = scratch[ROW + 32 : ROW + 48], scratch[ROW + 48 : ROW + 64]
    if energy:
        powers(q, v, p, w, pw)
        for i in range(ENERGIES):
            e[i] += dt / 6.0 * pw[i]
    for i in range(16):
        sum_q[i], sum_v[i] = v[i], w[ACC + i]
        q_s[i], v_s[i] = q[i] + 0.5 * dt * v[i], v[i] + 0.5 * dt * w[ACC + i]
    command_at(cubic, s + 0.5 * dt, drive)
    for k in range(3):
        if k == 2:
            command_at(cubic, s + dt, drive)
        right_hand_side(q_s, v_s, p, modes, drive, eta, torque, jac, stage)
        if energy:
            powers(q_s, v_s, p, stage, pw)
            weight = dt / 6.0 if k == 2 else dt / 3.0
            for i in range(ENERGIES):
                e[i] += weight * pw[i]
        weight, h = (1.0, 0.0) if k == 2 else (2.0, (0.5 * dt if k == 0 else dt))
        for i in range(16):
            sum_q[i] += weight * v_s[i]
            sum_v[i] += weight * stage[ACC + i]
            q_s[i] = q[i] + h * v_s[i]
            v_s[i] = v[i] + h * stage[ACC + i]
    for i in range(16):
        q[i] += dt / 6.0 * sum_q[i]
        v[i] += dt / 6.0 * sum_v[i]


@kernel
def integrate(
    q, v, eta, previous, p, modes, integrator, dt, steps, every, position, velocity, torque_d, knot_steps,
    back_factor, energy, out_q, out_v, out_w, out_e,
):  # fmt: skip
    """Advance the state in place by `steps` steps and keep every `every`-th row, the first and the last included.

    Parameters
    ----------
    q, v : array, shape (16,)
    eta, previous : array, shape (4,)
        Efficiencies for the next step, and motor torques of the step before.
    position, velocity, torque_d : array, shape (n, 4)
        Commands at knots `knot_steps` steps apart; the first is at the start.

    Returns
    -------
    tuple of int
        OK or DIVERGED, and the number of rows written.
    """
    w, jac, scratch = np.zeros(ROW), np.zeros(JACOBIAN), np.zeros(ROW + 64)
    drive, cubic, torque = np.zeros(12), np.zeros(16), np.zeros(4)
    e, pw = np.zeros(ENERGIES), np.zeros(ENERGIES)
    q_last, v_last, eta_next = np.zeros(16), np.zeros(16), np.zeros(4)
    row = 0
    for step in range(steps + 1):
        last = step == steps
        phase = step % knot_steps
        if phase == 0:
            hermite(position, velocity, step // knot_steps, knot_steps * dt, cubic)
        s = phase * dt
        keep = last or step % every == 0
        command_at(cubic, s, drive)
        commanded_torques(torque_d, step // knot_steps, back_factor, previous, torque)
        if keep:
            if not sound(q, v):
                return DIVERGED, row
            out_q[row], out_v[row] = q, v
            if energy:
                out_e[row] = e
        if integrator == RK4:
            right_hand_side(q, v, p, modes, drive, eta, torque, jac, w)
            feed_back(p, v, w, eta_next)
            if not last:
                rk4_step(q, v, p, modes, cubic, s, dt, drive, eta, torque, jac, w, scratch, energy, e, pw)
        else:
            q_last[:], v_last[:] = q, v
            mean_acceleration(cubic, s, dt, drive)
            semi_implicit_step(q, v, p, modes, drive, eta, torque, dt, jac, w)
            if energy and not last:
                for i in range(16):
                    v_last[i] = 0.5 * (v_last[i] + v[i])
                powers(q_last, v_last, p, w, pw)
                for i in range(ENERGIES):
                    e[i] += dt * pw[i]
            feed_back(p, v, w, eta_next)
            if last:
                q[:], v[:] = q_last, v_last
        if keep:
            out_w[row] = w
            row += 1
        if not last:
            for motor in range(motor_count(p)):
                previous[motor], eta[motor] = w[M_M + motor], eta_next[motor]
    return OK, row
