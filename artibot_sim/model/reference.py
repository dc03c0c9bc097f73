"""The equations in plain NumPy, slowly and literally, as the measure of the compiled loop.

Nothing here is shared with the kernel but the parameters. Matrices are assembled as eq. 28 prints them and solved
densely, partials of positions are written out from eqs 2, 13 and 19, and a step is what the paper's Fig. 7 shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.layout import MOTOR_COORDINATES
from artibot_sim.model.params import ModuleParams, MotorParams, Params, params
from artibot_sim.model.robot import Robot
from artibot_sim.model.transmission import ROLLING_WIDTH, Mode

Array = NDArray[np.float64]

E_X, E_Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def rotation_x(a: float) -> tuple[Array, Array, Array]:
    """R_x(a) and its first and second derivatives."""
    c, s = math.cos(a), math.sin(a)
    return (
        np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        np.array([[0, 0, 0], [0, -s, -c], [0, c, -s]]),
        np.array([[0, 0, 0], [0, -c, s], [0, -s, -c]]),
    )


def rotation_y(a: float) -> tuple[Array, Array, Array]:
    """R_y(a) and its first and second derivatives."""
    c, s = math.cos(a), math.sin(a)
    return (
        np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        np.array([[-s, 0, c], [0, 0, 0], [-c, 0, -s]]),
        np.array([[-c, 0, -s], [0, 0, 0], [s, 0, -c]]),
    )


def rotation_z(a: float) -> tuple[Array, Array, Array]:
    """R_z(a) and its first and second derivatives."""
    c, s = math.cos(a), math.sin(a)
    return (
        np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
        np.array([[-s, -c, 0], [c, -s, 0], [0, 0, 0]]),
        np.array([[-c, s, 0], [-s, -c, 0], [0, 0, 0]]),
    )


def _turned(angles: Array, rates: Array, vector: Array) -> tuple[Array, Array, Array]:
    """R vector for R of eq. 2; its partials by alpha, beta, gamma (3, 3); its second derivative without accelerations.

    `angles` and `rates` are alpha, beta, gamma.
    """
    factors = (rotation_x(angles[0]), rotation_y(angles[1]), rotation_z(angles[2]))

    def product(orders: tuple[int, int, int]) -> Array:
        turned: Array = factors[2][orders[2]] @ factors[1][orders[1]] @ factors[0][orders[0]] @ vector
        return turned

    units = np.eye(3, dtype=int)
    partials = np.column_stack([product(tuple(unit)) for unit in units])
    bias = sum(rates[i] * rates[j] * product(tuple(units[i] + units[j])) for i in range(3) for j in range(3))
    return product((0, 0, 0)), partials, np.asarray(bias)


def constraint_terms(p: Params, q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Eqs 13 and 14: Phi (4,), Phi_x (4, 16) and (d/dt Phi_x) x_dot (4,)."""
    f, b = slice(3, 6), slice(11, 14)
    r_f, dr_f, bias_f = _turned(q[f], v[f], np.array([p.front.O_x, 0.0, p.front.O_z]))
    r_b, dr_b, bias_b = _turned(q[b], v[b], np.array([p.back.O_x, 0.0, p.back.O_z]))
    z_f, dz_f, zbias_f = _turned(q[f], v[f], E_Z)
    x_b, dx_b, xbias_b = _turned(q[b], v[b], E_X)
    phi = np.append(q[0:3] + r_f - q[8:11] - r_b, z_f @ x_b)
    jacobian = np.zeros((4, 16))
    jacobian[:3, 0:3], jacobian[:3, 8:11] = np.eye(3), -np.eye(3)
    jacobian[:3, f], jacobian[:3, b] = dr_f, -dr_b
    jacobian[3, f], jacobian[3, b] = x_b @ dz_f, z_f @ dx_b
    bias_4 = zbias_f @ x_b + 2.0 * (dz_f @ v[f]) @ (dx_b @ v[b]) + z_f @ xbias_b
    return phi, jacobian, np.append(bias_f - bias_b, bias_4)


@dataclass(frozen=True)
class Wheels:
    """Contact of eight (or four) wheels: velocities (m/s), forces after eq. 16 (N), generalised forces (n, 16)."""

    p_x: Array
    p_y: Array
    F_n: Array
    F_l: Array
    F_t: Array
    Q: Array


def modules_of(p: Params) -> list[tuple[ModuleParams, int]]:
    """The modules there are, each with the offset of its coordinates."""
    return [(p.front, 0), (p.back, 8)][: 2 if p.two else 1]


def motors_of(p: Params) -> list[MotorParams]:
    """The motors there are."""
    return [p.right_front, p.left_front, p.right_back, p.left_back][: 4 if p.two else 2]


def contact_forces(robot: Robot, q: Array, v: Array) -> Wheels:
    """Eqs 15 to 20 for every wheel at a state (16,), (16,)."""
    return contact(params(robot), q, v)


def contact(p: Params, q: Array, v: Array) -> Wheels:
    """`contact_forces` from the kernel's parameters."""
    rows = [_wheel(p, body, b, side, end, q, v) for body, b in modules_of(p) for side in (-1, 1) for end in (1, -1)]
    p_x, p_y, F_n, F_l, F_t, Q = zip(*rows, strict=True)
    return Wheels(*(np.array(part) for part in (p_x, p_y, F_n, F_l, F_t, Q)))


def _wheel(p: Params, body: ModuleParams, b: int, side: int, end: int, q: Array, v: Array) -> tuple:
    """One wheel: `side` is −1 on the right, `end` is 1 in front."""
    R_x, dR_x, _ = rotation_x(q[b + 3])
    R_z, dR_z, _ = rotation_z(q[b + 5])

    def partials(point: Array) -> Array:
        """d p_*/d x of eq. 19 (3, 16); pitch does not move a wheel."""
        jacobian = np.zeros((3, 16))
        jacobian[:, b : b + 3] = np.eye(3)
        jacobian[:, b + 3] = R_z @ dR_x @ point
        jacobian[:, b + 5] = dR_z @ R_x @ point
        return jacobian

    centre = np.array([end * body.half_x, side * body.half_y, 0.0])
    velocity = (R_z @ R_x).T @ (partials(centre) @ v)
    height = q[b + 2] + (R_z @ R_x @ centre)[2]
    rate = (partials(centre) @ v)[2]
    F_n = max(p.k_n * (body.r_0 - height) - p.c_n * rate, 0.0)
    motor = (0 if b == 0 else 2) + (0 if side < 0 else 1)
    omega = motors_of(p)[motor].tau * v[b + (6 if side < 0 else 7)]
    F_l, F_t = p.k_l * (p.r_w * omega - velocity[0]), -p.k_t * velocity[1]
    F_h = math.hypot(F_l, F_t)
    if F_h > p.mu_s * F_n:
        F_l, F_t = p.mu_d * F_n * F_l / F_h, p.mu_d * F_n * F_t / F_h
    applied = centre + np.array([p.u_w, 0.0, 0.0])  # eq. 20
    Q = partials(applied).T @ (R_z @ R_x @ np.array([F_l, F_t, F_n]))  # eq. 18
    return velocity[0], velocity[1], F_n, F_l, F_t, Q


@dataclass(frozen=True)
class Solution:
    """What eq. 28 gives at an instant.

    Attributes
    ----------
    acceleration : array, shape (16,)
    multiplier : array, shape (4,)
        Of the joint, eq. 13.
    torque : array, shape (4,)
        Motor torques, N m.
    wheels : Wheels
    residual : float
        That of the linear system, relative to the terms of each row.
    """

    acceleration: Array
    multiplier: Array
    torque: Array
    wheels: Wheels
    residual: float


def solve(p: Params, q: Array, v: Array, modes: Sequence[Mode], drive: Array, eta: Array, torque: Array) -> Solution:
    """Assemble eq. 28 in full and solve it.

    Parameters
    ----------
    drive : array, shape (3, 4)
        Commanded angles, speeds and accelerations of the motors.
    eta, torque : array, shape (4,)
        Efficiencies and commanded torques held through the step.
    """
    wheels = contact(p, q, v)
    mass, n, phi, right = body_system(p, q, v, wheels)
    joint = len(phi)
    M_m, prescribed = np.zeros(4), []
    for i, motor in enumerate(motors_of(p)):
        c = MOTOR_COORDINATES[i]
        mass[c] = motor.J_m + motor.J_w * motor.tau**2 / eta[i]
        n[c] = -motor.tau / eta[i] * load_torque(p, wheels, i, motor.tau * v[c])
        if modes[i] == Mode.PRESCRIBED:
            prescribed.append(i)
            phi = np.vstack([phi, np.eye(16)[c]])
            right = np.append(right, follow(p, q[c], v[c], drive[:, i]))
            continue
        wanted = torque[i]
        if modes[i] == Mode.DRIVEN:
            wanted = mass[c] * (drive[2, i] + p.velocity_gain * (drive[1, i] - v[c])) - n[c]
        M_m[i] = min(max(wanted, -motor.torque_max), motor.torque_max)
        n[c] += M_m[i]
    x, residual = solve_augmented(mass, phi, n, right)
    M_m[prescribed] = -x[16 + joint :]
    return Solution(x[:16], x[16 : 16 + joint] if joint else np.zeros(4), M_m, wheels, residual)


def body_system(p: Params, q: Array, v: Array, wheels: Wheels) -> tuple[Array, Array, Array, Array]:
    """The modules' part of eq. 25: diagonal of M, n, rows of Phi_x and their right-hand side, motors left out."""
    mass, n = np.ones(16), np.asarray(wheels.Q.sum(axis=0))
    for body, b in modules_of(p):
        mass[b : b + 6] = body.m, body.m, body.m, body.J_x, body.J_y, body.J_z
        n[b : b + 3] += body.m * np.array([p.g_x, p.g_y, p.g_z])
    if not p.two:
        return mass, n, np.zeros((0, 16)), np.zeros(0)
    phi, jacobian, bias = constraint_terms(p, q, v)
    return mass, n, jacobian, -bias - 2 * p.A_joint * (jacobian @ v) - p.A_joint**2 * phi


def load_torque(p: Params, wheels: Wheels, motor: int, omega: float) -> float:
    """M_r of eq. 22 for one motor whose wheels turn at `omega` (rad/s), N m."""
    pair = slice(2 * motor, 2 * motor + 2)
    F_l, F_n = float(wheels.F_l[pair].sum()), float(wheels.F_n[pair].sum())
    return p.r_w * F_l + p.u_w * (F_l if p.literal_eq22 else F_n * math.tanh(omega / ROLLING_WIDTH))


def follow(p: Params, theta: float, theta_dot: float, command: Array) -> float:
    """Acceleration of a prescribed motor (eqs 27, 28); `command` is its angle, speed and acceleration."""
    return float(command[2] - 2 * p.A_motor * (theta_dot - command[1]) - p.A_motor**2 * (theta - command[0]))


def solve_augmented(mass: Array, phi: Array, n: Array, right: Array) -> tuple[Array, float]:
    """Solve the matrix of eqs 25 and 28 for accelerations and multipliers; also its relative residual."""
    rows = len(phi)
    matrix = np.block([[np.diag(mass), phi.T], [phi, np.zeros((rows, rows))]])
    b = np.concatenate([n, right])
    x = np.linalg.solve(matrix, b).astype(np.float64)
    scale = np.abs(matrix) @ np.abs(x) + np.abs(b) + np.finfo(float).tiny
    return x, float(np.max(np.abs(matrix @ x - b) / scale))
