"""Wheel and ground in plain NumPy: eqs 15 to 20, and what the effects make of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects.force_law import Own
from artibot_sim.model.reference.effects import NEUTRAL, PlainEffects
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.parameters import ModuleParams, MotorParams, Params
from artibot_sim.model.robot.robot import Robot

Array = NDArray[np.float64]

LIGHT = 1e-9
"""What wheels carry that loads have left, N: so that there is something to divide by."""

Loads = tuple[Array | None, Array | None]
"""What wheels carry, and loads by which they decide whether they slide, N; None: those of the springs."""


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


@dataclass(frozen=True)
class Wheels:
    """Contact of eight (or four) wheels.

    Velocities (m/s), forces (N), their distance ahead of the centres (m), what eq. 16 left of eq. 15's forces, the
    longitudinal slip coefficients (N s/m), the radii that the wheels roll on (m), rates of what they remember (n, 3:
    N/s of lateral forces that lag, m/s along and across of bristles), generalised forces (n, 16), those of the effects'
    resistance beside eq. 16 (n, 16), and what each newton of load adds to a wheel's forces across and along (n, 2).
    """

    p_x: Array
    p_y: Array
    F_n: Array
    F_l: Array
    F_t: Array
    u: Array
    held: Array
    k_l: Array
    radius: Array
    rate: Array
    Q: Array
    R: Array
    more: Array

    @property
    def memory_rate(self) -> Array:
        """`rate` as `layout.MEMORY` has it, of eight wheels, of which a rigid rover lacks four."""
        rate = np.zeros((3, 8))
        rate[:, : len(self.rate)] = self.rate.T
        return rate.ravel()


def modules_of(p: Params) -> list[tuple[ModuleParams, int]]:
    """The modules there are, each with the offset of its coordinates."""
    return [(p.front, 0), (p.back, 8)][: 2 if p.two else 1]


def motors_of(p: Params) -> list[MotorParams]:
    """The motors there are."""
    return [p.right_front, p.left_front, p.right_back, p.left_back][: 4 if p.two else 2]


def contact_forces(robot: Robot, q: Array, v: Array) -> Wheels:
    """Eqs 15 to 20 for every wheel at a state (16,), (16,)."""
    return contact(params(robot), q, v)


def contact(
    p: Params, q: Array, v: Array, fx: PlainEffects = NEUTRAL, memory: Array | None = None, dt: float = 0.0,
    begun: Array | None = None,
) -> Wheels:  # fmt: skip
    """`contact_forces` from the kernel's parameters.

    `memory` (24,) is what wheels remember now, see `layout.MEMORY`; lateral forces that lag are those at the end of a
    step `dt`, and loads have moved as at the rates `begun` (16,), without which those are `v`.
    """
    kept = np.zeros((8, 3)) if memory is None else memory.reshape(3, 8).T
    places = [(body, b, side, end) for body, b in modules_of(p) for side in (-1, 1) for end in (1, -1)]

    def wheels(effects: PlainEffects, rates: Array, loads: Loads, step: float) -> Wheels:
        rows = [
            _wheel(
                p, *place, q, rates, effects, kept[i], step, tuple(None if load is None else load[i] for load in loads)
            )
            for i, place in enumerate(places)
        ]
        return Wheels(*(np.array(part) for part in zip(*rows, strict=True)))

    carried = deciding = None
    if height := fx.ask("height"):
        at, listed = v if begun is None else begun, fx.without_laws()
        deciding = _moved(p, height, q, wheels(listed, at, (None, None), 0.0))
        carried = _moved(p, height, q, wheels(listed, at, (None, deciding), 0.0))
    return wheels(fx, v, (carried, deciding), dt)


def _moved(p: Params, height: float, q: Array, wheels: Wheels) -> Array:
    """Loads (N) that balance the moment about the centres of mass, moved from those of `wheels`.

    Two unknowns for each module, what moves from left to right and what moves back: the moment is that of forces which
    grow with the loads, where wheels slide.
    """
    moved = wheels.F_n.copy()
    for body, b in modules_of(p):
        own = slice(b // 2, b // 2 + 4)
        forces = np.array([wheels.F_t[own], wheels.F_l[own]]) + _flat(q[b + 5], wheels.R[own, b : b + 2])
        signs = np.array([[1, 1, -1, -1], [-1, 1, -1, 1]])  # right, behind
        levers = height / 4 / np.array([body.half_y, body.half_x]) * [1, p.pitching]
        system = np.eye(2) - levers[:, None] * (wheels.more[own].T @ signs.T)
        a, b_, c, d = system.ravel()
        unknown = np.array([[d, -b_], [-c, a]]) @ (levers * forces.sum(axis=1)) / max(a * d - b_ * c, LIGHT)
        more = unknown @ signs
        room = wheels.F_n[own] / np.maximum(-more, LIGHT)
        moved[own] = np.maximum(wheels.F_n[own] + min(1.0, room.min()) * more, LIGHT)
    return moved


def _flat(gamma: float, R: Array) -> Array:
    """Forces on wheels in `map` (n, 2) as those across and along a module that heads for `gamma` (2, n)."""
    return (R @ rotation_z(gamma)[0][:2, :2]).T[::-1]


def _wheel(
    p: Params, body: ModuleParams, b: int, side: int, end: int, q: Array, v: Array, fx: PlainEffects, kept: Array,
    dt: float, loads: tuple,
) -> tuple:  # fmt: skip
    """One wheel: `side` is −1 on the right, `end` is 1 in front.

    `loads` are what it carries, and that by which eq. 16 decides whether it slides (N); None: that of its spring.
    """
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
    place = q[b : b + 3] + R_z @ R_x @ centre
    rate = (partials(centre) @ v)[2]
    v_x, v_y, _ = (R_z @ R_x).T @ (partials(centre) @ v)
    x, y = fx.ask("centre", b // 8)
    share = (1 + end * x / body.half_x) * (1 + side * y / body.half_y)
    r_0 = body.r_0 - body.m * p.g_z / 4 * (share - 1) / p.k_n  # stands level, whatever each wheel carries
    spring = max(p.k_n * (r_0 - place[2]) - p.c_n * rate, 0.0)
    F_n, deciding = (spring if load is None else load for load in loads)
    motor_number = (0 if b == 0 else 2) + (0 if side < 0 else 1)
    motor, c = motors_of(p)[motor_number], b + (6 if side < 0 else 7)
    wheel = 2 * motor_number + (0 if end > 0 else 1)
    radius = motor.r_w * fx.ask("radius", wheel, motor.tau * q[c])
    slip = radius * motor.tau * v[c] - v_x
    soil = fx.ask("soil")
    grip = soil * fx.ask("grip", place[0], place[1])
    fastest = max(abs(slip + v_x), math.hypot(v_x, v_y))
    stiffness = soil * fx.ask("stiffness_by_load", F_n / p.load) * fx.ask("stiffness_by_speed", fastest**2)
    F_l, steady = stiffness * body.k_l * slip, -stiffness * body.k_t * v_y
    F_t, F_rate = _built_up(fx, steady, kept[0], v_x, dt)
    stiff, renewal = fx.ask("bristle", slip + v_x)
    k = stiffness * np.array([body.k_l, body.k_t])
    F_l, F_t = np.array([F_l, F_t]) + stiff * k * kept[1:]
    narrow, held, sliding = 1.0 / fx.ask("lateral_grip"), 1.0, np.zeros(2)
    F_h = math.hypot(F_l, narrow * F_t)
    if F_h > grip * body.mu_s * deciding:
        mu = fx.ask("friction", grip * body.mu_s, grip * body.mu_d, math.hypot(slip, v_y))
        held, sliding = mu * F_n / F_h, mu / F_h * np.array([F_t, F_l])
    omega_rim = motor.r_w * motor.tau * v[c]
    own = Own(v_x, v_y, omega_rim - v_x, motor.tau * q[c], place[0], place[1], F_n)
    middle = q[b : b + 3] + R_z @ R_x @ np.array([0.0, side * body.half_y, 0.0])
    shared = own._replace(x=middle[0], y=middle[1], lateral_speed=math.nan, load=math.nan)  # no law takes these two
    F_l = held * F_l + fx.ask("along", motor_number, shared) / 2  # half of what acts at both wheels of the motor
    F_t = held * F_t + fx.ask("lateral", v_y) + fx.ask("across", wheel, own)
    bending = np.zeros(2)
    if stiff > 0:
        left = held * np.array([slip, -v_y])
        release = renewal + stiff * math.hypot(*(k * left * [1.0, narrow])) / max(grip * body.mu_s * F_n, LIGHT)
        bending = (left - release * kept[1:]) / (1 + dt * release)
    u = p.u_w * fx.ask("lead", v_x, v_y)
    applied = centre + np.array([u, 0.0, 0.0])  # eq. 20
    Q = partials(applied).T @ (R_z @ R_x @ np.array([F_l, F_t, spring]))  # eq. 18
    resisted = fx.ask("wheel_resist", grip * body.mu_s * F_n, v_x, v_y)
    more = sliding + np.array(resisted[::-1]) / max(F_n, LIGHT)
    flat = R_z @ np.array([*resisted, 0.0])
    R = np.zeros(16)
    R[[b, b + 1]], R[b + 5] = flat[:2], flat @ partials(centre)[:, b + 5]
    return v_x, v_y, F_n, F_l, F_t, u, held, stiffness * body.k_l, radius, np.append(F_rate, bending), Q, R, more


def _built_up(fx: PlainEffects, steady: float, now: float, p_x: float, dt: float) -> tuple[float, float]:
    """A lateral force before saturation at the end of `dt` (s), where it lags: N, and its rate, N/s."""
    follow = fx.ask("follow_rate", p_x)
    if follow == 0:
        return steady, 0.0
    rate = follow * (steady - now) / (1 + dt * follow)
    return now + dt * rate, rate
