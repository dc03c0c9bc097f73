"""How long a step may be: the fastest modes of the model against each integrator's stability region."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.equations.transmission import DRIVEN, PRESCRIBED
from artibot_sim.model.robot.parameters import ModuleParams, MotorParams, Params

Array = NDArray[np.float64]

ARTICULATIONS = (0.0, 0.4, 0.8, 1.2)
"""Articulation yaws (rad) at which the modes are taken; which one is stiffest depends on the robot."""


OVERSHOOT = 0.5
"""How far beyond its goal a semi-implicit step may carry the fastest slip of a module, as a share of the way."""

MARGIN = 0.95
"""Longest semi-implicit step over the one at which an oscillation no longer dies down."""


def implicit_slip(p: Params, dt: float) -> Params:
    """`p` as a semi-implicit step of `dt` (s) takes it: the modules' slip implicit, as far as the step needs it.

    Linearised, a step that takes the share theta of a slip at its end has M + theta dt D in place of M, D being
    eq. 15's damping of x, y and gamma. theta is the smallest at which no slip overshoots by more than OVERSHOOT,
    (1 + OVERSHOOT) (M + theta dt D) >= dt D: none at a step so short that M alone does, and no slip limits the step.
    Sliding wheels (eq. 16) and the joint only make a slip slower.
    """
    h = dt / (1.0 + OVERSHOOT)

    def module(body: ModuleParams) -> ModuleParams:
        along, across = body.k_l + p.forward_damping, body.k_t + p.lateral_damping
        m = max(body.m, h * 4.0 * max(along, across))
        J_z = max(body.J_z, h * 4.0 * (across * body.half_x**2 + along * body.half_y**2))
        return body._replace(inverse=(1 / m, 1 / m, *body.inverse[2:5], 1 / J_z), sluggish=m - body.m)

    return p._replace(front=module(p.front), back=module(p.back))


@lru_cache(maxsize=256)
def largest_step(p: Params, integrator: str, modes: tuple[int, ...]) -> tuple[float, str]:
    """Longest stable step (s), and which motion sets it.

    The model is linearised about wheels that hold (eq. 15) and turn; saturated ones are slower. Under RK4 motors that
    are not prescribed spin freely against the same slip that brakes the modules, so their rates add. The
    semi-implicit integrator takes spin and slip implicitly; the springs and the control loops limit its step.
    """
    modes = modes[: 4 if p.two else 2]
    limits = list(_rk4_limits(p, modes) if integrator == "rk4" else _semi_implicit_limits(p))
    if PRESCRIBED in modes:
        limits.append(((_RK4_REAL if integrator == "rk4" else MARGIN) / p.A_motor, "control.A_motor"))
    if DRIVEN in modes:
        limits.append(((_RK4_REAL if integrator == "rk4" else 2 * MARGIN) / p.velocity_gain, "control.velocity_gain"))
    return min(limits)


def _rk4_limits(p: Params, modes: tuple[int, ...]) -> Iterator[tuple[float, str]]:
    free = tuple(mode != PRESCRIBED for mode in modes)
    slip = "slip of the wheels" + (" and spin of the motors that are not prescribed" if any(free) else "")
    yield from ((_rk4_limit(rate), slip) for rate in _slip_modes(p, free))
    for damping, stiffness, what in _springs(p):
        yield _rk4_limit(cmath.sqrt(damping * damping / 4 - stiffness) - damping / 2), what
        yield _rk4_limit(-cmath.sqrt(damping * damping / 4 - stiffness) - damping / 2), what


def _semi_implicit_limits(p: Params) -> Iterator[tuple[float, str]]:
    """Of v += -h (stiffness x + damping v), x += h v, which is stable while stiffness h² + 2 damping h < 4."""
    for damping, stiffness, what in _springs(p, implicit=True):
        if damping + stiffness > 0.0:
            yield MARGIN * 4 / (damping + math.sqrt(damping * damping + 4 * stiffness)), what


def _springs(p: Params, implicit: bool = False) -> Iterator[tuple[float, float, str]]:
    """Damping (1/s) and stiffness (1/s²) of each module's heave and roll, of the joint's gap, and of its yaw.

    Damping in the joint's yaw counts only where it is not taken implicitly.
    """
    for body in (p.front, p.back)[: 2 if p.two else 1]:
        for inverse in (4.0 / body.m, 4.0 * body.half_y**2 / body.J_x):
            yield p.c_n * inverse, p.k_n * inverse, "vertical motion on the wheels"
    if p.two and p.A_joint > 0.0:
        yield 2 * p.A_joint, p.A_joint**2, "control.A_joint"
    if p.two and p.joint_damping + p.joint_stiffness > 0.0:
        inverse = 1 / p.front.J_z + 1 / p.back.J_z
        yield (0.0 if implicit else inverse * p.joint_damping), inverse * p.joint_stiffness, "torque in the joint's yaw"


def _rk4_limit(rate: complex) -> float:
    """Longest step for which exp(rate t) does not grow under the classical Runge-Kutta method."""
    return _rk4_radius(rate / abs(rate)) / abs(rate) if rate != 0 else math.inf


@lru_cache(maxsize=256)
def _rk4_radius(direction: complex) -> float:
    """How far the stability region reaches in a direction; nearly all rates are real, so it is mostly known."""
    s = np.linspace(0.0, 3.0, 3001)[1:]
    z = s * direction
    growing = np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) > 1 + 1e-9
    # z with a positive real part grows as it should, whatever the step
    return float(s[np.argmax(growing) - 1]) if growing.any() and direction.real <= 0 else math.inf


_RK4_REAL = _rk4_radius(complex(-1.0))


def _slip_modes(p: Params, free: tuple[bool, ...]) -> Iterator[complex]:
    """Eigenvalues (1/s) of the planar velocities and the free motors' speeds, for wheels that hold."""
    motors = (p.right_front, p.left_front, p.right_back, p.left_back)[: 4 if p.two else 2]
    matrices = []
    for articulation in ARTICULATIONS if p.two else (0.0,):
        for braking in (False, True):
            etas = [1.0 / motor.eta_r if braking else motor.eta_d for motor in motors]
            matrices.append(_slip_matrix(p, motors, etas, free, articulation))
    yield from np.linalg.eigvals(np.array(matrices)).ravel()


def _slip_matrix(
    p: Params, motors: tuple[MotorParams, ...], etas: list[float], free: tuple[bool, ...], articulation: float
) -> Array:
    """d/dt of (x, y, gamma of each module, free motors) = matrix · the same, the joint's two planar rows eliminated."""
    bodies = ((p.front, 0.0), (p.back, articulation))[: 2 if p.two else 1]
    spinning = [i for i in range(len(motors)) if free[i]]
    size = 3 * len(bodies) + len(spinning)
    inverse, damping = np.zeros(size), np.zeros((size, size))
    for b, (body, _) in enumerate(bodies):
        inverse[3 * b : 3 * b + 3] = 1 / body.m, 1 / body.m, 1 / body.J_z
    for i, motor in enumerate(motors):
        body, yaw = bodies[i // 2]
        y = -body.half_y if i % 2 == 0 else body.half_y
        c, s = math.cos(yaw), math.sin(yaw)
        for x in (body.half_x, -body.half_x):
            along, across = np.zeros(size), np.zeros(size)
            along[3 * (i // 2) : 3 * (i // 2) + 3] = -c, -s, y
            across[3 * (i // 2) : 3 * (i // 2) + 3] = -s, c, x
            damping += p.forward_damping * np.outer(along, along)
            force = along.copy()
            if free[i]:
                k = 3 * len(bodies) + spinning.index(i)
                gear = motor.tau / etas[i]
                along[k] = motor.r_w * motor.tau
                force[k] = motor.r_w * gear  # eq. 21: the gear's efficiency makes the pair unsymmetric
                inverse[k] = 1 / (motor.J_m + motor.J_w * motor.tau * gear)
            damping += body.k_l * np.outer(force, along) + (body.k_t + p.lateral_damping) * np.outer(across, across)
    if not p.two:
        return -inverse[:, None] * damping
    twist = np.zeros(size)
    twist[[2, 5]] = -1.0, 1.0
    damping += p.joint_damping * np.outer(twist, twist)
    joint = np.zeros((2, size))
    s, c = math.sin(articulation), math.cos(articulation)
    joint[:, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, p.front.O_x]])
    joint[:, 3:6] = np.array([[-1.0, 0.0, p.back.O_x * s], [0.0, -1.0, -p.back.O_x * c]])
    weighted = joint * inverse
    project = np.eye(size) - weighted.T @ np.linalg.solve(weighted @ joint.T, joint)
    return -project @ (inverse[:, None] * damping)
