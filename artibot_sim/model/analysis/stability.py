"""How long a step may be: the fastest modes of the model against each integrator's stability region."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.equations.transmission import DRIVEN, PRESCRIBED, TORQUE
from artibot_sim.model.robot.parameters import ModuleParams, MotorParams, Params, Train
from artibot_sim.model.robot.robot import Robot

Array = NDArray[np.float64]

Shares = float | tuple[float, ...]
"""Eq. 30's factor of one back motor, or of a motor of each module."""

ARTICULATIONS = (0.0, 0.4, 0.8, 1.2)
"""Articulation yaws (rad) at which the modes are taken; which one is stiffest depends on the robot."""


MARGIN = 0.95
"""Longest semi-implicit step over the one at which an oscillation no longer dies down."""


class _Chain(NamedTuple):
    """Modules in a row: scalars they share, those of each, bodies, two motors each, where joints sit on both bodies."""

    p: Params
    own: tuple[Params, ...]
    bodies: tuple[ModuleParams, ...]
    motors: tuple[MotorParams, ...]
    hinges: tuple[tuple[float, float], ...]


_STEEP = ("stiffening", "forward_damping", "lateral_damping", "joint_damping", "joint_stiffness")
"""What effects add in some modules or joints: the steepest limits the step as if all had it."""


def _chain(p: Params | Train) -> _Chain:
    if isinstance(p, Train):
        motors = tuple(motor for module in p.modules for motor in (module.right_front, module.left_front))
        hinges = tuple((joint.front.O_x, joint.back.O_x) for joint in p.joints)
        steepest = {name: max(getattr(module, name) for module in p.modules) for name in _STEEP}
        shared = p.modules[0]._replace(**steepest)
        return _Chain(shared, p.modules, tuple(module.front for module in p.modules), motors, hinges)
    if p.two:
        motors = (p.right_front, p.left_front, p.right_back, p.left_back)
        return _Chain(p, (p, p), (p.front, p.back), motors, ((p.front.O_x, p.back.O_x),))
    return _Chain(p, (p,), (p.front,), (p.right_front, p.left_front), ())


def _by_module(chain: _Chain, share: Shares) -> tuple[float, ...]:
    """Eq. 30's factors, one a module; the front one's is zero."""
    return share if isinstance(share, tuple) else (0.0, share)[: len(chain.bodies)]


LONGEST_PART = 1e-3
"""Part (s) of a semi-implicit step beyond which its errors, which grow with it, pass 5 mm over Table 6."""

LONGEST_SLIP_PART = 0.45
"""Part (s) of a semi-implicit step, times the rate (1/s) at which the fastest slip of a holding module decays, beyond
which the step is too long: an explicit step is stable up to 2."""

MOST_PARTS = 100_000
"""More parts of a step than any ground asks for: at 1 ms they would take ten seconds for each of a drive."""

SHARING = "control.kappa, torque sharing"
"""Words for the motion that torque sharing makes."""


def parts(p: Params | Train, dt: float, share: Shares = 0.0) -> int:
    """Into how many equal parts a semi-implicit step of `dt` (s) is cut so that its result can be trusted.

    The slip of a module is explicit, and on stiff ground faster than a step. Parts are short beside it, whatever the
    ground: errors are known before the run, and what grows is its cost. Parts are as short as the torque sharing needs,
    too; `share` is eq. 30's factor of one back motor.
    """
    chain = _chain(p)
    slip = max(_fastest_slip(chain.p, body) for body in chain.bodies) / LONGEST_SLIP_PART
    limits = (
        (1.0 / LONGEST_PART, "accuracy"),
        (slip, "slip of the wheels"),
        (1.0 / _quick_sharing_limit(chain, share), SHARING),
    )
    rate, motion = max(limits)
    return number_of_parts(dt, rate, motion)


def number_of_parts(dt: float, rate: float, motion: str) -> int:
    """How many equal parts of a step of `dt` (s) are no longer than 1/rate (s), as a motion asks; not too many."""
    count = dt * rate
    if not count <= MOST_PARTS:
        raise ArtibotError(
            f"dt: a step of {dt:g} s would be cut into {count:.2g} parts ({motion}); expected at most {MOST_PARTS:g}; "
            "take softer ground, weaker effects or a larger kappa"
        )
    return max(1, math.ceil(count - 1e-9))


def _fastest_slip(p: Params, body: ModuleParams) -> float:
    """The fastest rate (1/s) at which the slip of a module whose wheels hold decays, its wheels turning as they do."""
    along, across = p.stiffening * body.k_l + p.forward_damping, p.stiffening * body.k_t + p.lateral_damping
    swing = 4.0 * (across * body.half_x**2 + along * body.half_y**2)
    return max(4.0 * max(along, across) / body.m, swing / body.J_z)


def slip_time(p: Params) -> float:
    """How long (s) the fastest slip of a rigid rover takes to decay to 1/e while its wheels hold."""
    return 1.0 / _fastest_slip(p, p.front)


def slip_speedup(p: Params, than: Params) -> float:
    """By what factor slip decays faster than in another rover of the same layout, at most.

    Rates of decay are those of damping over inertia: none grows by more than the dampers do, over what inertias shrink.
    At once, where many rovers of one kind are asked.
    """
    worst = 0.0
    for body, other in ((p.front, than.front), (p.back, than.back)) if p.two else ((p.front, than.front),):
        along = (p.stiffening * body.k_l + p.forward_damping) / (than.stiffening * other.k_l + than.forward_damping)
        across = (p.stiffening * body.k_t + p.lateral_damping) / (than.stiffening * other.k_t + than.lateral_damping)
        worst = max(worst, max(along, across) * max(other.m / body.m, other.J_z / body.J_z))
    return worst


def rigid_limit(p: Params, speed: float) -> float:
    """Longest RK4 step (s) of a rigid rover with prescribed motors whose wheels are as fast as `speed` (m/s).

    That of its slip, and of what its wheels remember; at once, where many rovers of one kind are asked.
    """
    slip = _RK4_REAL / _fastest_slip(p, p.front)
    return min(slip, relaxation_limit(p, speed)) if p.relaxation + p.bristle > 0.0 else slip


@lru_cache(maxsize=256)
def largest_step(p: Params | Train, integrator: str, modes: tuple[int, ...], share: Shares = 0.0) -> tuple[float, str]:
    """Longest stable step (s), and which motion sets it; `share` is eq. 30's factor of one back motor.

    The model is linearised about wheels that hold (eq. 15) and turn; saturated ones are slower. Under RK4 motors that
    are not prescribed spin freely against the same slip that brakes the modules, so their rates add. The
    semi-implicit integrator takes spin implicitly and is cut into `parts` short beside the slip; the springs and the
    control loops limit its step.

    Back motors that share the front ones' torque of the step before (eq. 30) pull (1/kappa − 1) times as much as these,
    a step late: the smaller kappa, the shorter the step.
    """
    chain = _chain(p)
    modes, p = modes[: len(chain.motors)], chain.p
    chain = chain._replace(motors=tuple(map(_as_moved, chain.motors, modes)))
    limits = list(_rk4_limits(chain, modes) if integrator == "rk4" else _semi_implicit_limits(chain, modes))
    if PRESCRIBED in modes:
        limits.append(((_RK4_REAL if integrator == "rk4" else MARGIN) / p.A_motor, "control.A_motor"))
    if any(mode == DRIVEN and motor.loop == 0.0 for motor, mode in zip(chain.motors, modes, strict=True)):
        limits.append(((_RK4_REAL if integrator == "rk4" else 2 * MARGIN) / p.velocity_gain, "control.velocity_gain"))
    longest, what = min(limits)
    if integrator == "rk4" and TORQUE in modes[2:] and _quick_sharing_limit(chain, share) < longest:
        return min((longest, what), (_sharing_limit(chain, modes, share, longest), SHARING))
    return longest, what


def _as_moved(motor: MotorParams, mode: int) -> MotorParams:
    """A motor with a velocity loop only where it is driven by one."""
    return motor if mode == DRIVEN else motor._replace(loop=0.0, winding=0.0)


def _quick_sharing_limit(chain: _Chain, share: Shares) -> float:
    """A step (s) at which torque sharing is stable for certain: by the rover's mass in a straight line."""
    p, bodies = chain.p, chain.bodies
    more = sum(
        2.0 * factor * chain.motors[0].tau / motor.tau
        for factor, motor in zip(_by_module(chain, share), chain.motors[::2], strict=True)
        if factor > 0.0
    )
    if len(bodies) < 2 or more <= 0.0:
        return math.inf
    return 0.5 * sum(body.m for body in bodies) / (4.0 * p.stiffening * bodies[0].k_l * more)


def _bends(chain: _Chain) -> Iterator[tuple[float, ...]]:
    """Articulation yaws, one a joint, at which the modes are taken: bent all one way, and to and fro."""
    joints = len(chain.hinges)
    for bend in ARTICULATIONS if joints else (0.0,):
        yield (bend,) * joints
        if joints > 1 and bend:
            yield tuple(bend * (-1) ** j for j in range(joints))


def _sharing_limit(chain: _Chain, modes: tuple[int, ...], share: Shares, longest: float) -> float:
    """Longest RK4 step (s) up to `longest` at which the motions with eq. 30's torques, a step late, do not grow."""
    loops = [_sharing_loop(chain, modes, share, bends, braking) for bends in _bends(chain) for braking in (False, True)]
    A, B, K = (np.array(part) for part in zip(*loops, strict=True))
    unit = np.broadcast_to(np.eye(A.shape[-1]), A.shape)

    def grows(dt: float) -> bool:
        z = dt * A
        S = unit + z @ (unit / 2 + z @ (unit / 6 + z / 24))
        late = dt * (S @ B[:, :, None]) * K[:, None, :]
        step = np.block([[unit + z @ S, late], [unit, np.zeros_like(A)]])
        return bool(np.abs(np.linalg.eigvals(step)).max() > 1.0 + 1e-7)

    if not grows(longest):
        return longest
    low, high = 0.0, longest
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return low


def _sharing_loop(
    chain: _Chain, modes: tuple[int, ...], share: Shares, bends: tuple[float, ...], braking: bool
) -> tuple[Array, Array, Array]:
    """Of x' = A x + B K x(a step ago): `_slip_matrix`, what 1 of the front torques' sum does, and that sum by x."""
    p, _, bodies, motors, _ = chain
    front, factors = bodies[0], _by_module(chain, share)
    etas = [1.0 / motor.eta_r if braking else motor.eta_d for motor in motors]
    free = tuple(mode != PRESCRIBED for mode in modes)
    A = _slip_matrix(chain, etas, free, bends)
    first = 3 * len(bodies)
    places = dict(zip((i for i in range(len(motors)) if free[i]), range(first, len(A)), strict=True))
    B, K = np.zeros(len(A)), np.zeros(len(A))
    for i, motor in enumerate(motors):
        gear = motor.tau / etas[i]
        J = motor.J_m + motor.J_w * motor.tau * gear
        if i < 2 and motor.loop > 0.0:
            K[places[i]] -= motor.loop
        elif i < 2 and modes[i] != TORQUE:
            pull = 2.0 * gear * motor.r_w * p.stiffening * front.k_l
            K[:3] += pull * np.array([-1.0, 0.0, -front.half_y if i == 0 else front.half_y])
            if free[i]:
                K[places[i]] += pull * motor.r_w * motor.tau - p.velocity_gain * J
        if i > 1 and modes[i] == TORQUE:
            B[places[i]] = factors[i // 2] / J
    return A, B, K


RELAXATION = "effects.tyre_relaxation or stiction, forces that follow the way of the wheels"


def relaxation_limit(p: Params, speed: float) -> float:
    """Longest RK4 step (s) for what wheels remember at a wheel's `speed` (m/s), see `Params.relaxation`.

    Bristles beside a damper k = stiffness · T: where that is strong, they follow at 1/T; where it is weak, a mass m
    swings at sqrt(k/(T m)) < 2/T; where wheels slide, they let go at 1/T at most, times what bristles are stiffer one
    way than the other.
    """
    ratio = p.front.k_l / p.front.k_t
    return _RK4_REAL / (p.relaxation * max(speed, 0.05) + max(2.0, ratio, 1.0 / ratio) * p.bristle)


def _rk4_limits(chain: _Chain, modes: tuple[int, ...]) -> Iterator[tuple[float, str]]:
    free = tuple(mode != PRESCRIBED for mode in modes)
    slip = "slip of the wheels" + (" and spin of the motors that are not prescribed" if any(free) else "")
    yield from ((_rk4_limit(rate), slip) for rate in _slip_modes(chain, free))
    for motor, spins in zip(chain.motors, free, strict=False):
        if spins and motor.damping > 0.0:
            # A motor held by drag crosses zero and changes between eq. 21's driving and braking inertia. At the limit
            # of the inertia without losses it stays within the width over which the drag changes its sign (tests).
            inertia = motor.J_m + motor.J_w * motor.tau**2
            yield _RK4_REAL * inertia / motor.damping, "effects.motor_drag or gear_no_load, a motor that drag stops"
    yield from ((_RK4_REAL / rate, LINE) for rate in _line_rates(chain, free))
    for damping, stiffness in _loops(chain):
        yield min(_rk4_limit(root) for root in _roots(damping, stiffness)), LOOP
    for damping, stiffness, what in _springs(chain):
        yield from ((_rk4_limit(root), what) for root in _roots(damping, stiffness))


def _roots(damping: float, stiffness: float) -> tuple[complex, complex]:
    """Rates (1/s) of what is damped (1/s) and sprung (1/s²) so."""
    swing = cmath.sqrt(damping * damping / 4 - stiffness)
    return swing - damping / 2, -swing - damping / 2


LINE = "effects.battery_sag or motor, a motor on its torque-speed line"


LOOP = "effects.velocity_loop or motor, the velocity loop of a motor"


def _loops(chain: _Chain) -> Iterator[tuple[float, float]]:
    """Damping (1/s) and stiffness (1/s²) that velocity loops give motors whose wheels slide."""
    for motor in chain.motors:
        if motor.loop > 0.0:
            damping = motor.loop / (motor.J_m + motor.J_w * motor.tau**2)
            yield damping, damping * motor.winding


def _line_rates(chain: _Chain, free: tuple[bool, ...]) -> Iterator[float]:
    """Rates (1/s) at which motors that are not prescribed go to their speed without a load."""
    for motor, spins in zip(chain.motors, free, strict=False):
        if spins and motor.line > 0.0:
            yield motor.line / (motor.J_m + motor.J_w * motor.tau**2)


def _semi_implicit_limits(chain: _Chain, modes: tuple[int, ...]) -> Iterator[tuple[float, str]]:
    """Of v += -h (stiffness x + damping v), x += h v, which is stable while stiffness h² + 2 damping h < 4.

    Of motors on their lines, too, whose torque is that at a step's start.
    """
    free = tuple(mode != PRESCRIBED for mode in modes)
    yield from ((2.0 * MARGIN / rate, LINE) for rate in _line_rates(chain, free))
    loops = ((*loop, LOOP) for loop in _loops(chain))
    for damping, stiffness, what in (*_springs(chain, implicit=True), *loops):
        if damping + stiffness > 0.0:
            yield MARGIN * 4 / (damping + math.sqrt(damping * damping + 4 * stiffness)), what


def _springs(chain: _Chain, implicit: bool = False) -> Iterator[tuple[float, float, str]]:
    """Damping (1/s) and stiffness (1/s²) of each module's heave, roll and pitch, of the joint's gap, and of its yaw.

    Damping in the joint's yaw counts only where it is not taken implicitly.
    """
    p = chain.p
    stiffer = max(1.0, p.steepness)  # along the normal of a slope; see `equations.uneven`
    for own, body in zip(chain.own, chain.bodies, strict=True):
        modes = [4.0 / body.m, 4.0 * body.half_y**2 / body.J_x]
        if p.steepness > 0.0 and p.pitching > 0.0:
            modes.append(4.0 * body.half_x**2 / body.J_y)
        for inverse in modes:
            yield stiffer * own.c_n * inverse, stiffer * own.k_n * inverse, "vertical motion on the wheels"
    if chain.hinges and p.A_joint > 0.0:
        yield 2 * p.A_joint, p.A_joint**2, "control.A_joint"
    if chain.hinges and p.joint_damping + p.joint_stiffness > 0.0:
        inverse = _yaw_compliance(chain)
        yield (0.0 if implicit else inverse * p.joint_damping), inverse * p.joint_stiffness, "torque in the joint's yaw"


def _yaw_compliance(chain: _Chain) -> float:
    """Largest acceleration of the joints' yaws that torques in them of 1 N m in all give, 1/(kg m²)."""
    inverse = np.array([1 / body.J_z for body in chain.bodies])
    if len(inverse) == 2:
        return float(inverse.sum())
    twist = np.diff(np.eye(len(inverse)), axis=0)
    return float(np.linalg.eigvalsh(twist * inverse @ twist.T).max())


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


def _slip_modes(chain: _Chain, free: tuple[bool, ...]) -> Iterator[complex]:
    """Eigenvalues (1/s) of the planar velocities and the free motors' speeds, for wheels that hold."""
    matrices = []
    for bends in _bends(chain):
        for braking in (False, True):
            etas = [1.0 / motor.eta_r if braking else motor.eta_d for motor in chain.motors]
            matrices.append(_slip_matrix(chain, etas, free, bends))
    yield from np.linalg.eigvals(np.array(matrices)).ravel()


def _slip_matrix(chain: _Chain, etas: list[float], free: tuple[bool, ...], bends: tuple[float, ...]) -> Array:
    """d/dt of (x, y, gamma of each module, free motors) = matrix · the same, the joints' planar rows eliminated."""
    p, _, bodies, motors, hinges = chain
    yaws = [sum(bends[:b]) for b in range(len(bodies))]
    spinning = [i for i in range(len(motors)) if free[i]]
    size = 3 * len(bodies) + len(spinning)
    inverse, damping = np.zeros(size), np.zeros((size, size))
    for b, body in enumerate(bodies):
        inverse[3 * b : 3 * b + 3] = 1 / body.m, 1 / body.m, 1 / body.J_z
    for i, motor in enumerate(motors):
        body, yaw = bodies[i // 2], yaws[i // 2]
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
                damping[k, k] += 0.5 * motor.loop  # once for each of its two wheels
            k_l, k_t = p.stiffening * body.k_l, p.stiffening * body.k_t
            damping += k_l * np.outer(force, along) + (k_t + p.lateral_damping) * np.outer(across, across)
    if not hinges:
        return -inverse[:, None] * damping
    joint = np.zeros((2 * len(hinges), size))
    for j, hinge in enumerate(hinges):
        twist = np.zeros(size)
        twist[[3 * j + 2, 3 * j + 5]] = -1.0, 1.0
        damping += p.joint_damping * np.outer(twist, twist)
        for sign, place, end in ((1.0, j, 0), (-1.0, j + 1, 1)):
            s, c = math.sin(yaws[place]), math.cos(yaws[place])
            columns = slice(3 * place, 3 * place + 3)
            joint[2 * j, columns] = sign, 0.0, -sign * hinge[end] * s
            joint[2 * j + 1, columns] = 0.0, sign, sign * hinge[end] * c
    weighted = joint * inverse
    project = np.eye(size) - weighted.T @ np.linalg.solve(weighted @ joint.T, joint)
    return -project @ (inverse[:, None] * damping)


# ----------------------------------------------------------------------
# Which part of a robot keeps its steps short: asked once a step is refused.
# ----------------------------------------------------------------------


_PARTS = {
    "k_n": 0.5, "k_l": 0.5, "k_t": 0.5, "m": 2.0, "J_x": 2.0, "J_z": 2.0, "J_m": 2.0, "A_joint": 0.5, "A_motor": 0.5,
    "velocity_gain": 0.5, "loop_gain": 0.5, "loop_integral": 0.5, "stall_torque": 0.5, "no_load_speed": 2.0,
}  # fmt: skip
"""Last part of a parameter's key → by which factor it would allow a longer step: softer, heavier, slower."""
_LONGER = 1.1
"""By which factor a step has to become longer for its part to be one that limits it."""
_NAMED = 2
"""Parts at most that are named."""


def limited_by(robot: Robot, motion: str, longest: Callable[[Robot], float]) -> str:
    """The motion that limits a step, and which effects and parameters of the robot do: what it could be otherwise.

    Parameters
    ----------
    robot : Robot
    motion : str
        As `largest_step` has it.
    longest : callable
        The longest step (s) of a robot, as `largest_step` gives it for what is to be run.
    """
    without = {
        f"without effects.{name}": replace(robot, effects={k: v for k, v in robot.effects.items() if k != name})
        for name in robot.effects
    }
    for key, _, value in robot.quantities():
        factor = _PARTS.get(key.rpartition(".")[2])
        if factor is not None and value > 0.0:
            words = f"with {'half of' if factor < 1.0 else 'twice'} {key}"
            try:
                without[words] = robot.replace({key: factor * value})
            except ArtibotError:  # beyond its bounds: nothing that a user could choose
                continue
    least = _LONGER * longest(robot)
    steps = sorted(((longest(other), words) for words, other in without.items()), reverse=True)
    return "; ".join([motion, *(f"{step:.3g} s {words}" for step, words in steps[:_NAMED] if step > least)])
