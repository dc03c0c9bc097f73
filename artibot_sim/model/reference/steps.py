"""Both integrators in plain NumPy, on the equations of :mod:`artibot_sim.model.reference.dynamics`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.equations.transmission import Mode
from artibot_sim.model.ground.raster import Surface
from artibot_sim.model.kernels.layout import MEMORY, MOTOR_COORDINATES
from artibot_sim.model.reference.contact import Wheels, contact, modules_of, motors_of
from artibot_sim.model.reference.dynamics import (
    body_system,
    dragged,
    dragging,
    follow,
    load_torque,
    looped,
    solve,
    solve_augmented,
)
from artibot_sim.model.reference.effects import NEUTRAL, PlainEffects
from artibot_sim.model.robot.parameters import Params

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlainState:
    """q, v (16,), the efficiencies for the next step, the torques of the last (4,), what wheels remember (32,).

    And the integrals of the speeds' errors that velocity loops have now (4,), rad.
    """

    q: Array
    v: Array
    eta: Array
    torque: Array
    memory: Array = field(default_factory=lambda: np.zeros(MEMORY))
    behind: Array = field(default_factory=lambda: np.zeros(4))


def _hold(p: Params, state: PlainState, command: Array, back_factor: float) -> Array:
    """Torques held through a step: commanded ones; where NaN, eq. 30 behind and zero in front."""
    shared = back_factor * (state.torque[0] + state.torque[1])
    default = np.array([0.0, 0.0, shared, shared])
    return np.where(np.isnan(command), default, command)


def _feed_back(
    p: Params, torque: Array, M_r: Array, theta: Array, theta_dot: Array, theta_ddot: Array, eta: Array,
    modes: Sequence[Mode], measured: Array, fx: PlainEffects, dt: float,
) -> Array:  # fmt: skip
    """Eq. 23 for the next step, judged by what goes through the gear.

    Where bristles hold the wheels and both efficiencies lead, after a step under the same torques, to a rotation that
    contradicts them, the motor stands: then it is that which brings it to rest. Of a prescribed motor with a measured
    torque (N m, else NaN): the one efficiency that agrees with the sign of the torque that it gives; where both do or
    neither, that whose torque is nearer to what was measured.
    """
    fresh, held_by_ground = eta.copy(), fx.ask("bristle", 0.0)[0] > 0.0
    for i, motor in enumerate(motors_of(p)):
        drag = dragging(fx, motor, i, theta[i], theta_dot[i])
        M_gear = torque[i] - drag
        by_torque = motor.eta_d if M_gear * theta_dot[i] >= 0 else 1.0 / motor.eta_r
        if modes[i] != Mode.PRESCRIBED or np.isnan(measured[i]):
            fresh[i] = by_torque
            ahead = {
                one: (motor.J_m + motor.J_w * motor.tau**2 / one) * theta_dot[i]
                + dt * (M_gear - motor.tau / one * M_r[i])
                for one in (motor.eta_d, 1.0 / motor.eta_r)
            }
            if held_by_ground and M_gear * ahead[motor.eta_d] <= 0 < M_gear * ahead[1.0 / motor.eta_r]:
                wheels = dt * motor.tau * M_r[i] - motor.J_w * motor.tau**2 * theta_dot[i]
                fresh[i] = wheels / (dt * M_gear + motor.J_m * theta_dot[i])
            continue
        wheels = (M_gear - motor.J_m * theta_ddot[i]) * eta[i]
        given = {one: motor.J_m * theta_ddot[i] + wheels / one for one in (motor.eta_d, 1.0 / motor.eta_r)}
        agree = [one for one in given if (given[one] * theta_dot[i] >= 0) == (one == motor.eta_d)]
        fresh[i] = min(agree if len(agree) == 1 else given, key=lambda one: abs(measured[i] - drag - given[one]))
    return fresh


def _loads(p: Params, wheels: Wheels, theta_dot: Array) -> Array:
    """M_r of eq. 22 for all motors (4,), N m."""
    loads = np.zeros(4)
    for i, motor in enumerate(motors_of(p)):
        loads[i] = load_torque(p, wheels, i, motor.tau * theta_dot[i])
    return loads


def _wound_up(state: PlainState, modes: Sequence[Mode], before: Array, trail: Array) -> Array:
    """Integrals of the speeds' errors, rad, where angles behind the commands have come from `before` to `trail`."""
    return np.where(np.array(modes) == Mode.DRIVEN, state.behind + (trail - before), 0.0)


def _wound(fx: PlainEffects, behind: Array) -> Array:
    """What windup limits leave of them."""
    return np.array([fx.ask("wound", one) for one in behind])


MOTOR_COLUMNS = list(MOTOR_COORDINATES)


def rk4_step(
    p: Params,
    state: PlainState,
    modes: Sequence[Mode],
    drives: Sequence[Array],
    command: Array,
    factor: float,
    dt: float,
    fx: PlainEffects = NEUTRAL,
    ground: Surface | None = None,
) -> PlainState:
    """One step of the classical Runge-Kutta method.

    Parameters
    ----------
    drives : sequence of 3 arrays, shape (3, 4)
        Commanded angles, speeds and accelerations at the step's start, middle and end.
    command : array, shape (4,)
        Commanded torques through the step; of prescribed motors what was measured, if anything.
    factor : float
        Of eq. 30, for one back motor.
    fx : PlainEffects
        At the step's start.
    ground : Surface, optional
        Flat ground without.
    """
    held = _hold(p, state, command, factor)
    active = np.arange(16) < (16 if p.two else 8)
    k_q, k_v, k_lag, torque, M_r = [], [], [], state.torque, np.zeros(4)
    q, v, memory = state.q, state.v, state.memory
    for stage, (h, drive) in enumerate(
        zip((0.5, 0.5, 1.0, 0.0), (drives[0], drives[1], drives[1], drives[2]), strict=True)
    ):
        now = fx.at(fx.t + (0.0, 0.5, 0.5, 1.0)[stage] * dt)
        behind = _wound_up(state, modes, drives[0][0] - state.q[MOTOR_COLUMNS], drive[0] - q[MOTOR_COLUMNS])
        solution = solve(p, q, v, modes, drive, state.eta, held, now, memory, ground, behind)
        if stage == 0:
            torque, M_r = solution.torque, _loads(p, solution.wheels, v[MOTOR_COLUMNS])
        k_q.append(v)
        k_v.append(np.where(active, solution.acceleration, 0.0))
        k_lag.append(solution.wheels.memory_rate)
        q, v = state.q + h * dt * k_q[-1], state.v + h * dt * k_v[-1]
        memory = state.memory + h * dt * k_lag[-1]
    weights = np.array([1, 2, 2, 1]) / 6 * dt
    begun = fx.with_motion(p, state.q, state.v)
    turned = state.q[MOTOR_COLUMNS], state.v[MOTOR_COLUMNS], k_v[0][MOTOR_COLUMNS]
    eta = _feed_back(p, torque, M_r, *turned, state.eta, modes, command, begun, dt)
    ends = (now + weights @ np.array(k) for now, k in ((state.q, k_q), (state.v, k_v), (state.memory, k_lag)))
    new_q, new_v, new_memory = ends
    trails = drives[0][0] - state.q[MOTOR_COLUMNS], drives[2][0] - new_q[MOTOR_COLUMNS]
    return PlainState(new_q, new_v, eta, torque, new_memory, _wound(fx, _wound_up(state, modes, *trails)))


def semi_implicit_step(
    p: Params,
    state: PlainState,
    modes: Sequence[Mode],
    drive: Array,
    command: Array,
    factor: float,
    dt: float,
    fx: PlainEffects = NEUTRAL,
    ground: Surface | None = None,
) -> PlainState:
    """One step of symplectic Euler with implicit wheel spin.

    `drive` (4, 4) holds the commanded angles and speeds at the step's start, the mean acceleration over it, and the
    commanded angles at its end.
    """
    held = _hold(p, state, command, factor)
    v = state.v.copy()
    torque = np.zeros(4)
    fx = fx.with_motion(p, state.q, state.v)
    old = contact(p, state.q, state.v, fx, state.memory, ground=ground)
    for i in range(len(motors_of(p))):
        v[MOTOR_COLUMNS[i]], torque[i] = _next_speed(p, state, old, i, modes[i], drive[:, i], held[i], dt, fx)
    wheels = contact(p, state.q, v, fx, state.memory, dt, state.v, ground)
    for i, motor in enumerate(motors_of(p)):
        if modes[i] == Mode.PRESCRIBED:
            c = MOTOR_COLUMNS[i]
            load = motor.tau / state.eta[i] * load_torque(p, wheels, i, motor.tau * v[c])
            load += dragging(fx, motor, i, state.q[c], v[c])
            inertia = motor.J_m + motor.J_w * motor.tau**2 / state.eta[i]
            torque[i] = inertia * (v[c] - state.v[c]) / dt + load
    mass, n, phi, right = body_system(p, state.q, state.v, wheels, fx, dt, 0.0 if ground is None else p.pitching)
    acceleration, _ = solve_augmented(mass, phi, n, right)
    new_v = v.copy()
    bodies = [i for _, offset in modules_of(p) for i in range(offset, offset + 6)]
    new_v[bodies] = state.v[bodies] + dt * acceleration[bodies]
    vertical = np.isin(np.arange(16) % 8, (2, 3, 4))
    new_q = state.q + dt * np.where(vertical, new_v, 0.5 * (state.v + new_v))
    speeds = new_v[MOTOR_COLUMNS]
    turned = state.q[MOTOR_COLUMNS], speeds, (speeds - state.v[MOTOR_COLUMNS]) / dt
    M_r = _loads(p, wheels, speeds)
    eta = _feed_back(p, torque, M_r, *turned, state.eta, modes, command, fx, dt)
    trails = drive[0] - state.q[MOTOR_COLUMNS], drive[3] - new_q[MOTOR_COLUMNS]
    behind = _wound(fx, _wound_up(state, modes, *trails))
    return PlainState(new_q, new_v, eta, torque, state.memory + dt * wheels.memory_rate, behind)


def _next_speed(
    p: Params, state: PlainState, wheels: Wheels, i: int, mode: Mode, drive: Array, held: float, dt: float,
    fx: PlainEffects,
) -> tuple[float, float]:  # fmt: skip
    """Speed of a motor after a step, the slip of its wheels linearised by the secant of eqs 15, 16; its torque."""
    motor, c = motors_of(p)[i], MOTOR_COLUMNS[i]
    theta, theta_dot = state.q[c], state.v[c]
    _, d_dot, d_ddot, _ = drive
    if mode == Mode.PRESCRIBED:
        return theta_dot + dt * follow(p, theta, theta_dot, drive[:3]), 0.0
    eta, pair, drag = state.eta[i], slice(2 * i, 2 * i + 2), dragged(fx, motor, i, theta_dot)
    slope = wheels.slope[pair] @ wheels.radius[pair] ** 2  # of the torque on the axle
    inertia = motor.J_m + motor.J_w * motor.tau**2 / eta + dt * motor.tau / eta * slope * motor.tau
    inertia += dt * drag / theta_dot if theta_dot != 0 else 0.0
    load = motor.tau / eta * load_torque(p, wheels, i, motor.tau * theta_dot)
    load += dragging(fx, motor, i, theta, theta_dot)
    M = held
    if mode == Mode.DRIVEN:
        M = inertia * (d_ddot + p.velocity_gain * (d_dot - theta_dot)) + load
        M = looped(fx, d_dot - theta_dot, state.behind[i], M)
    low, high = fx.ask("limits", theta_dot, -motor.torque_max, motor.torque_max)
    M = min(max(M, low), high)
    return theta_dot + dt * (M - load) / inertia, M
