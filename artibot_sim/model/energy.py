"""Where the energy goes: power of each named contribution, and what is stored.

Over a rollout, what the motors put in and the joint does is stored or lost:
sum(E_motor) + E_joint = stored(end) − stored(start) + sum(all other E). `E_joint` is the work that the joint's
force does on the modules, zero but for the stabilisation of eq. 13.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.compiled import inlined
from artibot_sim.model.contact import unloaded_radius
from artibot_sim.model.effects import hooks
from artibot_sim.model.elementary import sincos
from artibot_sim.model.integrators import coordinate_of, motor_count, motor_of
from artibot_sim.model.layout import (
    ACC,
    ALPHA,
    BACK,
    E_ARTICULATION,
    E_DRAG,
    E_GEAR,
    E_JOINT,
    E_MOTOR,
    E_NORMAL,
    E_OFFSET,
    E_PUSH,
    E_ROLLING,
    E_SLIP_L,
    E_SLIP_T,
    E_TILT,
    ETA,
    F_L,
    F_N,
    F_T,
    GAMMA,
    LOAD,
    M_D,
    M_J,
    M_M,
    M_R,
    MOTOR_COORDINATES,
    P_X,
    P_Y,
    PUSH,
    Q_J,
    X,
    Y,
    Z,
)
from artibot_sim.model.params import params
from artibot_sim.model.robot import Robot
from artibot_sim.model.transmission import rolling_sign


@inlined
def motor_powers(v, p, fx, w, out):
    """Power put in by the motors, and lost in the gears: (1/eta − 1) of what passes to the wheels."""
    for motor in range(motor_count(p)):
        c = coordinate_of(motor)
        unit = motor_of(p, motor)
        omega = unit.tau * v[c]
        out[E_MOTOR + motor] = w[M_M + motor] * v[c]
        passed = omega * (unit.J_w * unit.tau * w[ACC + c] + w[M_R + motor])
        out[E_GEAR + motor] = (1.0 / w[ETA + motor] - 1.0) * passed
        if fx is not None:
            out[E_DRAG + motor] = w[M_D + motor] * v[c]


@inlined
def wheel_powers(body, p, fx, q, v, module, base, w, out):
    """Power dissipated between the wheels of one module and the ground.

    `E_offset`: the forces act u_w ahead of where the slip is taken. `E_tilt`: eq. 18 turns the normal force with
    the module's roll, while the spring is vertical; zero without roll.
    """
    s_a, c_a = sincos(q[module + ALPHA])
    s_g, c_g = sincos(q[module + GAMMA])
    v_y = c_g * v[module + Y] - s_g * v[module + X]
    v_z, alpha_dot, gamma_dot = v[module + Z], v[module + ALPHA], v[module + GAMMA]
    for i in range(4):
        j = base + i
        x = body.half_x if i % 2 == 0 else -body.half_x
        y = -body.half_y if i < 2 else body.half_y
        motor = j // 2
        omega = motor_of(p, motor).tau * v[coordinate_of(motor)]
        F_l, F_t, F_n = w[F_L + j], w[F_T + j], w[F_N + j]
        r_0, u_w = body.r_0, p.u_w
        if fx is not None:
            r_0 = unloaded_radius(body, p, fx, base // 4, 1.0 if i % 2 == 0 else -1.0, -1.0 if i < 2 else 1.0)
            u_w *= hooks.lead(fx, math.sqrt(w[P_X + j] * w[P_X + j] + w[P_Y + j] * w[P_Y + j]))
        out[E_SLIP_L + j] = F_l * (motor_of(p, motor).r_w * omega - w[P_X + j])
        out[E_SLIP_T + j] = -F_t * w[P_Y + j]
        out[E_OFFSET + j] = -u_w * gamma_dot * (F_t * c_a - F_n * s_a)
        out[E_ROLLING + j] = u_w * omega * (F_l if p.literal_eq22 else F_n * rolling_sign(omega))
        rate = v_z + alpha_dot * y * c_a
        spring = p.k_n * max(r_0 - q[module + Z] - y * s_a, 0.0)
        out[E_NORMAL + j] = (spring - F_n) * rate
        along_normal = -s_a * (v_y + gamma_dot * x) + c_a * v_z + alpha_dot * y
        out[E_TILT + j] = F_n * (rate - along_normal)


@inlined
def load_power(v, module, base, w):
    """Power of the effects' forces on one module, W."""
    o = LOAD + base
    return w[o] * v[module + X] + w[o + 1] * v[module + Y] + w[o + 2] * v[module + GAMMA]


@inlined
def powers(q, v, p, fx, w, out):
    """Power of every contribution (W) at a state whose row is `w`, into `out` (ENERGIES,)."""
    motor_powers(v, p, fx, w, out)
    wheel_powers(p.front, p, fx, q, v, 0, 0, w, out)
    if fx is not None:
        out[E_ARTICULATION] = w[M_J] * (v[BACK + GAMMA] - v[GAMMA])
        out[E_PUSH] = w[PUSH] * v[X] + w[PUSH + 1] * v[Y] + load_power(v, 0, 0, w)
    if p.two:
        wheel_powers(p.back, p, fx, q, v, BACK, 4, w, out)
        if fx is not None:
            out[E_PUSH] += load_power(v, BACK, 3, w)
        total = 0.0
        for i in range(6):
            total += w[Q_J + i] * v[i] + w[Q_J + 6 + i] * v[BACK + i]
        out[E_JOINT] = total


def stored_energy(robot: Robot, q: NDArray[np.float64], v: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Energies stored in a state.

    Parameters
    ----------
    q, v : array, shape (n, 16)
        States (eqs 10, 11).

    Returns
    -------
    dict of arrays, shape (n,), J
        ``kinetic`` of the modules (eqs 5, 8), ``spin`` of motors and wheels, ``gravity`` (eq. 12) and ``elastic``
        of the wheels' normal stiffness.
    """
    p = params(robot)
    units = (p.right_front, p.left_front, p.right_back, p.left_back)[: 4 if p.two else 2]
    kinetic, spin, gravity, elastic = (np.zeros(len(q)) for _ in range(4))
    for unit, c in zip(units, MOTOR_COORDINATES, strict=False):
        spin += 0.5 * (unit.J_m + unit.J_w * unit.tau**2) * v[:, c] ** 2
    for body, b in ((p.front, 0), (p.back, BACK))[: 2 if p.two else 1]:
        inertia = 1.0 / np.array(body.inverse)
        kinetic += 0.5 * (v[:, b : b + 6] ** 2) @ inertia
        gravity -= body.m * (q[:, b : b + 3] @ np.array([p.g_x, p.g_y, p.g_z]))
        for y in (-body.half_y, body.half_y):
            deflection = np.maximum(body.r_0 - q[:, b + Z] - y * np.sin(q[:, b + ALPHA]), 0.0)
            elastic += 2 * 0.5 * p.k_n * deflection**2
    return {"kinetic": kinetic, "spin": spin, "gravity": gravity, "elastic": elastic}
