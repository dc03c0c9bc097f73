"""Wheel and ground in plain NumPy: eqs 15 to 20, and what the effects make of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects.force_law import LocalMotion
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


@dataclass(frozen=True)
class Mount:
    """Where a wheel is mounted: on which module (`b`: where its coordinates begin), side and end.

    `side` is −1 on the right and 1 on the left, `end` is 1 in front and −1 behind.
    """

    body: ModuleParams
    b: int
    side: int
    end: int

    @property
    def centre(self) -> Array:
        """The wheel's centre in the module's frame, m."""
        return np.array([self.end * self.body.half_x, self.side * self.body.half_y, 0.0])

    @property
    def motor(self) -> int:
        """Number of its motor, as in `MOTORS`."""
        return (0 if self.b == 0 else 2) + (0 if self.side < 0 else 1)

    @property
    def wheel(self) -> int:
        """Number among all wheels."""
        return 2 * self.motor + (0 if self.end > 0 else 1)

    @property
    def rotation(self) -> int:
        """Where its motor's angle stands among the coordinates."""
        return self.b + (6 if self.side < 0 else 7)

    @property
    def other(self) -> Mount:
        """The other wheel of the same motor."""
        return replace(self, end=-self.end)


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
    mounts = [Mount(body, b, side, end) for body, b in modules_of(p) for side in (-1, 1) for end in (1, -1)]

    def wheels(effects: PlainEffects, rates: Array, loads: Loads, step: float) -> Wheels:
        rows = [
            _wheel(
                p, mount, q, rates, effects, kept[i], step,
                tuple(None if load is None else load[i] for load in loads), ground,
            )
            for i, mount in enumerate(mounts)
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


def _unloaded_radius(p: Params, mount: Mount, fx: PlainEffects) -> float:
    """A wheel's radius without load, m: the rover stands level, whatever each wheel carries."""
    body, (x, y) = mount.body, fx.ask("centre", mount.b // 8)
    share = (1 + mount.end * x / body.half_x) * (1 + mount.side * y / body.half_y)
    return float(body.r_0 - body.m * p.g_z / 4 * (share - 1) / p.k_n)


def _on_flat(p: Params, mount: Mount, q: Array, v: Array, fx: PlainEffects) -> Stand:
    """On the plane z = 0, as the paper has it: pitch does not move a wheel, and F_n turns with the module's roll."""
    b = mount.b
    frame = rotation_z(q[b + 5])[0] @ rotation_x(q[b + 3])[0]
    place, partials = q[b : b + 3] + frame @ mount.centre, _partials(p, b, q, mount.centre, 0.0)
    sunk = _unloaded_radius(p, mount, fx) - place[2]
    F_n = max(p.k_n * sunk - p.c_n * (partials @ v)[2], 0.0)
    return Stand(place, partials, frame, F_n, 1.0, 1.0, 0.0)


def _on_uneven(p: Params, mount: Mount, q: Array, v: Array, fx: PlainEffects, ground: Surface) -> Stand:
    """On a surface: eq. 15's spring is vertical under the wheel and pushes along the surface's normal.

    So its force is the gradient of what it stores. Where pitch does not reach the wheels, those of a side sit on a
    rocker that tilts with the ground, so that both sink in alike.
    """
    b, end = mount.b, mount.end
    R = rotation_z(q[b + 5])[0] @ rotation_y(p.pitching * q[b + 4])[0] @ rotation_x(q[b + 3])[0]
    places, partials, heights, rises = {}, {}, {}, {}
    for one in (mount, mount.other):
        places[one.end] = q[b : b + 3] + R @ one.centre
        partials[one.end] = _partials(p, b, q, one.centre, p.pitching)
        heights[one.end], *slopes = (float(value) for value in sample(ground, *places[one.end][:2])[:3])
        rises[one.end] = np.array(slopes) @ partials[one.end][:2]  # d h/d x
        if one is mount:
            slope = np.array(slopes)
    place, jacobian = places[end], partials[end]
    if p.pitching == 0.0:
        place[2] += 0.5 * end * (heights[1] - heights[-1])
        jacobian[2] += 0.5 * end * (rises[1] - rises[-1])
    sunk = _unloaded_radius(p, mount, fx) + heights[end] - place[2]
    upward = max(p.k_n * sunk + p.c_n * (rises[end] - jacobian[2]) @ v, 0.0)
    normal = np.array([-slope[0], -slope[1], 1.0])
    steepness = float(np.linalg.norm(normal))
    along = np.cross(R[:, 1], normal)
    along /= np.linalg.norm(along)
    normal /= steepness
    k, mu = (float(value) for value in sample(ground, *place[:2])[3:])
    frame = np.column_stack([along, np.cross(normal, along), normal])
    return Stand(place, jacobian, frame, upward * steepness, k, mu, fx.ask("height"))


@dataclass(frozen=True)
class Rolling:
    """How a wheel moves: p_x and p_y of its centre, m/s, speed (m/s) and angle of its rim, and its radius, m.

    `slip` (m/s) is how much faster the wheel rolls than its centre goes.
    """

    p_x: float
    p_y: float
    rim: float
    angle: float
    radius: float
    slip: float


def _rolling(p: Params, mount: Mount, stand: Stand, q: Array, v: Array, fx: PlainEffects) -> Rolling:
    motor, c = motors_of(p)[mount.motor], mount.rotation
    p_x, p_y, _ = stand.frame.T @ (stand.partials @ v)
    radius = motor.r_w * fx.ask("radius", mount.wheel, motor.tau * q[c])
    return Rolling(p_x, p_y, motor.r_w * motor.tau * v[c], motor.tau * q[c], radius, radius * motor.tau * v[c] - p_x)


@dataclass(frozen=True)
class Soil:
    """The ground under one wheel as effects leave it: k_l and k_t (2,), N s/m, and the factor on mu_s and mu_d."""

    k: Array
    grip: float


def _soil(mount: Mount, stand: Stand, F_n: float, load: float, rolling: Rolling, fx: PlainEffects) -> Soil:
    factor = fx.ask("soil")
    grip = stand.mu * factor * fx.ask("grip", stand.place[0], stand.place[1])
    fastest = max(abs(rolling.slip + rolling.p_x), math.hypot(rolling.p_x, rolling.p_y))
    by_load, by_speed = fx.ask("stiffness_by_load", F_n / load), fx.ask("stiffness_by_speed", fastest**2)
    stiffness = stand.k * factor * by_load * by_speed
    return Soil(stiffness * np.array([mount.body.k_l, mount.body.k_t]), grip)


def _eq_15(soil: Soil, rolling: Rolling, kept: Array, dt: float, stiff: float, fx: PlainEffects) -> tuple[Array, float]:
    """Forces along and across (2,), N, before eq. 16, and the rate of a lateral force that lags, N/s.

    `stiff` (1/s) is how stiff bristles are beside k_l and k_t.
    """
    F_l, steady = soil.k[0] * rolling.slip, -soil.k[1] * rolling.p_y
    F_t, rate = _built_up(fx, steady, kept[0], rolling.p_x, dt)
    return np.array([F_l, F_t]) + stiff * soil.k * kept[2:], rate


def _eq_16(
    mount: Mount, soil: Soil, F: Array, F_n: float, deciding: float, rolling: Rolling, fx: PlainEffects
) -> tuple[float, Array]:
    """What is left of a wheel's forces where it slides, and what each newton of load adds to them across and along.

    `deciding` is the load by which it slides or holds, N.
    """
    narrow, slip = 1.0 / fx.ask("lateral_grip"), math.hypot(rolling.slip, rolling.p_y)
    mu_s, mu_d = soil.grip * mount.body.mu_s, soil.grip * mount.body.mu_d
    F_h, mu = math.hypot(F[0], narrow * F[1]), fx.ask("friction", mu_s, mu_d, slip)
    if F_h <= (mu_s + fx.ask("early_fall") * (mu - mu_s)) * deciding:
        return 1.0, np.zeros(2)
    return mu * F_n / F_h, mu / F_h * F[::-1]


def _windup(F_l: float, slip: float, wound: float, dt: float, fx: PlainEffects) -> tuple[float, float]:
    """Share of the longitudinal force that has built up, and the rate at which it winds up, 1/s."""
    way = fx.ask("windup")
    if way <= 0:
        return 1.0, 0.0
    share = 0.5 * (1 + (wound if F_l > 0 else -wound))
    return share, (slip - abs(slip) * wound) / (way + dt * abs(slip))


def _eq_20(p: Params, mount: Mount, stand: Stand, u: float, q: Array, ground: Surface | None) -> Array:
    """By how much farther ahead forces act than in the wheel's centre, as partials of the rotations (3, 16)."""
    b = mount.b
    ahead = _partials(p, b, q, np.array([u, 0.0, -stand.below]), p.pitching if ground else 0.0)
    if ground is not None:
        ahead[:, b + 4] -= _partials(p, b, q, np.array([u, 0.0, 0.0]), p.pitching)[:, b + 4]  # which is of yaw alone
    ahead[:, b : b + 3] = 0.0
    return ahead


def _followed(
    rolling: Rolling, other: Stand, stand: Stand, v: Array, F_n: float, ground: Surface | None
) -> tuple[LocalMotion, LocalMotion]:
    """What laws may follow at the wheel, and at both wheels of its motor together; no law takes the NaNs."""
    wheel = LocalMotion(
        rolling.p_x, rolling.p_y, rolling.rim - rolling.p_x, rolling.angle, stand.place[0], stand.place[1], F_n
    )
    both = rolling.p_x if ground is None else 0.5 * (rolling.p_x + (other.frame.T @ (other.partials @ v))[0])
    x, y = 0.5 * (stand.place + other.place)[:2]
    return wheel, LocalMotion(both, math.nan, rolling.rim - both, rolling.angle, x, y, math.nan)


def _wheel(
    p: Params, mount: Mount, q: Array, v: Array, fx: PlainEffects, kept: Array, dt: float, loads: tuple,
    ground: Surface | None,
) -> tuple:  # fmt: skip
    """One wheel's row of `Wheels`.

    `loads` are what it carries, and that by which eq. 16 decides whether it slides (N); None: that of its spring.
    """
    stand, other = (
        _on_flat(p, one, q, v, fx) if ground is None else _on_uneven(p, one, q, v, fx, ground)
        for one in (mount, mount.other)
    )
    F_n, deciding = (stand.F_n if load is None else load for load in loads)
    rolling = _rolling(p, mount, stand, q, v, fx)
    slip, p_x, p_y = rolling.slip, rolling.p_x, rolling.p_y
    soil = _soil(mount, stand, F_n, p.load, rolling, fx)
    stiff, renewal = fx.ask("bristle", slip + p_x)
    F, F_rate = _eq_15(soil, rolling, kept, dt, stiff, fx)
    held, sliding = _eq_16(mount, soil, F, F_n, deciding, rolling, fx)
    share, winding = _windup(F[0], slip, kept[1], dt, fx)
    sliding[1] *= share
    most = soil.grip * mount.body.mu_s * F_n
    bending = np.zeros(2)
    if stiff > 0:
        bending = _bending(held * np.array([slip, -p_y]), kept[2:], soil.k, stiff, renewal, most, dt, fx)
    at_wheel, at_both = _followed(rolling, other, stand, v, F_n, ground)
    F_l = share * held * F[0] + fx.ask("along", mount.motor, at_both) / 2  # half of what acts at both of its wheels
    F_t = held * F[1] + fx.ask("lateral", p_y, F_n) + fx.ask("across", mount.wheel, at_wheel)
    u = p.u_w * fx.ask("lead", p_x, p_y)
    partials = stand.partials + _eq_20(p, mount, stand, u, q, ground)
    Q = partials.T @ (stand.frame @ np.array([F_l, F_t, stand.F_n]))  # eq. 18
    resisted = fx.ask("wheel_resist", most, p_x, p_y)
    more = sliding + np.array(resisted[::-1]) / max(F_n, LIGHT)
    b, flat, R = mount.b, rotation_z(q[mount.b + 5])[0] @ np.array([*resisted, 0.0]), np.zeros(16)
    R[[b, b + 1]], R[b + 5] = flat[:2], flat @ stand.partials[:, b + 5]
    rates, k_l = np.array([F_rate, winding, *bending]), soil.k[0]
    return p_x, p_y, F_n, F_l, F_t, u, held, k_l, share * held * k_l, rolling.radius, rates, Q, R, more


def _bending(
    slip: Array, z: Array, k: Array, stiff: float, renewal: float, most: float, dt: float, fx: PlainEffects
) -> Array:
    """How fast bristles bend (2,), m/s: they give way along the normal of what friction holds, `most` (N)."""
    shape = np.array([1.0, 1.0 / fx.ask("lateral_grip")])
    F = stiff * k * (z + dt * slip) / (1 + dt * renewal)
    normal, used = shape**2 * F, float(np.linalg.norm(shape * F)) / max(most, LIGHT)
    plastic = max(float(normal @ (k * slip)), 0.0) / max(float(normal @ (k * normal)), 1e-30)
    release = renewal + used * plastic * stiff * shape**2 * k
    rate: Array = (slip - release * z) / (1 + dt * release)
    return rate


def _built_up(fx: PlainEffects, steady: float, now: float, p_x: float, dt: float) -> tuple[float, float]:
    """A lateral force before saturation at the end of `dt` (s), where it lags: N, and its rate, N/s."""
    follow = fx.ask("follow_rate", p_x)
    if follow == 0:
        return steady, 0.0
    rate = follow * (steady - now) / (1 + dt * follow)
    return now + dt * rate, rate
