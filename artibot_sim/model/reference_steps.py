"""Both integrators in plain NumPy, on the equations of :mod:`artibot_sim.model.reference`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.layout import MOTOR_COORDINATES
from artibot_sim.model.params import Params
from artibot_sim.model.reference import (
    Wheels,
    body_system,
    contact,
    follow,
    load_torque,
    modules_of,
    motors_of,
    solve,
    solve_augmented,
)
from artibot_sim.model.stability import OVERSHOOT
from artibot_sim.model.transmission import Mode

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlainState:
    """q, v (16,), the efficiencies for the next step and the torques of the last (4,)."""

    q: Array
    v: Array
    eta: Array
    torque: Array


def _hold(p: Params, state: PlainState, command: Array, back_factor: float) -> Array:
    """Torques held through a step: commanded ones; where NaN, eq. 30 behind and zero in front."""
    shared = back_factor * (state.torque[0] + state.torque[1])
    default = np.array([0.0, 0.0, shared, shared])
    return np.where(np.isnan(command), default, command)


def _feed_back(p: Params, torque: Array, theta_dot: Array, eta: Array) -> Array:
    """Eq. 23 for the next step."""
    fresh = eta.copy()
    for i, motor in enumerate(motors_of(p)):
        fresh[i] = motor.eta_d if torque[i] * theta_dot[i] >= 0 else 1.0 / motor.eta_r
    return fresh


MOTOR_COLUMNS = list(MOTOR_COORDINATES)


def rk4_step(
    p: Params,
    state: PlainState,
    modes: Sequence[Mode],
    drives: Sequence[Array],
    command: Array,
    factor: float,
    dt: float,
) -> PlainState:
    """One step of the classical Runge-Kutta method.

    Parameters
    ----------
    drives : sequence of 3 arrays, shape (3, 4)
        Commanded angles, speeds and accelerations at the step's start, middle and end.
    command : array, shape (4,)
        Commanded torques through the step.
    factor : float
        Of eq. 30, for one back motor.
    """
    held = _hold(p, state, command, factor)
    active = np.arange(16) < (16 if p.two else 8)
    k_q, k_v, torque = [], [], state.torque
    q, v = state.q, state.v
    for stage, (h, drive) in enumerate(
        zip((0.5, 0.5, 1.0, 0.0), (drives[0], drives[1], drives[1], drives[2]), strict=True)
    ):
        solution = solve(p, q, v, modes, drive, state.eta, held)
        if stage == 0:
            torque = solution.torque
        k_q.append(v)
        k_v.append(np.where(active, solution.acceleration, 0.0))
        q, v = state.q + h * dt * k_q[-1], state.v + h * dt * k_v[-1]
    weights = np.array([1, 2, 2, 1]) / 6 * dt
    eta = _feed_back(p, torque, state.v[MOTOR_COLUMNS], state.eta)
    return PlainState(state.q + weights @ np.array(k_q), state.v + weights @ np.array(k_v), eta, torque)


def semi_implicit_step(
    p: Params, state: PlainState, modes: Sequence[Mode], drive: Array, command: Array, factor: float, dt: float
) -> PlainState:
    """One step of symplectic Euler with implicit wheel spin and, where the step is long for it, slip.

    `drive` (3, 4) holds the commanded angles and speeds at the step's start and the mean acceleration over it.
    """
    held = _hold(p, state, command, factor)
    v = state.v.copy()
    torque = np.zeros(4)
    for i in range(len(motors_of(p))):
        v[MOTOR_COLUMNS[i]], torque[i] = _next_speed(p, state, i, modes[i], drive[:, i], held[i], dt)
    wheels = contact(p, state.q, v)
    for i, motor in enumerate(motors_of(p)):
        if modes[i] == Mode.PRESCRIBED:
            c = MOTOR_COLUMNS[i]
            load = motor.tau / state.eta[i] * load_torque(p, wheels, i, motor.tau * v[c])
            inertia = motor.J_m + motor.J_w * motor.tau**2 / state.eta[i]
            torque[i] = inertia * (v[c] - state.v[c]) / dt + load
    new_v = v.copy()
    bodies = [i for _, offset in modules_of(p) for i in range(offset, offset + 6)]
    new_v[bodies] = state.v[bodies] + dt * _body_acceleration(p, state.q, state.v, wheels, dt)[bodies]
    vertical = np.isin(np.arange(16) % 8, (2, 3, 4))
    new_q = state.q + dt * np.where(vertical, new_v, 0.5 * (state.v + new_v))
    return PlainState(new_q, new_v, _feed_back(p, torque, new_v[MOTOR_COLUMNS], state.eta), torque)


def _next_speed(
    p: Params, state: PlainState, i: int, mode: Mode, drive: Array, held: float, dt: float
) -> tuple[float, float]:
    """Speed of a motor after a step, the slip of its wheels linearised by the secant of eqs 15, 16; its torque."""
    motor, c = motors_of(p)[i], MOTOR_COLUMNS[i]
    theta, theta_dot = state.q[c], state.v[c]
    _, d_dot, d_ddot = drive
    if mode == Mode.PRESCRIBED:
        return theta_dot + dt * follow(p, theta, theta_dot, drive), 0.0
    eta = state.eta[i]
    wheels = contact(p, state.q, state.v)
    pair = slice(2 * i, 2 * i + 2)
    free = p.k_l * (p.r_w * motor.tau * theta_dot - wheels.p_x[pair])
    cut = np.hypot(free, p.k_t * wheels.p_y[pair]) > p.mu_s * wheels.F_n[pair]
    secant = np.where(cut, wheels.F_l[pair] / np.where(free == 0.0, 1.0, free), 1.0)
    damping = motor.tau / eta * p.r_w * (p.k_l * p.r_w * np.where(free == 0.0, 1.0, secant)).sum() * motor.tau
    inertia = motor.J_m + motor.J_w * motor.tau**2 / eta + dt * damping
    load = motor.tau / eta * load_torque(p, wheels, i, motor.tau * theta_dot)
    M = held if mode == Mode.TORQUE else inertia * (d_ddot + p.velocity_gain * (d_dot - theta_dot)) + load
    M = min(max(M, -motor.torque_max), motor.torque_max)
    return theta_dot + dt * (M - load) / inertia, M


def _body_acceleration(p: Params, q: Array, v: Array, wheels: Wheels, dt: float) -> Array:
    """Eq. 25 for the modules alone, from given wheel forces; shape (16,), the motors' entries without meaning.

    In the module's frame the slip's damping (1.5 M at most, as one step sees it) adds to what resists a change of
    velocity: M dv_body/dt becomes max(M, dt D / 1.5) dv_body/dt.
    """
    mass, n, phi, right = body_system(p, q, v, wheels)
    for body, b in modules_of(p):
        damping = 4 * max(p.k_l, p.k_t)
        spin_damping = 4 * (p.k_t * body.half_x**2 + p.k_l * body.half_y**2)
        sluggish = max(dt / (1 + OVERSHOOT) * damping - body.m, 0.0)
        # a = dv_body/dt + gamma_dot × v, and only the first part is resisted
        n[b : b + 2] += sluggish * v[b + 5] * np.array([-v[b + 1], v[b]])
        mass[b : b + 2] += sluggish
        mass[b + 5] = max(body.J_z, dt / (1 + OVERSHOOT) * spin_damping)
    x, _ = solve_augmented(mass, phi, n, right)
    return x[:16]
