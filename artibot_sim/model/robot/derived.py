"""A robot's numbers as the kernel takes them, derived quantities included.

:class:`Params` is what Python reads; :func:`packed` lays it out as one NumPy record, which compiled code takes by
reference and reads by the same names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import at_work, in_pair
from artibot_sim.model.effects.base import Effect, Values
from artibot_sim.model.ground.raster import STEEPEST, Ground
from artibot_sim.model.robot.environment import STANDARD_GRAVITY, gravity
from artibot_sim.model.robot.parameters import ModuleParams, MotorParams, Params, Train
from artibot_sim.model.robot.robot import Drive, Module, Robot


def starred(robot: Robot, module: Module) -> tuple[float, float, float, float]:
    """Mass and inertias with the wheels: m*, J_x*, J_y*, J_z* of eq. 9.

    Four wheels at (±i_x/2, ±i_y/2) add m_w i_y², m_w i_x² and m_w (i_x² + i_y²); the printed factor is twice that
    (`readings.literal_eq9`). J_y* is not printed; it follows by the same rule.
    """
    wheel, factor = robot.wheel, 2.0 if robot.readings.literal_eq9 else 1.0
    m_w = factor * wheel.m_w
    return (
        module.m + 4 * wheel.m_w,
        module.J_x + 4 * wheel.J_wx + m_w * module.i_y**2,
        module.J_y + 4 * wheel.J_wy + m_w * module.i_x**2,
        module.J_z + 4 * wheel.J_wx + m_w * (module.i_x**2 + module.i_y**2),
    )


def _module(robot: Robot, module: Module, sign: float) -> ModuleParams:
    m, J_x, J_y, J_z = starred(robot, module)
    inverse = (1 / m, 1 / m, 1 / m, 1 / J_x, 1 / J_y, 1 / J_z)
    # Under its weight every wheel has the rolling radius r_w, so that wheels, origins and joint are coplanar and the
    # rover stands level, as section 4.3 assumes; with one unloaded radius for both modules it would pitch.
    r_0 = robot.wheel.r_w + m * STANDARD_GRAVITY / (4 * robot.contact.k_n)
    soil = robot.contact
    return ModuleParams(
        m, J_x, J_y, J_z, module.i_x / 2, module.i_y / 2, sign * module.l, module.O_z, r_0,
        soil.k_l, soil.k_t, soil.mu_s, soil.mu_d, inverse,
    )  # fmt: skip


def _motor(robot: Robot, drive: Drive | None) -> MotorParams:
    """A motor with its wheels; without a drive (a passive module's) they are alone, and turn freely."""
    J_w = robot.wheel.wheels_per_motor * robot.wheel.J_wy
    if drive is None:
        return MotorParams(1.0, robot.wheel.r_w, 1.0, 1.0, 0.0, J_w, math.inf, geared=0.0)
    return MotorParams(drive.tau, robot.wheel.r_w, drive.eta_d, drive.eta_r, drive.J_m, J_w, drive.torque_max)


def mean_load(robot: Robot) -> float:
    """Mean load of the wheels at rest on level ground, N."""
    masses = [starred(robot, module)[0] for module in robot.modules]
    return STANDARD_GRAVITY * sum(masses) / (4 * len(masses))


def params(robot: Robot) -> Params:
    """The kernel's view of `robot`, with what its effects change in these numbers.

    A rigid robot's missing module is filled with the front's numbers, unused.

    Raises
    ------
    ArtibotError
        For a robot of more modules, which `train` describes.
    """
    known = _KEPT.get(id(robot))
    if known is not None and known[0] is robot:
        return known[1]
    if robot.trailing:
        raise ArtibotError(
            f"robot '{robot.name}': it has {len(robot.modules)} modules; what was asked for is computed for robots of "
            "one or two so far"
        )
    found = _pair(robot, 1, at_work(robot.effects))
    if len(_KEPT) >= _MOST_KEPT:
        _KEPT.clear()
    _KEPT[id(robot)] = robot, found
    return found


_KEPT: dict[int, tuple[Robot, Params]] = {}
"""Robots and their numbers by the robot's identity: a robot never changes, and one is asked for several times a run."""
_MOST_KEPT = 256


def _pair(robot: Robot, behind: int, working: Mapping[str, tuple[Effect, Values]]) -> Params:
    """The front module and the one `behind` as an articulated rover, with what effects at work change in it."""
    modules, drives = robot.modules, robot.drives
    back = behind if len(modules) > 1 else 0
    first, second = _motor(robot, drives[0]), _motor(robot, drives[back])
    contact, control = robot.contact, robot.control
    g = gravity(0.0, 0.0)
    p = Params(
        two=robot.articulated,
        front=_module(robot, modules[0], -1.0),
        back=_module(robot, modules[back], 1.0),
        right_front=first,
        left_front=first,
        right_back=second,
        left_back=second,
        k_n=contact.k_n,
        c_n=contact.c_n,
        u_w=contact.u_w,
        literal_eq22=robot.readings.literal_eq22,
        A_motor=control.A_motor,
        A_joint=control.A_joint,
        velocity_gain=control.velocity_gain,
        g_x=g[0],
        g_y=g[1],
        g_z=g[2],
        load=mean_load(robot),
        pitching=1.0 if robot.suspended == "rigid" else 0.0,
    )
    for effect, values in working.values():
        if effect.adapt is not None:
            p = effect.adapt(p, values)
    return p


def on_ground(p: Params, ground: Ground | None, radius: float) -> Params:
    """Numbers of a robot on `ground`, under wheels of a rolling `radius` (m); unchanged for None, which is flat.

    The ground's damping adds to the wheels' own `c_n`. Its stiffest place and its steepest slope limit the step.
    """
    if ground is None:
        return p
    critical = 2.0 * math.sqrt(p.k_n * p.load / STANDARD_GRAVITY)
    return p._replace(
        c_n=p.c_n + ground.damping * critical,
        stiffening=p.stiffening * max(1.0, ground.stiffest),
        steepness=1.0 + min(ground.steepest(radius), STEEPEST) ** 2,
    )


def train(robot: Robot) -> Train:
    """The numbers of an articulated robot, module by module and joint by joint.

    What an effect changes in the back module, it changes in every module behind the front one, unless it names the
    part: see `effects.parts`.
    """
    pairs = [_pair(robot, i, in_pair(robot.effects, i)) for i in range(1, len(robot.modules))]
    first, pairs = pairs[0], pairs[:1] + pairs
    modules = [first._replace(two=False)]
    for i, pair in enumerate(pairs[1:], 1):
        right, left = pair.right_back, pair.left_back
        if robot.drives[i] is None:
            right, left = (motor._replace(eta_d=1.0, eta_r=1.0) for motor in (right, left))
        modules.append(pair._replace(two=False, front=pair.back, right_front=right, left_front=left))
    joints = [first]
    for i, module in enumerate(robot.trailing, 1):
        ahead = modules[i].front._replace(O_x=-module.hitch.l, O_z=module.hitch.O_z)
        joints.append(modules[i]._replace(two=True, front=ahead, back=modules[i + 1].front))
    return Train(tuple(modules), tuple(joints))


def front_params(robot: Robot) -> Params:
    """The front module's numbers, and those common to all modules, of a robot of any number of them."""
    return train(robot).modules[0] if robot.trailing else params(robot)


def _dtype(cls: type) -> np.dtype:
    """The record type of a (nested) named tuple of floats, bools and tuples of floats."""
    fields: list[tuple[Any, ...]] = []
    for name, kind in get_type_hints(cls).items():
        if kind in (float, bool):
            fields.append((name, np.dtype(kind)))
        elif hasattr(kind, "_fields"):
            fields.append((name, _dtype(kind)))
        else:
            fields.append((name, np.float64, (len(kind.__args__),)))
    return np.dtype(fields, align=True)


PARAMS_DTYPE = _dtype(Params)


def packed(p: Params) -> np.void:
    """`p` as one record."""
    record: np.void = np.array([p], dtype=PARAMS_DTYPE)[0]
    return record


def packed_all(records: tuple[Params, ...]) -> NDArray[Any]:
    """Several of them as an array of records."""
    return np.array(list(records), dtype=PARAMS_DTYPE)
