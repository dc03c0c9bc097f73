"""A robot as one frozen tree of physical parameters, under the paper's symbols.

Every number a simulation uses is a field here, declared once with its unit, bounds and meaning. Files are read
and written by :mod:`artibot_sim.model.robot.file`.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import EFFECTS, effects_from_dict
from artibot_sim.model.effects.base import Values
from artibot_sim.model.effects.parts import of_pair
from artibot_sim.model.robot.quantity import Quantity, not_negative, positive, quantity

MOTORS = ("front_right", "front_left", "back_right", "back_left")
"""Motor names in the order of every (…, 4) array (the paper's fr, fl, br, bl)."""

WHEELS = tuple(f"{motor}_{end}" for motor in MOTORS for end in ("front", "back"))
"""Wheel names in the order of every (…, 8) array (the paper's frf, frb, flf, …)."""

WHEEL_JOINTS = tuple(f"{wheel}_wheel" for wheel in WHEELS)
"""Wheel joints as published in ``/joint_states``."""

FIRST_TRAILING = 3
"""Number of the first module behind `front` and `back`; it is called ``module_3``."""


def module_name(module: int) -> str:
    """Name of a module by its place, counted from 0: `front`, `back`, ``module_3``, ``module_4``, …"""
    return ("front", "back")[module] if module < 2 else f"module_{module + 1}"


def sides_of(modules: int) -> tuple[str, ...]:
    """The two sides of each of so many modules, named as a motor there is: `front_right`, …, ``module_3_left``, …"""
    return tuple(f"{module_name(i)}_{side}" for i in range(modules) for side in ("right", "left"))


def wheels_of(modules: int) -> tuple[str, ...]:
    """Wheels of so many modules, in the order of every (…, 4 · modules) array."""
    return tuple(f"{side}_{end}" for side in sides_of(modules) for end in ("front", "back"))


@dataclass(frozen=True)
class Module:
    """One module, without its wheels (Table 2 and Fig. 3)."""

    m: float = positive("kg", "mass of the module without its four wheels")
    J_x: float = positive("kg m^2", "roll inertia without wheels, about the module's origin")
    J_y: float = positive("kg m^2", "pitch inertia without wheels")
    J_z: float = positive("kg m^2", "yaw inertia without wheels")
    i_x: float = positive("m", "longitudinal spacing of the wheels (along x, as eq. 20 uses it)")
    i_y: float = positive("m", "track: lateral spacing of the wheels (along y, as eq. 20 uses it)")
    l: float = not_negative("m", "distance from the module's origin to the joint")  # noqa: E741 - the paper's symbol
    O_z: float = quantity("m", -10.0, 10.0, "height of the joint above the module's origin", 0.0)


@dataclass(frozen=True)
class Hitch:
    """Where a joint sits on the module ahead of it."""

    l: float = not_negative("m", "distance from the origin of the module ahead to the joint behind it")  # noqa: E741
    O_z: float = quantity("m", -10.0, 10.0, "height of the joint above that module's origin", 0.0)


@dataclass(frozen=True)
class Trailing(Module):
    """A module behind `front` and `back`: its `l` and `O_z` are those of the joint ahead of it, as for `back`.

    Attributes
    ----------
    hitch : Hitch
        The same joint as seen from the module ahead.
    """

    hitch: Hitch = field(kw_only=True)


@dataclass(frozen=True)
class Wheel:
    """The wheels, all alike (eq. 9 and Table 2)."""

    r_w: float = positive("m", "nominal wheel radius")
    m_w: float = not_negative("kg", "mass of one wheel with its share of the carrier")
    J_wx: float = not_negative("kg m^2", "inertia of one wheel unit about its diameter (J_w,x = J_w,z)")
    J_wy: float = positive("kg m^2", "inertia of one wheel about its axle")
    wheels_per_motor: float = quantity("-", 2, 2, "wheels that one motor turns", 2.0)


@dataclass(frozen=True)
class Contact:
    """Soil and tyre (eqs 15, 16 and Table 4)."""

    k_n: float = positive("N/m", "normal stiffness of a wheel")
    k_l: float = positive("N s/m", "longitudinal slip coefficient")
    k_t: float = positive("N s/m", "transversal slip coefficient (k_r in Table 4)")
    mu_s: float = positive("-", "horizontal over normal force at which a wheel breaks away")
    mu_d: float = positive("-", "horizontal over normal force of a sliding wheel")
    u_w: float = not_negative("m", "offset of the normal force ahead of the wheel centre: rolling resistance")
    c_n: float = not_negative("N s/m", "normal damping of a wheel; the paper has none", 0.0)


@dataclass(frozen=True)
class Polarity:
    """Sense of each motor on the real drive: +1 if positive counts drive the rover forward."""

    right: float = quantity("-", -1, 1, "right motor", 1.0)
    left: float = quantity("-", -1, 1, "left motor", 1.0)


@dataclass(frozen=True)
class Drive:
    """Motor and gearbox of one module's two sides (eqs 21-23 and Table 3)."""

    tau: float = positive("-", "reduction ratio: wheel speed over motor speed")
    eta_d: float = quantity("-", 0.0, 1.0, "efficiency when the motor drives the wheels", low_open=True)
    eta_r: float = quantity("-", 0.0, 1.0, "efficiency when the wheels drive the motor", low_open=True)
    J_m: float = not_negative("kg m^2", "inertia of the rotor")
    torque_max: float = quantity("N m", 0.0, math.inf, "largest torque of one motor", math.inf, low_open=True)
    rated_torque: float = quantity("N m", 0.0, math.inf, "continuous torque of one motor", math.inf, low_open=True)
    torque_constant: float = quantity("N m/A", 0.0, math.inf, "torque per ampere", math.inf, low_open=True)
    polarity: Polarity = field(default_factory=Polarity)


def _of_effect(effect: str, parameter: str) -> Any:
    """A number that a robot has of itself: what it is, and where it is absent, its effect says."""
    declared = EFFECTS[effect].parameters[parameter]
    return field(default=declared.neutral, metadata={"quantity": declared.quantity, "effect": (effect, parameter)})


@dataclass(frozen=True)
class Motor:
    """What motors, their supply and their electronics are beside `Drive`; without a number they are the paper's.

    These are effects that stand: a robot that has them has the effects of the same numbers, and what its `effects` say
    of one of these goes before. So the physics is written once.
    """

    stall_torque: float = _of_effect("battery_sag", "stall")
    no_load_speed: float = _of_effect("battery_sag", "no_load_speed")
    supply: float = _of_effect("battery_sag", "supply")
    no_load_torque: float = _of_effect("gear_no_load", "torque")
    velocity_filter: float = _of_effect("velocity_filter", "time_constant")
    loop_gain: float = _of_effect("velocity_loop", "gain")
    loop_integral: float = _of_effect("velocity_loop", "integral")
    loop_windup: float = _of_effect("velocity_loop", "windup")

    @property
    def effects(self) -> dict[str, dict[str, float]]:
        """Those of its effects that are not neutral, with all numbers that stand here."""
        found: dict[str, dict[str, float]] = {}
        for key, (effect, parameter) in MOTOR_EFFECTS.items():
            found.setdefault(effect, {})[parameter] = getattr(self, key.removeprefix("motor."))
        return {name: values for name, values in found.items() if _differs(name, values)}


MOTOR_EFFECTS: dict[str, tuple[str, str]] = {
    f"motor.{entry.name}": entry.metadata["effect"] for entry in dataclasses.fields(Motor)
}
"""Of which effect's parameter each of a motor's numbers is one."""


def _differs(effect: str, values: Values) -> bool:
    """Whether a parameter of an effect is not the neutral one."""
    return any(value != EFFECTS[effect].parameters[name].neutral for name, value in values.items())


@dataclass(frozen=True)
class Drives:
    """The drives of the modules; `trailing` holds those behind `back`, None for a passive module."""

    front: Drive
    back: Drive | None = None
    trailing: tuple[Drive | None, ...] = ()


@dataclass(frozen=True)
class Control:
    """What is set, not measured: torque sharing, constraint stabilisation, velocity loop."""

    kappa: float = quantity("-", 0.0, 1.0, "share of the front module in the traction torque (eq. 29)", low_open=True)
    A_motor: float = positive("1/s", "Baumgarte rate of prescribed motors (eqs 27, 28; B = A^2)", 100.0)
    A_joint: float = not_negative("1/s", "Baumgarte rate of the joint; 0 is eq. 25 as printed", 20.0)
    velocity_gain: float = positive("1/s", "velocity loop of driven motors: acceleration per speed error", 40.0)


@dataclass(frozen=True)
class Readings:
    """Which reading of the printed equations is computed (see the list of errata in the docs)."""

    literal_eq9: bool = False
    literal_eq22: bool = False


@dataclass(frozen=True)
class Sensors:
    """What is wrong with a robot's streams, as found in recordings of it; the simulation has none of it."""

    rotation_delay: float = quantity("s", -1.0, 1.0, "by which rotations of the motors are stamped late", 0.0)
    gyro_delay: float = quantity("s", -1.0, 1.0, "by which yaw rates are stamped late", 0.0)
    pose_delay: float = quantity("s", -1.0, 1.0, "by which poses are stamped late", 0.0)
    articulation_delay: float = quantity("s", -1.0, 1.0, "by which angles of the articulation are stamped late", 0.0)
    clock_skew: float = quantity("ppm", -1e5, 1e5, "by which the clock of the poses is fast", 0.0)
    gyro_flip: float = quantity("-", 0.0, 1.0, "1 where yaw rates have the wrong sign", 0.0)
    gyro_bias: float = quantity("rad/s", -1.0, 1.0, "by which yaw rates are too large, as recorded", 0.0)


@dataclass(frozen=True)
class WheelOdometry:
    """By how much a robot slips beside what its wheels say: relative standard deviations, for `odom`'s covariances."""

    travel_slip: float = quantity("-", 0.0, 1.0, "of the travelled distance", 0.02)
    turn_slip: float = quantity("-", 0.0, 1.0, "of the turned angle", 0.2)
    side_slip: float = quantity("-", 0.0, 1.0, "of the drift to the side, over the distance", 0.06)


@dataclass(frozen=True)
class Robot:
    """A rover: everything that `rollout` needs to know about it.

    Attributes
    ----------
    front, back : Module
        `back` is None for a rigid robot.
    drive : Drives
        ``drive.front`` and ``drive.back``; also as `drive_front` and `drive_back`.
    motor : Motor
        Torque-speed line, supply and the like; the paper's motors have none of it.
    trailing : tuple of Trailing
        Modules behind `back`, from there on: ``module_3``, ``module_4``, …
    sensors : Sensors
        What is wrong with its streams.
    odometry : WheelOdometry
        How sure wheel odometry is.
    suspension : str
        ``"rocker"`` where the pitch of a module does not reach its wheels (section 4.3: both wheels of a side carry the
        same), ``"rigid"`` where it does; empty for a rocker of an articulated robot, else rigid.
    effects : mapping of str to mapping
        Model extensions by id, those of `motor` among them; absent is neutral.
    sources : mapping of str to str
        Where each number comes from, by key (``contact.k_l``).
    intervals : mapping of str to (float, float)
        95 % intervals of identified parameters, by key.

    Raises
    ------
    ArtibotError
        When a value is out of bounds or contradicts another, with its key.
    """

    name: str
    front: Module
    wheel: Wheel
    contact: Contact
    drive: Drives
    control: Control
    back: Module | None = None
    trailing: tuple[Trailing, ...] = ()
    motor: Motor = Motor()
    readings: Readings = Readings()
    sensors: Sensors = Sensors()
    odometry: WheelOdometry = WheelOdometry()
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    description: str = ""
    suspension: str = ""
    sources: Mapping[str, str] = field(default_factory=dict, compare=False)
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", MappingProxyType(effects_from_dict(self.effects, self.motor.effects)))
        for name in ("sources", "intervals"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for key, spec, value in _listed(self, ""):
            spec.check(key, value)
        _check_together(self)

    @property
    def articulated(self) -> bool:
        """Whether the robot has a back module."""
        return self.back is not None

    @property
    def suspended(self) -> str:
        """How: `suspension`, or what stands where that is empty."""
        return self.suspension or ("rocker" if self.articulated else "rigid")

    @property
    def modules(self) -> tuple[Module, ...]:
        """All modules, from the front."""
        return (self.front, *(() if self.back is None else (self.back,)), *self.trailing)

    @property
    def drives(self) -> tuple[Drive | None, ...]:
        """The modules' drives in the same order; None for a passive one, whose wheels turn freely."""
        return (self.drive.front, self.drive.back, *self.drive.trailing)[: len(self.modules)]

    @property
    def hitches(self) -> tuple[Module | Hitch, ...]:
        """Where each joint sits on the module ahead of it (`l` and `O_z`), from the front."""
        return (self.front, *(module.hitch for module in self.trailing)) if self.articulated else ()

    @property
    def motors(self) -> tuple[str, ...]:
        """Motor names in the order of every array of motors: MOTORS, and those of the driven modules behind them."""
        driven = [2 * i + side for i, drive in enumerate(self.drives) if i > 1 and drive for side in (0, 1)]
        return MOTORS + tuple(sides_of(len(self.modules))[side] for side in driven)

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """Wheel joints as published in ``/joint_states``."""
        return tuple(f"{wheel}_wheel" for wheel in wheels_of(len(self.modules)))

    @property
    def articulation_joints(self) -> tuple[str, ...]:
        """Articulation joints as published there: yaw and roll of the first, and numbered those behind it."""
        numbers = ["", *(f"_{j + 2}" for j in range(len(self.trailing)))] if self.articulated else []
        return tuple(f"articulation_{axis}{number}" for number in numbers for axis in ("yaw", "roll"))

    @property
    def drive_front(self) -> Drive:
        """Drive of the front motors."""
        return self.drive.front

    @property
    def drive_back(self) -> Drive | None:
        """Drive of the back motors, None for a rigid robot."""
        return self.drive.back

    def quantities(self) -> Iterator[tuple[str, Quantity, float]]:
        """Every physical parameter as (key, declaration, value), in the order of a robot file."""
        yield from _listed(self, "", ("sensors", "odometry"))

    def sensor_quantities(self) -> Iterator[tuple[str, Quantity, float]]:
        """What is known of its sensors, as `quantities` (``"sensors.gyro_delay"``); no simulation asks for it."""
        yield from _listed(self.sensors, "sensors.")
        yield from _listed(self.odometry, "odometry.")

    def effect_quantities(self) -> Iterator[tuple[str, Quantity, float]]:
        """Every number of the effects that the robot has, as `quantities` (``"effects.slope.grade"``)."""
        for name, values in self.effects.items():
            for parameter, declared in EFFECTS[name].parameters.items():
                if isinstance(declared.quantity, Quantity):
                    yield f"effects.{name}.{parameter}", declared.quantity, float(values[parameter])

    @property
    def effects_beside(self) -> dict[str, dict[str, Any]]:
        """What its effects have that does not come of `motor` already."""
        own = self.motor.effects
        found = {name: dict(values) for name, values in self.effects.items() if name not in own}
        for name, values in own.items():
            others = {key: value for key, value in self.effects[name].items() if value != values.get(key)}
            found |= {name: others} if others else {}
        return found

    def as_vector(self, keys: Sequence[str]) -> NDArray[np.float64]:
        """Values of `keys` (``"contact.k_l"``, ``"effects.slope.grade"``, …) as an array, for fitting."""
        values = {key: value for key, _, value in (*self.quantities(), *self.effect_quantities())}
        return np.array([_look_up(values, key) for key in keys])

    def with_vector(self, keys: Sequence[str], values: Sequence[float] | NDArray[np.float64]) -> Robot:
        """A robot whose `keys` have `values` (same order), all else as here."""
        return self.replace(dict(zip(keys, map(float, values), strict=True)))

    def replace(self, changes: Mapping[str, Any], *, source: str = "assumed: set by hand") -> Robot:
        """A robot with other values.

        Parameters
        ----------
        changes : mapping
            Key (``"contact.k_l"``, ``"front.m"``, ``"effects.slope.grade"`` of an effect it has) to value.
        source : str
            What is noted as the origin of the changed values.
        """
        own = {key for key, _, _ in self.quantities()}
        known = own | {key for key, _, _ in self.effect_quantities()}
        for key in changes:
            if key not in known and key not in _SWITCHES:
                raise ArtibotError(f"{key}: not a parameter of robot '{self.name}'; known: {', '.join(sorted(known))}")
        sources = dict(self.sources) | {key: source for key in changes if key in known}
        leaves: dict[tuple[str, ...], Any] = {
            tuple(key.split(".")): float(v) if key in own else bool(v)
            for key, v in changes.items()
            if key not in known - own
        }
        effects = self.effects_beside
        for key in (known - own) & set(changes):
            _, name, parameter = key.split(".")
            effects.setdefault(name, {})[parameter] = float(changes[key])
        return _replace_leaves(self, leaves | {("sources",): sources, ("effects",): effects})


def unchecked(robot: Robot, effects: Mapping[str, Values], contact: Contact | None = None) -> Robot:
    """A copy with other effects, all their parameters given, and another soil; nothing of it is checked again.

    For simulations by the thousand: to check a hundred numbers takes as long as to simulate seconds of driving.
    """
    other = copy.copy(robot)
    object.__setattr__(other, "effects", MappingProxyType(dict(effects)))
    if contact is not None:
        object.__setattr__(other, "contact", contact)
    return other


def _listed(node: Any, path: str, without: Sequence[str] = ()) -> list[tuple[str, Quantity, float]]:
    """Every physical parameter of a tree, but of the node's own parts `without`."""
    found: list[tuple[str, Quantity, float]] = []
    for name, declared in _entries(node.__class__):
        value = getattr(node, name)
        if declared is not None:
            found.append((f"{path}{name}", declared, value))
        elif name == "trailing":
            for i, item in enumerate(value):
                if item is not None:
                    found += _listed(item, f"{path}{module_name(i + 2)}.")
        elif name not in without and _entries(value.__class__):
            found += _listed(value, f"{path}{name}.")
    return found


@cache
def _entries(kind: type) -> tuple[tuple[str, Quantity | None], ...]:
    """Names of a dataclass's fields, each with its declaration where it is a physical parameter; none of others."""
    if not dataclasses.is_dataclass(kind):
        return ()
    return tuple((entry.name, entry.metadata.get("quantity")) for entry in dataclasses.fields(kind))


def _look_up(values: Mapping[str, float], key: str) -> float:
    if key not in values:
        raise ArtibotError(f"{key}: not a parameter; known: {', '.join(sorted(values))}")
    return values[key]


_SWITCHES = tuple(f"readings.{entry.name}" for entry in dataclasses.fields(Readings))


def _replace_leaves(node: Any, leaves: Mapping[tuple[str, ...], Any]) -> Any:
    """A copy of the tree with these leaves changed, all at once: the checks see only the finished tree."""
    changed = {path[0]: value for path, value in leaves.items() if len(path) == 1}
    for head in {path[0] for path in leaves if len(path) > 1}:
        below = {path[1:]: value for path, value in leaves.items() if path[0] == head and len(path) > 1}
        if head.startswith("module_"):
            behind, place = list(changed.get("trailing", node.trailing)), int(head[7:]) - FIRST_TRAILING
            behind[place] = _replace_leaves(behind[place], below)
            changed["trailing"] = tuple(behind)
        else:
            changed[head] = _replace_leaves(getattr(node, head), below)
    return dataclasses.replace(node, **changed)


SUSPENSIONS = ("rocker", "rigid")


def _check_together(robot: Robot) -> None:
    """Relations between parameters that bounds alone do not catch."""
    if robot.suspension not in ("", *SUSPENSIONS):
        raise ArtibotError(f"suspension: found {robot.suspension!r}, expected one of {', '.join(SUSPENSIONS)}")
    if (robot.back is None) != (robot.drive.back is None):
        raise ArtibotError("drive.back: a robot has it exactly when it has a back module; give both or neither")
    if robot.contact.mu_d > robot.contact.mu_s:
        raise ArtibotError(
            f"contact.mu_d: {robot.contact.mu_d:g} exceeds mu_s {robot.contact.mu_s:g}; "
            "eq. 16 lets the force drop when a wheel breaks away, so mu_d must not be larger"
        )
    if math.isinf(robot.motor.stall_torque) and math.isfinite(robot.motor.no_load_speed):
        raise ArtibotError("motor.no_load_speed: a torque-speed line has motor.stall_torque, too; give both or neither")
    if robot.trailing and robot.back is None:
        raise ArtibotError("module_3: stands behind `back`, which is missing; call the second module `back`")
    if len(robot.drive.trailing) != len(robot.trailing):
        raise ArtibotError(
            f"drive.trailing: {len(robot.drive.trailing)} entries for {len(robot.trailing)} modules behind `back`; "
            "give one each, None for a passive module"
        )
    for name, values in robot.effects.items():
        law = EFFECTS[name].law
        for key, value in (values if law is None else law(values)).items():
            if isinstance(value, str) and robot.articulated and of_pair(value)[1] >= len(robot.modules):
                raise ArtibotError(f"effects.{name}.{key}: '{value}': the robot has {len(robot.modules)} modules")
    for i, module in enumerate(robot.modules):
        J = sorted((module.J_x, module.J_y, module.J_z))
        if J[2] > (J[0] + J[1]) * (1 + 1e-9):
            raise ArtibotError(
                f"{module_name(i)}.J_x, J_y, J_z: {module.J_x:g}, {module.J_y:g}, {module.J_z:g} kg m^2 break the "
                "triangle inequality, which every body obeys; check the largest one"
            )
    for i, drive in enumerate(robot.drives):
        for side in ("right", "left"):
            if drive is not None and abs(getattr(drive.polarity, side)) != 1:
                raise ArtibotError(f"drive.{module_name(i)}.polarity.{side}: must be 1 or -1")
