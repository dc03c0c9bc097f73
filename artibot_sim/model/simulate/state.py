"""The state of a rover, and where it starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import record
from artibot_sim.model.equations.kinematics import constraint_rows
from artibot_sim.model.equations.transmission import back_torque_factor, torque_factors
from artibot_sim.model.ground.raster import Ground, Surface, beyond, sample
from artibot_sim.model.kernels.layout import ALPHA, BACK, BETA, GAMMA, Q_C, ROW, X, Y, Z
from artibot_sim.model.kernels.rest import spring_forces
from artibot_sim.model.reference.contact import contact, motors_of
from artibot_sim.model.reference.dynamics import constraint_terms, load_torque
from artibot_sim.model.reference.effects import PlainEffects
from artibot_sim.model.reference.train import train_constraint
from artibot_sim.model.robot.derived import packed, params, train
from artibot_sim.model.robot.parameters import ModuleParams, MotorParams, Params, Train
from artibot_sim.model.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """Everything a rollout needs to go on.

    Attributes
    ----------
    t : float
        Time, s.
    q, v : array, shape (16,)
        Generalised coordinates (eqs 10, 11) and their rates: x y z alpha beta gamma theta_r theta_l of the front
        module, then of the back one; m, rad, motor-side rad. A robot of n > 2 modules has 8 n of each, and n/2 times
        as many of all that follows; where a module has no motors, the wheels of a side stand in the motor's place.
    eta : array, shape (4,)
        Efficiencies for the next step (eq. 23).
    torque : array, shape (4,)
        Motor torques of the last step (N m), which eq. 30 feeds back.
    lateral : array, shape (8,)
        Lateral forces (N) of tyres that need some way to build them up, in the order of WHEELS; only the effect
        `tyre_relaxation` knows them. None are built up by default.
    bristles : array, shape (16,)
        How far bristles between wheels and ground are bent along the wheels and then across them (m), both in the
        order of WHEELS; only the effect `stiction` knows them. None are by default.
    windup : array, shape (8,)
        How far wheels are wound up, from −1 to 1 (forwards), in the order of WHEELS; only the effect `wheel_windup`
        knows it. By default they are not.
    behind : array, shape (4,)
        What the velocity loops of the motors have of the integral of their speed's error, rad; only the effect
        `velocity_loop` knows it. Nothing by default.
    """

    t: float
    q: Array
    v: Array
    eta: Array
    torque: Array
    lateral: Array = None  # type: ignore[assignment]  # filled in by __post_init__
    bristles: Array = None  # type: ignore[assignment]
    windup: Array = None  # type: ignore[assignment]
    behind: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        modules = max(2, round(np.size(self.q) / 8))
        given = []
        for name, share in _SHARES.items():
            values = getattr(self, name)
            if values is None and name in _REMEMBERED:
                array = np.zeros(share * modules)
            else:
                array = np.array(values, dtype=float)
                given.append(array)
                if array.shape != (share * modules,):
                    raise _unfit(name, array, share * modules)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if not np.isfinite(np.concatenate(given)).all():  # all at once: a rover that is stepped has a state a step
            name = next(name for name in _SHARES if not np.isfinite(getattr(self, name)).all())
            raise _unfit(name, getattr(self, name), _SHARES[name] * modules)

    @property
    def memory(self) -> Array:
        """A copy of what the wheels remember as the kernels take it (`layout.MEMORY`), of any number of modules."""
        return np.concatenate((self.lateral, self.windup, self.bristles))


_SHARES = {"q": 8, "v": 8, "eta": 2, "torque": 2, "lateral": 4, "bristles": 8, "windup": 4, "behind": 2}
"""How many numbers a state has of each for a module."""

_REMEMBERED = {"lateral", "bristles", "windup", "behind"}
"""What may be left out."""


def _unfit(name: str, array: Array, size: int) -> ArtibotError:
    return ArtibotError(f"state.{name}: found {array!r}, expected {size} finite numbers")


def from_memory(memory: Array) -> tuple[Array, Array, Array]:
    """`State.lateral`, `State.bristles` and `State.windup` of a `State.memory`."""
    wheels = len(memory) // 4
    return memory[:wheels], memory[2 * wheels :], memory[wheels : 2 * wheels]


def initial_state(
    robot: Robot,
    x: float = 0.0,
    y: float = 0.0,
    yaw: float = 0.0,
    articulation_yaw: float | Sequence[float] = 0.0,
    t: float = 0.0,
    ground: Ground | None = None,
) -> State:
    """A rover at rest on its wheels; on a slope, bristles between these and the ground hold it (effect `stiction`).

    Vertical motion is an undamped spring (section 4.3), so each module starts where its wheels carry it, and
    pitched, if need be, so that the joint's two ends meet.

    Parameters
    ----------
    x, y, yaw : float
        Pose of the front module in `map`, m and rad.
    articulation_yaw : float or sequence of float
        gamma_b − gamma_f, rad; of a robot of more modules one each joint, or that of the first, the others straight.
    t : float
        Time, s.
    ground : Ground, optional
        Uneven ground, over which each module rolls and pitches until its wheels carry it. There bristles are not bent.

    Raises
    ------
    ArtibotError
        When a number is not finite, the joint cannot be closed at this articulation, or there is no ground there.
    """
    bends = np.atleast_1d(np.asarray(articulation_yaw, dtype=float))
    for name, value in (("x", x), ("y", y), ("yaw", yaw), *(("articulation_yaw", bend) for bend in bends)):
        if not math.isfinite(value):
            raise ArtibotError(f"initial_state: {name} is {value}; expected a finite number")
    if robot.trailing and ground is not None:
        raise ArtibotError(
            f"ground: robot '{robot.name}' has {len(robot.modules)} modules; uneven ground is for robots of one or two"
        )
    if robot.trailing:
        return _train_at_rest(robot, (x, y, yaw), bends, t)
    if len(bends) != 1:
        raise ArtibotError(f"initial_state: {len(bends)} articulation yaws; robot '{robot.name}' has one joint at most")
    p = params(robot)
    if ground is None:
        return at_rest_on_a_plane(robot, p, (x, y, yaw), float(bends[0]), t)
    level, surface = posture_at_rest(p, (0.0, 0.0, 0.0), float(bends[0])), ground.under_wheels(robot.wheel.r_w)
    q = _settled(robot, p, _moved(level, (x, y, yaw)), t, surface)
    return State(t, q, np.zeros(16), _efficiencies(robot), np.zeros(4))


def at_rest_on_a_plane(robot: Robot, p: Params, pose: tuple[float, float, float], bend: float, t: float) -> State:
    """`initial_state` of a robot of one or two modules whose numbers are at hand; `bend` is its articulation yaw."""
    q = posture_at_rest(p, pose, bend)
    if p.bristle <= 0.0:
        return State(t, q, np.zeros(16), _efficiencies(robot), np.zeros(4))
    bristles, bent = np.zeros((2, 8)), _bent_at_rest(p, q, PlainEffects(robot.effects, t))
    bristles[:, : bent.shape[1]] = bent
    loads = _loads_at_rest(p, q, PlainEffects(robot.effects, t), bristles)
    motors = (p.right_front, p.left_front, p.right_back, p.left_back)
    eta, torque = _holding(loads, motors, np.repeat([0.0, back_torque_factor(robot)], 2))
    return State(t, q, np.zeros(16), eta, torque, bristles=bristles.ravel(), windup=np.sign(bristles[0]))


def _efficiencies(robot: Robot) -> Array:
    """Those of a rover at rest: of motors that drive."""
    return np.array([robot.drive.front.eta_d] * 2 + [(robot.drive.back or robot.drive.front).eta_d] * 2)


def posture_at_rest(
    p: Params, pose: tuple[float, float, float] = (0.0, 0.0, 0.0), articulation_yaw: float = 0.0
) -> Array:
    """Coordinates (16,) of a rover of one or two modules at rest on its wheels, see `initial_state`.

    Parameters
    ----------
    p : Params
    pose : (float, float, float)
        Of the front module in `map`: x and y in m, yaw in rad.
    articulation_yaw : float
        gamma_b − gamma_f, rad.
    """
    q = np.zeros(16)
    q[[X, Y, GAMMA]] = pose
    q[Z] = p.front.r_0 + p.front.m * p.g_z / (4 * p.k_n)
    if p.two:
        q[BACK + Z] = p.back.r_0 + p.back.m * p.g_z / (4 * p.k_n)
        q[BACK + GAMMA] = pose[2] + articulation_yaw
        _close_joint(p, q)
    return q


def _moved(q: Array, pose: tuple[float, float, float]) -> Array:
    """Coordinates (16,) of a rover whose front module is at the origin, moved to a pose (m, m, rad)."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    moved = q.copy()
    for b in (0, BACK):
        moved[b + X], moved[b + Y] = x + c * q[b + X] - s * q[b + Y], y + s * q[b + X] + c * q[b + Y]
        moved[b + GAMMA] += yaw
    return moved


STILL = 1e-12
"""Change of a coordinate (m, rad) below which a rover has come to rest."""


def _settled(robot: Robot, p: Params, q: Array, t: float, ground: Surface) -> Array:
    """Coordinates (16,) of a rover at rest on uneven ground, from `q` on, whose front module keeps x, y and yaws stay.

    By Newton's method for the balance of forces and for eq. 13, with the stiffness of the wheels' springs. Friction
    holds what pulls along the ground.
    """
    numbers, fx, plain = packed(p), record(robot.effects, t), PlainEffects(robot.effects, t)
    q, row, force, springs = q.copy(), np.zeros(ROW), np.zeros(16), np.zeros(16)
    bodies = [(p.front, 0), (p.back, BACK)][: 2 if p.two else 1]
    free = [b + c for _, b in bodies for c in ((X, Y) if b else ()) + (Z, ALPHA, BETA)]
    q[[b + Z for _, b in bodies]] += [float(sample(ground, q[b + X], q[b + Y])[0]) for _, b in bodies]
    weight = np.zeros(16)
    for body, b in bodies:
        springs[b + Z], springs[b + ALPHA] = 4 * p.k_n, 4 * p.k_n * body.half_y**2
        springs[b + BETA] = p.pitching * 4 * p.k_n * body.half_x**2
        ahead, left = plain.ask("centre", b // BACK)
        weight[[b + Z, b + ALPHA, b + BETA]] = body.m * p.g_z * np.array([1.0, left, -p.pitching * ahead])
    for _ in range(500):
        spring_forces(q, numbers, fx, ground, row)
        for _, b in bodies:
            wheels = Q_C + 6 * (b // BACK)
            force[b + Z : b + GAMMA] = weight[b + Z : b + GAMMA] + row[wheels + Z : wheels + GAMMA]
        gap, jacobian = constraint_rows(numbers, q) if p.two else (np.zeros(0), np.zeros((0, 16)))
        columns = jacobian[:, free]
        matrix = np.block([[np.diag(springs[free]), columns.T], [columns, np.zeros((len(gap), len(gap)))]])
        step = np.linalg.lstsq(matrix, np.append(force[free], -gap), rcond=None)[0][: len(free)]
        q[free] += step
        if np.abs(step).max() < STILL:
            break
    else:
        raise ArtibotError(
            f"initial_state: the rover does not come to rest on the ground at x {q[X]:g} m, y {q[Y]:g} m; start where "
            "it is smoother"
        )
    for body, b in bodies:
        c, s = math.cos(q[b + GAMMA]), math.sin(q[b + GAMMA])
        for ahead, left in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            out_x, out_y = ahead * body.half_x, left * body.half_y
            x, y = q[b + X] + c * out_x - s * out_y, q[b + Y] + s * out_x + c * out_y
            if beyond(ground, np.array(x), np.array(y)):
                raise ArtibotError(f"initial_state: no ground at x {x:.3g} m, y {y:.3g} m, where a wheel would stand")
    return q


def _bent_at_rest(p: Params, q: Array, fx: PlainEffects) -> Array:
    """How far bristles are bent along and across each wheel (2, n), m, by its share of what pulls the rover downhill.

    Each wheel takes as much as its load, and what eq. 16 holds at most: below its friction angle a rover stands.
    """
    wheels = contact(p, q, np.zeros(16), fx)
    bent = [
        _held_downhill(p, body, q[b + GAMMA], wheels.F_n[i : i + 4]) / (p.bristle * wheels.k_l[i : i + 4])
        for i, (body, b) in zip(range(0, len(wheels.F_n), 4), ((p.front, 0), (p.back, BACK)), strict=False)
    ]
    for body, along_and_across in zip((p.front, p.back), bent, strict=False):
        along_and_across[1] *= body.k_l / body.k_t
    return np.hstack(bent)


def _loads_at_rest(p: Params, q: Array, fx: PlainEffects, bristles: Array) -> Array:
    """tau M_r of motors whose wheels bent bristles (2, 8) pull at, (4,), N m."""
    wheels = contact(p, q, np.zeros(16), fx, np.concatenate((np.zeros(8), np.sign(bristles[0]), bristles.ravel())))
    loads = np.zeros(4)
    for i, motor in enumerate(motors_of(p)):
        loads[i] = motor.geared * motor.tau * load_torque(p, wheels, i, 0.0)
    return loads


def _holding(loads: Array, motors: Sequence[MotorParams], factors: Array) -> tuple[Array, Array]:
    """Efficiencies and torques (N m) of motors at rest under `loads` (N m).

    Those in front, the first two, hold as motors that drive do. Of the others each has eq. 30's share of these by its
    factor, as far as its gear's own loss holds the rest: a gear stands between both efficiencies.
    """
    eta_d, eta_r = np.array([motor.eta_d for motor in motors]), np.array([motor.eta_r for motor in motors])
    shared = factors * (loads[:2] / eta_d[:2]).sum()
    needed = np.divide(shared, loads, out=np.full(len(motors), np.inf), where=loads != 0.0)
    between = np.clip(needed, eta_r, 1.0 / eta_d)
    between[:2] = 1.0 / eta_d[:2]
    return np.where(between < 1.0 / eta_d, 1.0 / between, eta_d), between * loads


def _held_downhill(p: Params, body: ModuleParams, yaw: float, F_n: Array) -> Array:
    """Forces along and across a module's wheels (2, 4), N, that hold it on its slope without turning it.

    They act u_w ahead of the wheels (eq. 20), which alone would turn the module. So each is turned a little, by more
    the further downhill or uphill its wheel is: that hardly adds to any, and leaves their sum as it is.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    downhill = np.array([p.g_x * c + p.g_y * s, p.g_y * c - p.g_x * s])
    pull = min(1.0, body.mu_s * abs(p.g_z) / max(math.hypot(p.g_x, p.g_y), 1e-9)) * F_n / abs(p.g_z)
    forces: Array = -downhill[:, None] * pull
    x, y = body.half_x * np.array([1.0, -1.0, 1.0, -1.0]), body.half_y * np.array([-1.0, -1.0, 1.0, 1.0])
    below = downhill[0] * x + downhill[1] * y
    if (pull > 0.0).any():
        below -= np.average(below, weights=pull)  # a centre of mass that is off the middle lies where loads have theirs
    spread = float(np.sum(pull * below**2))
    if spread > 0.0:
        turn = p.u_w * forces[1].sum() / spread * below
        forces += turn * np.array([-forces[1], forces[0]])
    return forces


def _train_at_rest(robot: Robot, pose: tuple[float, float, float], bends: Array, t: float) -> State:
    """A robot of any number of modules at rest at `pose`, its joints bent by `bends` (rad), at the time `t` (s)."""
    p = train(robot)
    modules = len(p.modules)
    if len(bends) not in (1, modules - 1):
        raise ArtibotError(
            f"initial_state: {len(bends)} articulation yaws; robot '{robot.name}' has {modules - 1} joints; give one "
            "each, or the first alone"
        )
    q = np.zeros((modules, 8))
    q[:, GAMMA] = pose[2]
    q[1:, GAMMA] += np.cumsum(np.resize(np.append(bends, np.zeros(modules)), modules - 1))
    q[0, :2] = pose[:2]
    level = True
    for i, module in enumerate(p.modules):
        q[i, Z] = module.front.r_0 + module.front.m * module.g_z / (4 * module.k_n)
    for j, joint in enumerate(p.joints):
        ahead, behind = joint.front.O_x, joint.back.O_x
        for c, turn in ((X, math.cos), (Y, math.sin)):
            q[j + 1, c] = q[j, c] + ahead * turn(q[j, GAMMA]) - behind * turn(q[j + 1, GAMMA])
        level = level and q[j, Z] + joint.front.O_z == q[j + 1, Z] + joint.back.O_z
    if not level:
        _close_joints(p, q.reshape(-1))
    bristles, loads = np.zeros((2, 4 * modules)), np.zeros(2 * modules)
    for i, module in enumerate(p.modules if p.modules[0].bristle > 0.0 else ()):
        at, fx = np.append(q[i], np.zeros(8)), PlainEffects(robot.effects, t).in_pair(max(i, 1)).of_module(i)
        bent = _bent_at_rest(module, at, fx)
        bristles[:, 4 * i : 4 * i + 4] = bent
        loads[2 * i : 2 * i + 2] = _loads_at_rest(module, at, fx, np.pad(bent, ((0, 0), (0, 4))))[:2]
    motors = [motor for module in p.modules for motor in (module.right_front, module.left_front)]
    eta, torque = _holding(loads, motors, np.repeat(torque_factors(robot), 2))
    return State(
        t, q.reshape(-1), np.zeros(8 * modules), eta, torque, bristles=bristles.ravel(),
        windup=np.sign(bristles[0]),
    )  # fmt: skip


def _close_joints(p: Train, q: Array) -> None:
    """Close every joint (eq. 13), in place, with the wheels' springs (eq. 15) deflected as little as that takes.

    By Newton's method with the springs' stiffness as the measure. The front module stays where it is, and yaws stay.
    """
    modules = len(p.modules)
    free = [8 * i + c for i in range(modules) for c in ((X, Y) if i else ()) + (Z, ALPHA, BETA)]
    for _ in range(50):
        stiffness, force = np.zeros(len(q)), np.zeros(len(q))
        for i, module in enumerate(p.modules):
            k, body, z, alpha = 4 * module.k_n, module.front, 8 * i + Z, 8 * i + ALPHA
            stiffness[[z, alpha]] = k, k * body.half_y**2
            force[z] = body.m * module.g_z + k * (body.r_0 - q[z])
            force[alpha] = -k * body.half_y**2 * math.sin(q[alpha]) * math.cos(q[alpha])
        gap, jacobian, _ = train_constraint(p, q, np.zeros_like(q))
        columns = jacobian[:, free]
        matrix = np.block([[np.diag(stiffness[free]), columns.T], [columns, np.zeros((len(gap), len(gap)))]])
        step = np.linalg.lstsq(matrix, np.append(force[free], -gap), rcond=None)[0][: len(free)]
        q[free] += step
        if np.abs(gap).max() < 1e-13:
            return
    if np.abs(train_constraint(p, q, np.zeros_like(q))[0]).max() > 1e-9:
        raise ArtibotError(
            "initial_state: the joints do not close at these articulations; check O_z, l and the hitches, or start "
            "straighter"
        )


def _close_joint(p: Params, q: Array) -> None:
    """Solve eq. 13 for the back module's x and y and both pitches, in place, by Newton's method."""
    x_f, x_b = p.front.O_x, p.back.O_x
    q[BACK + X] = q[X] + x_f * math.cos(q[GAMMA]) - x_b * math.cos(q[BACK + GAMMA])
    q[BACK + Y] = q[Y] + x_f * math.sin(q[GAMMA]) - x_b * math.sin(q[BACK + GAMMA])
    if q[Z] + p.front.O_z == q[BACK + Z] + p.back.O_z:
        return  # level, as on flat ground: this closes it
    free = [BACK + X, BACK + Y, BETA, BACK + BETA]
    for _ in range(20):
        gap, jacobian, _ = constraint_terms(p, q, np.zeros(16))
        if np.abs(gap).max() < 1e-15:
            return
        q[free] -= np.linalg.lstsq(jacobian[:, free], gap, rcond=None)[0]
    if np.abs(gap).max() > 1e-9:
        raise ArtibotError(
            f"initial_state: the joint does not close at an articulation of {q[BACK + GAMMA] - q[GAMMA]:g} rad; "
            "check front.O_z, back.O_z and l, or start straighter"
        )
