"""Wheel and ground in plain NumPy: eqs 15 to 20, and what the effects make of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects.force_law import Own
from artibot_sim.model.ground.raster import Surface, sample
from artibot_sim.model.reference.effects import NEUTRAL, PlainEffects
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.parameters import ModuleParams, MotorParams, Params
from artibot_sim.model.robot.robot import Robot

Array = NDArray[np.float64]

LIGHT = 1e-9
"""What wheels carry that loads have left, N: so that there is something to divide by."""

Loads = tuple[Array | None, Array | None]
"""What wheels carry, and loads by which they decide whether they slide, N; None: those of the springs."""


@lru_cache(maxsize=16)  # asked for by every wheel
def rotation_x(a: float) -> tuple[Array, Array, Array]:
    """R_x(a) and its first and second derivatives."""
    c, s = math.cos(a), math.sin(a)
    return (
        np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        np.array([[0, 0, 0], [0, -s, -c], [0, c, -s]]),
        np.array([[0, 0, 0], [0, -c, s], [0, -s, -c]]),
    )


@lru_cache(maxsize=16)  # asked for by every wheel
def rotation_y(a: float) -> tuple[Array, Array, Array]:
    """R_y(a) and its first and second derivatives."""
    c, s = math.cos(a), math.sin(a)
    return (
        np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        np.array([[-s, 0, c], [0, 0, 0], [-c, 0, -s]]),
        np.array([[-c, 0, -s], [0, 0, 0], [s, 0, -c]]),
    )


@lru_cache(maxsize=16)  # asked for by every wheel
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
    longitudinal slip coefficients and F_l's secant slopes by slip (N s/m), the radii that the wheels roll on (m), rates
    of what they remember (n, 4: N/s of lateral forces that lag, 1/s of windup, m/s along and across of bristles),
    generalised forces (n, 16), those of the effects' resistance beside eq. 16 (n, 16), and what each newton of load
    adds to a wheel's forces across and along (n, 2).
    """

    p_x: Array
    p_y: Array
    F_n: Array
    F_l: Array
    F_t: Array
    u: Array
    held: Array
    k_l: Array
    slope: Array
    radius: Array
    rate: Array
    Q: Array
    R: Array
    more: Array

    @property
    def memory_rate(self) -> Array:
        """`rate` as `layout.MEMORY` has it, of eight wheels, of which a rigid rover lacks four."""
        rate = np.zeros((4, 8))
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
    begun: Array | None = None, ground: Surface | None = None,
) -> Wheels:  # fmt: skip
    """`contact_forces` from the kernel's parameters, on flat ground or on uneven one.

    `memory` (32,) is what wheels remember now, see `layout.MEMORY`; lateral forces that lag are those at the end of a
    step `dt`, and loads have moved as at the rates `begun` (16,), without which those are `v`.
    """
    kept = np.zeros((8, 4)) if memory is None else memory.reshape(4, 8).T
    places = [(body, b, side, end) for body, b in modules_of(p) for side in (-1, 1) for end in (1, -1)]

    def wheels(effects: PlainEffects, rates: Array, loads: Loads, step: float) -> Wheels:
        rows = [
            _wheel(
                p, *place, q, rates, effects, kept[i], step,
                tuple(None if load is None else load[i] for load in loads), ground,
            )
            for i, place in enumerate(places)
        ]  # fmt: skip
        return Wheels(*(np.array(part) for part in zip(*rows, strict=True)))

    carried = deciding = None
    height = fx.ask("height")
    if height and ground is None:  # over uneven ground modules roll and pitch until the loads are what they are
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


@dataclass(frozen=True)
class Stand:
    """How a wheel stands on the ground.

    Attributes
    ----------
    place : array, shape (3,)
        Of its centre in `map`, m.
    partials : array, shape (3, 16)
        d p_*/d x of eq. 19.
    frame : array, shape (3, 3)
        Columns: along the wheel and across it, in the ground's plane, and the normal.
    F_n : float
        N, by its spring.
    k, mu : float
        Factors of the ground's stiffness and friction here.
    below : float
        How far below the centre the forces act, m.
    """

    place: Array
    partials: Array
    frame: Array
    F_n: float
    k: float
    mu: float
    below: float


def _partials(p: Params, b: int, q: Array, point: Array, pitching: float) -> Array:
    """d/d x of a point of a module (3, 16), given in its frame; pitch counts where it reaches the wheels."""
    R_x, dR_x, _ = rotation_x(q[b + 3])
    R_y, dR_y, _ = rotation_y(pitching * q[b + 4])
    R_z, dR_z, _ = rotation_z(q[b + 5])
    jacobian = np.zeros((3, 16))
    jacobian[:, b : b + 3] = np.eye(3)
    jacobian[:, b + 3] = R_z @ (R_y @ (dR_x @ point))
    if pitching:
        jacobian[:, b + 4] = pitching * R_z @ (dR_y @ (R_x @ point))
    jacobian[:, b + 5] = dR_z @ (R_y @ (R_x @ point))
    return jacobian


def _unloaded_radius(p: Params, body: ModuleParams, b: int, side: int, end: int, fx: PlainEffects) -> float:
    """A wheel's radius without load, m: the rover stands level, whatever each wheel carries."""
    x, y = fx.ask("centre", b // 8)
    share = (1 + end * x / body.half_x) * (1 + side * y / body.half_y)
    return float(body.r_0 - body.m * p.g_z / 4 * (share - 1) / p.k_n)


def _on_flat(p: Params, body: ModuleParams, b: int, side: int, end: int, q: Array, v: Array, fx: PlainEffects) -> Stand:
    """On the plane z = 0, as the paper has it: pitch does not move a wheel, and F_n turns with the module's roll."""
    centre = np.array([end * body.half_x, side * body.half_y, 0.0])
    frame = rotation_z(q[b + 5])[0] @ rotation_x(q[b + 3])[0]
    place, partials = q[b : b + 3] + frame @ centre, _partials(p, b, q, centre, 0.0)
    sunk = _unloaded_radius(p, body, b, side, end, fx) - place[2]
    F_n = max(p.k_n * sunk - p.c_n * (partials @ v)[2], 0.0)
    return Stand(place, partials, frame, F_n, 1.0, 1.0, 0.0)


def _on_uneven(
    p: Params, body: ModuleParams, b: int, side: int, end: int, q: Array, v: Array, fx: PlainEffects, ground: Surface
) -> Stand:
    """On a surface: eq. 15's spring is vertical under the wheel and pushes along the surface's normal.

    So its force is the gradient of what it stores. Where pitch does not reach the wheels, those of a side sit on a
    rocker that tilts with the ground, so that both sink in alike.
    """
    R = rotation_z(q[b + 5])[0] @ rotation_y(p.pitching * q[b + 4])[0] @ rotation_x(q[b + 3])[0]
    places, partials, heights, rises = {}, {}, {}, {}
    for one in (1, -1):
        centre = np.array([one * body.half_x, side * body.half_y, 0.0])
        places[one], partials[one] = q[b : b + 3] + R @ centre, _partials(p, b, q, centre, p.pitching)
        heights[one], *slopes = (float(value) for value in sample(ground, *places[one][:2])[:3])
        rises[one] = np.array(slopes) @ partials[one][:2]  # d h/d x
        if one == end:
            slope = np.array(slopes)
    place, jacobian = places[end], partials[end]
    if p.pitching == 0.0:
        place[2] += 0.5 * end * (heights[1] - heights[-1])
        jacobian[2] += 0.5 * end * (rises[1] - rises[-1])
    sunk = _unloaded_radius(p, body, b, side, end, fx) + heights[end] - place[2]
    upward = max(p.k_n * sunk + p.c_n * (rises[end] - jacobian[2]) @ v, 0.0)
    normal = np.array([-slope[0], -slope[1], 1.0])
    steepness = float(np.linalg.norm(normal))
    along = np.cross(R[:, 1], normal)
    along /= np.linalg.norm(along)
    normal /= steepness
    k, mu = (float(value) for value in sample(ground, *place[:2])[3:])
    frame = np.column_stack([along, np.cross(normal, along), normal])
    return Stand(place, jacobian, frame, upward * steepness, k, mu, fx.ask("height"))


def _wheel(
    p: Params, body: ModuleParams, b: int, side: int, end: int, q: Array, v: Array, fx: PlainEffects, kept: Array,
    dt: float, loads: tuple, ground: Surface | None,
) -> tuple:  # fmt: skip
    """One wheel: `side` is −1 on the right, `end` is 1 in front.

    `loads` are what it carries, and that by which eq. 16 decides whether it slides (N); None: that of its spring.
    """
    R_z = rotation_z(q[b + 5])[0]
    stand, other = (
        _on_flat(p, body, b, side, one, q, v, fx) if ground is None
        else _on_uneven(p, body, b, side, one, q, v, fx, ground)
        for one in (end, -end)
    )  # fmt: skip
    place, spring = stand.place, stand.F_n
    v_x, v_y, _ = stand.frame.T @ (stand.partials @ v)
    both_x = v_x if ground is None else 0.5 * (v_x + (other.frame.T @ (other.partials @ v))[0])
    F_n, deciding = (spring if load is None else load for load in loads)
    motor_number = (0 if b == 0 else 2) + (0 if side < 0 else 1)
    motor, c = motors_of(p)[motor_number], b + (6 if side < 0 else 7)
    wheel = 2 * motor_number + (0 if end > 0 else 1)
    radius = motor.r_w * fx.ask("radius", wheel, motor.tau * q[c])
    slip = radius * motor.tau * v[c] - v_x
    soil = fx.ask("soil")
    grip = stand.mu * soil * fx.ask("grip", place[0], place[1])
    fastest = max(abs(slip + v_x), math.hypot(v_x, v_y))
    stiffness = stand.k * soil * fx.ask("stiffness_by_load", F_n / p.load) * fx.ask("stiffness_by_speed", fastest**2)
    F_l, steady = stiffness * body.k_l * slip, -stiffness * body.k_t * v_y
    F_t, F_rate = _built_up(fx, steady, kept[0], v_x, dt)
    stiff, renewal = fx.ask("bristle", slip + v_x)
    k = stiffness * np.array([body.k_l, body.k_t])
    F_l, F_t = np.array([F_l, F_t]) + stiff * k * kept[2:]
    narrow, held, sliding = 1.0 / fx.ask("lateral_grip"), 1.0, np.zeros(2)
    F_h = math.hypot(F_l, narrow * F_t)
    if F_h > grip * body.mu_s * deciding:
        mu = fx.ask("friction", grip * body.mu_s, grip * body.mu_d, math.hypot(slip, v_y))
        held, sliding = mu * F_n / F_h, mu / F_h * np.array([F_t, F_l])
    omega_rim = motor.r_w * motor.tau * v[c]
    own = Own(v_x, v_y, omega_rim - v_x, motor.tau * q[c], place[0], place[1], F_n)
    middle = 0.5 * (place + other.place)
    shared = Own(both_x, math.nan, omega_rim - both_x, own.angle, middle[0], middle[1], math.nan)  # no law takes NaNs
    way, there, winding = fx.ask("windup"), 1.0, 0.0
    if way > 0:
        there = 0.5 * (1 + (kept[1] if F_l > 0 else -kept[1]))
        winding = (slip - abs(slip) * kept[1]) / (way + dt * abs(slip))
    sliding[1] *= there
    F_l = there * held * F_l + fx.ask("along", motor_number, shared) / 2  # half of what acts at both of its wheels
    F_t = held * F_t + fx.ask("lateral", v_y) + fx.ask("across", wheel, own)
    bending = np.zeros(2)
    if stiff > 0:
        left = held * np.array([slip, -v_y])
        release = renewal + stiff * math.hypot(*(k * left * [1.0, narrow])) / max(grip * body.mu_s * F_n, LIGHT)
        bending = (left - release * kept[2:]) / (1 + dt * release)
    u = p.u_w * fx.ask("lead", v_x, v_y)
    ahead = _partials(p, b, q, np.array([u, 0.0, -stand.below]), p.pitching if ground else 0.0)  # eq. 20
    if ground is not None:
        ahead[:, b + 4] -= _partials(p, b, q, np.array([u, 0.0, 0.0]), p.pitching)[:, b + 4]  # which is of yaw alone
    ahead[:, b : b + 3] = 0.0
    Q = (stand.partials + ahead).T @ (stand.frame @ np.array([F_l, F_t, spring]))  # eq. 18
    resisted = fx.ask("wheel_resist", grip * body.mu_s * F_n, v_x, v_y)
    more = sliding + np.array(resisted[::-1]) / max(F_n, LIGHT)
    flat = R_z @ np.array([*resisted, 0.0])
    R = np.zeros(16)
    R[[b, b + 1]], R[b + 5] = flat[:2], flat @ stand.partials[:, b + 5]
    rates, k_l = np.array([F_rate, winding, *bending]), stiffness * body.k_l
    return v_x, v_y, F_n, F_l, F_t, u, held, k_l, there * held * k_l, radius, rates, Q, R, more


def _built_up(fx: PlainEffects, steady: float, now: float, p_x: float, dt: float) -> tuple[float, float]:
    """A lateral force before saturation at the end of `dt` (s), where it lags: N, and its rate, N/s."""
    follow = fx.ask("follow_rate", p_x)
    if follow == 0:
        return steady, 0.0
    rate = follow * (steady - now) / (1 + dt * follow)
    return now + dt * rate, rate
