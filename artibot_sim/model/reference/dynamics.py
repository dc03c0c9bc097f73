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

from artibot_sim.model.equations.transmission import ROLLING_WIDTH, Mode
from artibot_sim.model.ground.raster import Surface
from artibot_sim.model.kernels.layout import MOTOR_COORDINATES
from artibot_sim.model.reference.contact import (
    Wheels,
    contact,
    contact_forces,
    modules_of,
    motors_of,
    rotation_x,
    rotation_y,
    rotation_z,
)
from artibot_sim.model.reference.effects import NEUTRAL, PlainEffects
from artibot_sim.model.robot.parameters import MotorParams, Params

Array = NDArray[np.float64]

__all__ = ["Solution", "Wheels", "constraint_terms", "contact", "contact_forces", "solve"]

E_X, E_Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


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


def dragged(fx: PlainEffects, motor: MotorParams, number: int, theta_dot: float) -> float:
    """What effects have drag on a motor by its number before its gear, N m, at `theta_dot` (rad/s)."""
    return float(fx.ask("drag", number, theta_dot) + motor.geared * fx.ask("gear", theta_dot))


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


def solve(
    p: Params, q: Array, v: Array, modes: Sequence[Mode], drive: Array, eta: Array, torque: Array,
    fx: PlainEffects = NEUTRAL, memory: Array | None = None, ground: Surface | None = None,
    behind: Array | None = None,
) -> Solution:  # fmt: skip
    """Assemble eq. 28 in full and solve it.

    Parameters
    ----------
    drive : array, shape (3, 4)
        Commanded angles, speeds and accelerations of the motors.
    eta, torque : array, shape (4,)
        Efficiencies and commanded torques held through the step.
    memory : array, shape (32,), optional
        What wheels remember, see `layout.MEMORY`.
    ground : Surface, optional
        Flat ground without.
    behind : array, shape (4,), optional
        Integrals of the speeds' errors, rad, of motors that have a velocity loop; zero without.
    """
    fx = fx.with_motion(p, q, v)
    wheels = contact(p, q, v, fx, memory, ground=ground)
    mass, n, phi, right = body_system(p, q, v, wheels, fx, pitching=0.0 if ground is None else p.pitching)
    joint = len(phi)
    M_m, prescribed = np.zeros(4), []
    for i, motor in enumerate(motors_of(p)):
        c = MOTOR_COORDINATES[i]
        mass[c, c] = motor.J_m + motor.J_w * motor.tau**2 / eta[i]
        n[c] = -motor.tau / eta[i] * load_torque(p, wheels, i, motor.tau * v[c]) - dragging(fx, motor, i, q[c], v[c])
        if modes[i] == Mode.PRESCRIBED:
            prescribed.append(i)
            phi = np.vstack([phi, np.eye(16)[c]])
            right = np.append(right, follow(p, q[c], v[c], drive[:, i]))
            continue
        wanted = torque[i]
        if modes[i] == Mode.DRIVEN:
            wanted = mass[c, c] * (drive[2, i] + p.velocity_gain * (drive[1, i] - v[c])) - n[c]
            wanted = looped(fx, drive[1, i] - v[c], 0.0 if behind is None else behind[i], wanted)
        low, high = fx.ask("limits", v[c], -motor.torque_max, motor.torque_max)
        M_m[i] = min(max(wanted, low), high)
        n[c] += M_m[i]
    x, residual = solve_augmented(mass, phi, n, right)
    M_m[prescribed] = -x[16 + joint :]
    return Solution(x[:16], x[16 : 16 + joint] if joint else np.zeros(4), M_m, wheels, residual)


def body_system(
    p: Params, q: Array, v: Array, wheels: Wheels, fx: PlainEffects = NEUTRAL, dt: float = 0.0, pitching: float = 0.0
) -> tuple[Array, Array, Array, Array]:
    """The modules' part of eq. 25: M (16, 16), n, rows of Phi_x and their right-hand side, motors left out.

    `dt` is a semi-implicit step, over which damping in the joint's yaw is taken at its end, s. `pitching` is 1 where
    wheels feel the pitch of their module, else 0.
    """
    mass, n = np.eye(16), np.asarray(wheels.Q.sum(axis=0))
    n[:2] += fx.ask("push", 0)
    for body, b in modules_of(p):
        surge, sway, turn = fx.ask("load", b // 8)
        surge -= fx.ask("resist", b // 8, float(v[b : b + 2] @ rotation_z(q[b + 5])[0][:2, 0]))
        n[b : b + 2] += rotation_z(q[b + 5])[0][:2, :2] @ np.array([surge, sway])
        n[b + 5] += turn
        n += wheels.R[4 * (b // 8) : 4 * (b // 8) + 4].sum(axis=0)
        x, y = fx.ask("centre", b // 8)
        r = rotation_z(q[b + 5])[0][:2, :2] @ np.array([x, y])
        across = np.array([-r[1], r[0]])  # z × r: how the centre of mass moves in a turn
        weight, m = body.m * np.array([p.g_x, p.g_y]), body.m
        block = np.diag([m, m, m, body.J_x, body.J_y, body.J_z + m * r @ r])
        block[:2, 5], block[5, :2] = m * across, m * across
        mass[b : b + 6, b : b + 6] = block
        n[b : b + 2] += weight + m * v[b + 5] ** 2 * r
        n[b + 2] += m * p.g_z
        n[b + 3] += m * p.g_z * y
        n[b + 4] -= pitching * m * p.g_z * x
        n[b + 5] += across @ weight
    if not p.two:
        return mass, n, np.zeros((0, 16)), np.zeros(0)
    add_joint_torque(mass, n, q, v, fx, dt)
    phi, jacobian, bias = constraint_terms(p, q, v)
    return mass, n, jacobian, -bias - 2 * p.A_joint * (jacobian @ v) - p.A_joint**2 * phi


def add_joint_torque(mass: Array, n: Array, q: Array, v: Array, fx: PlainEffects, dt: float) -> None:
    """The effects' torque in the joint's yaw, over a step `dt` with its rate taken at the end (by the secant)."""
    angle, rate = q[13] - q[5], v[13] - v[5]
    angle += 0.5 * dt * rate
    n[[5, 13]] += fx.ask("joint", angle, rate) * np.array([1.0, -1.0])
    slow = rate if abs(rate) > 1e-9 else 1e-9
    slope = (fx.ask("joint", angle, slow) - fx.ask("joint", angle, 0.0)) / slow
    mass[np.ix_([5, 13], [5, 13])] += dt * slope * np.array([[1.0, -1.0], [-1.0, 1.0]])


def load_torque(p: Params, wheels: Wheels, motor: int, omega: float) -> float:
    """M_r of eq. 22 for one motor whose wheels turn at `omega` (rad/s), N m."""
    pair, r_w = slice(2 * motor, 2 * motor + 2), motors_of(p)[motor].r_w
    F_l, u_F_n = float(wheels.F_l[pair] @ wheels.radius[pair]), float(wheels.u[pair] @ wheels.F_n[pair])
    return F_l + (p.u_w / r_w * F_l if p.literal_eq22 else u_F_n * math.tanh(omega / ROLLING_WIDTH))


def dragging(fx: PlainEffects, motor: MotorParams, i: int, theta: float, theta_dot: float) -> float:
    """All that effects ask of motor `i` before its gear, N m, at `theta` (rad) and `theta_dot` (rad/s)."""
    asked = fx.ask("shaft", i, motor.tau * theta, motor.r_w * motor.tau * theta_dot)
    return dragged(fx, motor, i, theta_dot) + float(asked)


def looped(fx: PlainEffects, error: float, behind: float, wanted: float) -> float:
    """Torque that a velocity loop asks for, N m: `wanted` where the drive knows its load; see `effects.hooks.loop`."""
    asked = float(fx.ask("loop", error, fx.ask("wound", behind)))
    return wanted if math.isnan(asked) else asked


def follow(p: Params, theta: float, theta_dot: float, command: Array) -> float:
    """Acceleration of a prescribed motor (eqs 27, 28); `command` is its angle, speed and acceleration."""
    return float(command[2] - 2 * p.A_motor * (theta_dot - command[1]) - p.A_motor**2 * (theta - command[0]))


def solve_augmented(mass: Array, phi: Array, n: Array, right: Array) -> tuple[Array, float]:
    """Solve the matrix of eqs 25 and 28 for accelerations and multipliers; also its relative residual."""
    rows = len(phi)
    matrix = np.block([[mass, phi.T], [phi, np.zeros((rows, rows))]])
    b = np.concatenate([n, right])
    x = np.linalg.solve(matrix, b).astype(np.float64)
    scale = np.abs(matrix) @ np.abs(x) + np.abs(b) + np.finfo(float).tiny
    return x, float(np.max(np.abs(matrix @ x - b) / scale))
