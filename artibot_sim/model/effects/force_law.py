"""Forces that follow a variable: what a diagnosis finds where nothing on the list explains the data, as a model term.

A law says where a force acts, which variable it follows there, and in which form::

    force = size · form(variable / scale) [ · times_form(times / times_scale)]

Words and units of all three are in the tables of this file; who looks for laws and who simulates them use the same.
A robot has at most three of them (`force_law`, `force_law_2`, `force_law_3`). Robots with laws are simulated by code of
their own: for all others nothing of this is compiled. What the rover as a whole does at an instant is known before any
law is asked: noted in the record of its effects (MOTION), or handed over as `NotedMotion`. Where rovers run side by
side in vector units, which laws would break with their branches, their forces are known before anybody asks for them
(`LawForces`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from numba.extending import overload

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import parts
from artibot_sim.model.effects.base import Effect, EffectParameter, Values, choice, number
from artibot_sim.model.kernels.compilation import called, inlined, kernel
from artibot_sim.model.kernels.elementary import exp, log, sincos, tanh, whole

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params

# ----------------------------------------------------------------------
# What laws are made of: places, variables and forms, with words and units.
# ----------------------------------------------------------------------

MOTORS = ("front_right", "front_left", "back_right", "back_left")
WHEELS = tuple(f"{motor}_{end}" for motor in MOTORS for end in ("front", "back"))

PLACES: dict[str, str] = {
    **{
        f"{end}_{short}": f"{end} {words}"
        for end in ("front", "back")
        for short, words in (("surge", "surge force"), ("sway", "sway force"), ("yaw", "yaw moment"))
    },
    "joint": "yaw moment in the joint",
    "wheels_lateral": "lateral force of each wheel",
    "front_wheels_lateral": "lateral force of each front wheel",
    "back_wheels_lateral": "lateral force of each back wheel",
    **{f"{wheel}_lateral": f"lateral force at {wheel}" for wheel in WHEELS},
    "wheels_longitudinal": "longitudinal force of each wheel",
    **{f"{motor}_longitudinal": f"longitudinal force of the {motor} wheels" for motor in MOTORS},
    "motors_torque": "torque of each motor",
    **{f"{motor}_torque": f"torque of motor {motor}" for motor in MOTORS},
}
"""Where a law's force acts → words.

Forces are at a module's origin along and across its own frame; moments turn left, that in the joint the front module.
A longitudinal force is that of both wheels of a motor, which nothing tells apart, and the motor feels it; a lateral one
acts where the wheel's own does. The torque of a motor is what it needs beside its load.
"""

_NAMES = tuple(PLACES)
JOINT = _NAMES.index("joint")
EACH_LATERAL, FRONT_LATERAL, BACK_LATERAL = JOINT + 1, JOINT + 2, JOINT + 3
LATERAL = BACK_LATERAL + 1
EACH_LONGITUDINAL = LATERAL + len(WHEELS)
LONGITUDINAL = EACH_LONGITUDINAL + 1
EACH_TORQUE = LONGITUDINAL + len(MOTORS)
TORQUE = EACH_TORQUE + 1

VARIABLES: dict[str, tuple[str, str]] = {
    "nothing": ("nothing", ""),
    "time": ("time since the start", "s"),
    "speed": ("speed", "m/s"),
    "lateral_speed": ("lateral speed", "m/s"),
    "yaw_rate": ("yaw rate", "rad/s"),
    "curvature": ("curvature", "1/m"),
    "heading": ("heading", "rad"),
    "place": ("place", "m"),
    "slip": ("own slip", "m/s"),
    "angle": ("own angle", "rad"),
    "load": ("own load", "N"),
    "articulation_angle": ("articulation angle", "rad"),
    "articulation_rate": ("articulation rate", "rad/s"),
    **{f"{motor}_angle": (f"wheel angle {motor}", "rad") for motor in MOTORS},
}
"""What a law may follow → words and unit.

Of a module its own motion, of the joint the front module's. Of a wheel the velocity of its centre, of a motor the
rolling speed of its wheels. `place` is the coordinate of where the force acts along `direction` in `map`, less
`offset`; `slip` is the rims' speed less the centre's; angles are the wheels', not the motors'.
"""

(
    NOTHING, TIME, SPEED, LATERAL_SPEED, YAW_RATE, CURVATURE, HEADING, PLACE, SLIP, ANGLE, LOAD, BEND, BEND_RATE,
    FIRST_ANGLE,
) = range(len(VARIABLES) - len(MOTORS) + 1)  # fmt: skip

FORMS: dict[str, str] = {
    "constant": "1",
    "linear": "u",
    "quadratic": "u |u|",
    "magnitude": "|u|",
    "coulomb": "tanh(u)",
    "power": "sign(u) |u|^exponent",
    "periodic": "cos(2π u + phase)",
    "threshold": "sign(u) max(|u| − 1, 0)",
    "decaying": "exp(−|u|)",
    "step": "(1 + tanh(u)) / 2",
}
"""Forms → formula in u = variable / scale."""

CONSTANT, LINEAR, QUADRATIC, MAGNITUDE, COULOMB, POWER, PERIODIC, THRESHOLD, DECAYING, STEP = range(len(FORMS))

SLOW = 0.05
"""m/s below which a path has no curvature."""


# ----------------------------------------------------------------------
# How a law is computed.
# ----------------------------------------------------------------------


class LocalMotion(NamedTuple):
    """What a force could follow where it acts, beside what the record notes of its module.

    speed, lateral_speed and slip (m/s) as in VARIABLES; angle (rad); x, y in `map` (m); load (N).
    """

    speed: float
    lateral_speed: float
    slip: float
    angle: float
    x: float
    y: float
    load: float


MOTION = (
    ("x", 2), ("y", 2), ("yaw", 2), ("forward", 2), ("left", 2), ("turn", 2), ("angle", 4), ("bend", 1),
    ("bend_rate", 1),
)  # fmt: skip
"""What is noted of an instant, and how many numbers of it: pose and velocity of both modules (in their own frames), the
wheels' angles motor by motor, yaw and yaw rate of the articulation."""


class LawNumbers(NamedTuple):
    """A law's parameters, see PARAMETERS, where they are no record."""

    size: float
    where: float
    variable: float
    form: float
    scale: float
    exponent: float
    phase: float
    direction: float
    offset: float
    times: float
    times_form: float
    times_scale: float


@inlined
def numbers_of(law):
    """Those of a record."""
    return LawNumbers(
        law.size, law.where, law.variable, law.form, law.scale, law.exponent, law.phase, law.direction, law.offset,
        law.times, law.times_form, law.times_scale,
    )  # fmt: skip


class NotedMotion(NamedTuple):
    """What is noted of an instant, see MOTION, where it is no part of a record."""

    x: tuple[float, float]
    y: tuple[float, float]
    yaw: tuple[float, float]
    forward: tuple[float, float]
    left: tuple[float, float]
    turn: tuple[float, float]
    angle: tuple[float, float, float, float]
    bend: tuple[float]
    bend_rate: tuple[float]


class LawForces(NamedTuple):
    """What all laws of a rover do at an instant, where it is computed before it is asked for.

    Attributes
    ----------
    load : tuple of 6 floats
        Surge (N), sway (N) and yaw (N m) of the front module, then of the back one.
    joint : float
        Yaw moment on the front module, N m.
    across : tuple of 8 floats
        Lateral force at each wheel, N.
    along, shaft : tuple of 4 floats
        Longitudinal force at both wheels of each motor (N), and torque at its shaft (N m).
    """

    load: tuple[float, float, float, float, float, float]
    joint: float
    across: tuple[float, float, float, float, float, float, float, float]
    along: tuple[float, float, float, float]
    shaft: tuple[float, float, float, float]


LOAD_AT, JOINT_AT, ACROSS_AT, ALONG_AT, SHAFT_AT, FORCES = 0, 6, 7, 15, 19, 23
"""Where the numbers of `LawForces` begin, one after the other, and how many they are."""


@inlined
def range_of(where):
    """Numbers among those of `LawForces` that a law at a place of PLACES adds to: the first, and how many."""
    if where < EACH_LATERAL:
        return where, 1
    if where < LATERAL:
        return ACROSS_AT + (4 if where == BACK_LATERAL else 0), 8 if where == EACH_LATERAL else 4
    if where < EACH_LONGITUDINAL:
        return ACROSS_AT + where - LATERAL, 1
    if where < EACH_TORQUE:
        each = where == EACH_LONGITUDINAL
        return (ALONG_AT, 4) if each else (ALONG_AT + where - LONGITUDINAL, 1)
    return (SHAFT_AT, 4) if where == EACH_TORQUE else (SHAFT_AT + where - TORQUE, 1)


def forces_in(fx: Any) -> Any:
    """`LawForces` among effects; None, at compile time, where they are not known beforehand."""
    return getattr(fx, "law_forces", None)


@overload(forces_in, jit_options={"forceinline": True}, strict=False)
def _forces_in(fx: Any) -> Any:
    return (lambda fx: fx.law_forces) if "law_forces" in getattr(fx, "fields", ()) else (lambda fx: None)


def motion_in(fx: Any) -> Any:
    """What laws see, among effects; None, at compile time, where there are no laws."""
    return getattr(fx, "motion", None)


def laws_in(fx: Any) -> Any:
    """The three laws among effects, see `motion_in`."""
    return (fx.force_law, fx.force_law_2, fx.force_law_3) if hasattr(fx, "motion") else None


def _has_laws(fx: Any) -> bool:
    return "motion" in getattr(fx, "fields", ())


@overload(motion_in, jit_options={"forceinline": True}, strict=False)
def _motion_in(fx: Any) -> Any:
    return (lambda fx: fx.motion) if _has_laws(fx) else (lambda fx: None)


@overload(laws_in, jit_options={"forceinline": True}, strict=False)
def _laws_in(fx: Any) -> Any:
    if not _has_laws(fx):
        return lambda fx: None
    if "laws" in fx.fields:
        return lambda fx: fx.laws
    return lambda fx: (fx.force_law, fx.force_law_2, fx.force_law_3)


@inlined
def note_module(motion, module, x, y, yaw, forward, left, turn):
    """Note a module's pose and velocity, where anybody asks for them (`motion` is not None)."""
    if motion is not None:
        motion.x[module], motion.y[module], motion.yaw[module] = x, y, yaw
        motion.forward[module], motion.left[module], motion.turn[module] = forward, left, turn


@inlined
def note_angles(motion, right_f, left_f, right_b, left_b, bend, bend_rate):
    """Note the wheels' angles and the articulation's yaw, see `note_module`."""
    if motion is not None:
        motion.angle[0], motion.angle[1], motion.angle[2], motion.angle[3] = right_f, left_f, right_b, left_b
        motion.bend[0], motion.bend_rate[0] = bend, bend_rate


@inlined
def shape(form, u, exponent, phase):
    """A form's value, see FORMS."""
    if form == LINEAR:
        return u
    if form == QUADRATIC:
        return u * abs(u)
    if form == MAGNITUDE:
        return abs(u)
    if form == COULOMB:
        return tanh(u)
    if form == POWER:
        size = abs(u)
        if size < 1e-12:
            return 0.0
        return math.copysign(exp(exponent * log(size)), u)
    if form == PERIODIC:
        _, cosine = sincos(2.0 * math.pi * (u - whole(u)) + phase)  # so many periods away it is as exact
        return cosine
    if form == THRESHOLD:
        return math.copysign(max(abs(u) - 1.0, 0.0), u)
    if form == DECAYING:
        return exp(-abs(u))
    if form == STEP:
        return 0.5 + 0.5 * tanh(u)
    return 1.0


@kernel
def shapes(form, u, out):
    """A form's values at `u` into `out` (n,), see `shape`; of forms that take no other number."""
    for i in range(len(u)):
        out[i] = shape(form, u[i], 1.0, 0.0)


@inlined
def variable_value(variable, law, motion, joint, t, module, own):
    """The value of a variable of VARIABLES where a force acts, on a module or a part of it.

    `joint` are yaw (rad) and yaw rate (rad/s) of the articulation.
    """
    if variable == TIME:
        return t
    if variable == SPEED:
        return own.speed
    if variable == LATERAL_SPEED:
        return own.lateral_speed
    if variable == YAW_RATE:
        return motion.turn[module]
    if variable == CURVATURE:
        forward = motion.forward[module]
        return motion.turn[module] * forward / (forward * forward + SLOW * SLOW)
    if variable == HEADING:
        return motion.yaw[module]
    if variable == PLACE:
        sine, cosine = sincos(law.direction)
        return own.x * cosine + own.y * sine - law.offset
    if variable == SLIP:
        return own.slip
    if variable == ANGLE:
        return own.angle
    if variable == LOAD:
        return own.load
    if variable == BEND:
        return joint[0]
    if variable == BEND_RATE:
        return joint[1]
    if variable >= FIRST_ANGLE:
        return motion.angle[int(variable) - FIRST_ANGLE]
    return 0.0


@inlined
def bent(motion):
    """Yaw and yaw rate of the articulation, as noted."""
    return motion.bend[0], motion.bend_rate[0]


@called
def value(law, motion, joint, t, module, own):
    """The force of a law (N or N m) on a part of a `module`, of which `own` is known.

    `joint` are yaw (rad) and yaw rate (rad/s) of the articulation.
    """
    u = variable_value(law.variable, law, motion, joint, t, module, own) / law.scale
    force = law.size * shape(law.form, u, law.exponent, law.phase)
    if law.times != NOTHING:
        factor = variable_value(law.times, law, motion, joint, t, module, own) / law.times_scale
        force *= shape(law.times_form, factor, law.exponent, law.phase)
    return force


@inlined
def on_module(laws, motion, known, t, module):
    """Force of laws along and across a module's own frame (N) and yaw moment (N m)."""
    if known is not None:
        return known.load[3 * module], known.load[3 * module + 1], known.load[3 * module + 2]
    surge, sway, turn = 0.0, 0.0, 0.0
    if laws is not None:
        for law in laws:
            where = law.where - 3.0 * module
            if law.size != 0.0 and where >= 0.0 and where < 3.0 and module < 2:
                own = LocalMotion(
                    motion.forward[module], motion.left[module], 0.0, 0.0, motion.x[module], motion.y[module], 0.0
                )
                force = value(law, motion, bent(motion), t, module, own)
                surge += force if where == 0.0 else 0.0
                sway += force if where == 1.0 else 0.0
                turn += force if where == 2.0 else 0.0
    return surge, sway, turn


@inlined
def on_wheel(laws, motion, known, t, wheel, own):
    """Lateral force of laws at a wheel (its number), N."""
    if known is not None:
        return known.across[wheel]
    force = 0.0
    if laws is not None:
        for law in laws:
            among = law.where == EACH_LATERAL or (law.where == LATERAL + wheel and wheel < 8)
            if law.size != 0.0 and (among or law.where == (FRONT_LATERAL if wheel < 4 else BACK_LATERAL)):
                force += value(law, motion, bent(motion), t, 0 if wheel < 4 else 1, own)
    return force


@inlined
def on_pair(laws, motion, known, t, motor, own):
    """Longitudinal force of laws at both wheels of a motor (its number), N."""
    if known is not None:
        return known.along[motor]
    force = 0.0
    if laws is not None:
        for law in laws:
            among = law.where == EACH_LONGITUDINAL or (law.where == LONGITUDINAL + motor and motor < 4)
            if law.size != 0.0 and among:
                force += value(law, motion, bent(motion), t, 0 if motor < 2 else 1, own)
    return force


@inlined
def on_motor(laws, motion, known, t, motor, angle, speed):
    """Torque of laws that a motor needs beside its load, N m; its wheels' `angle` (rad) and rolling `speed` (m/s)."""
    if known is not None:
        return known.shaft[motor]
    torque = 0.0
    if laws is not None:
        module = 0 if motor < 2 else 1
        own = LocalMotion(speed, 0.0, 0.0, angle, motion.x[module], motion.y[module], 0.0)
        for law in laws:
            among = law.where == EACH_TORQUE or (law.where == TORQUE + motor and motor < 4)
            if law.size != 0.0 and among:
                torque += value(law, motion, bent(motion), t, module, own)
    return torque


@inlined
def in_joint(laws, motion, known, t, angle, rate):
    """Yaw moment of laws on the front module, with its opposite on the back one, N m."""
    if known is not None:
        return known.joint
    moment = 0.0
    if laws is not None:
        own = LocalMotion(motion.forward[0], motion.left[0], 0.0, 0.0, motion.x[0], motion.y[0], 0.0)
        for law in laws:
            if law.size != 0.0 and law.where == JOINT:
                moment += value(law, motion, (angle, rate), t, 0, own)
    return moment


@inlined
def module_load(fx, module):
    """What laws do at a module's origin, see `on_module`."""
    return on_module(laws_in(fx), motion_in(fx), forces_in(fx), fx.t, module)


@inlined
def wheel_across(fx, wheel, own):
    """Lateral force of laws at a wheel, N."""
    return on_wheel(laws_in(fx), motion_in(fx), forces_in(fx), fx.t, wheel, own)


@inlined
def pair_along(fx, motor, own):
    """Longitudinal force of laws at both wheels of a motor, N."""
    return on_pair(laws_in(fx), motion_in(fx), forces_in(fx), fx.t, motor, own)


@inlined
def motor_shaft(fx, motor, angle, speed):
    """Torque of laws at a motor's shaft, N m."""
    return on_motor(laws_in(fx), motion_in(fx), forces_in(fx), fx.t, motor, angle, speed)


@inlined
def joint_moment(fx, angle, rate):
    """Torque of laws in the articulation's yaw, N m."""
    return in_joint(laws_in(fx), motion_in(fx), forces_in(fx), fx.t, angle, rate)


HOOKS: Mapping[str, Callable[..., Any]] = {
    "load": module_load, "across": wheel_across, "along": pair_along, "shaft": motor_shaft, "joint": joint_moment,
}  # fmt: skip
"""What compiled code asks of laws, all of them together: what each asks for itself is compiled three times."""


# ----------------------------------------------------------------------
# The declaration: parameters, which of them go together, how stiff a law is.
# ----------------------------------------------------------------------

NAMES = ("force_law", "force_law_2", "force_law_3")
"""The laws that a robot may have."""

_ANYWHERE = ("nothing", "time", "yaw_rate", "curvature", "heading", "place", "speed", *tuple(VARIABLES)[BEND:])
_WHEEL = (*_ANYWHERE, "lateral_speed", "slip", "angle")


def place_words(where: str) -> str:
    """What people call a place where a law acts, of any module."""
    own, behind = parts.of_pair(where)
    if behind < 2:
        return PLACES[own]
    return f"yaw moment in joint {behind}" if own == "joint" else _of_module(PLACES[own], behind)


def variable_words(name: str) -> tuple[str, str]:
    """What people call a variable, of any module, and its unit."""
    own, behind = parts.of_pair(name)
    words, unit = VARIABLES[own]
    return (_of_module(words, behind) if behind > 1 else words), unit


def _of_module(words: str, behind: int) -> str:
    return words.replace("back", parts.in_robot("back", behind), 1)


def follows(where: str) -> tuple[str, ...]:
    """The variables that a law can follow at a place of a pair of modules, in the order of VARIABLES."""
    known = (*_ANYWHERE, "lateral_speed")
    if where.endswith("_lateral"):
        known = (*_WHEEL, "load")
    elif where.endswith("_longitudinal"):
        known = _WHEEL
    elif where.endswith("_torque"):
        known = (*_ANYWHERE, "angle")
    return tuple(name for name in VARIABLES if name in known)


def unit_of(where: str) -> str:
    """Unit of a law's size."""
    return "N m" if parts.of_pair(where)[0].endswith(("_yaw", "_torque", "joint")) else "N"


def formula(values: Values) -> str:
    """A law in words and numbers: ``lateral force of each wheel = 14 N · cos(2π · place along 0° in map / 1.1 m)``."""
    where = str(values["where"])
    said = f"{place_words(where)} = {float(values['size']):.3g} {unit_of(where)}"
    for variable, form, scale in (("variable", "form", "scale"), ("times", "times_form", "times_scale")):
        if values[variable] != "nothing" and values[form] != "constant":
            said += f" · {_factor(values, str(values[variable]), str(values[form]), float(values[scale]))}"
    return said


def _factor(values: Values, variable: str, form: str, scale: float) -> str:
    words, unit = variable_words(variable)
    if variable == "place":
        words = f"place along {math.degrees(float(values['direction'])):.0f}° in map"
        if values["offset"]:
            words = f"({words} {_signed(-float(values['offset']))} m)"
    u = words if scale == 1.0 else f"{words} / {scale:.3g} {unit}".rstrip()
    sign = f"sign({words})"
    phase = f" {_signed(float(values['phase']))}"
    return {
        "linear": f"({u})", "quadratic": f"({u}) |{u}|", "magnitude": f"|{u}|", "coulomb": f"tanh({u})",
        "power": f"{sign} |{u}|^{float(values['exponent']):.3g}", "periodic": f"cos(2π {u}{phase})",
        "threshold": f"{sign} max(|{u}| − 1, 0)", "decaying": f"exp(−|{u}|)",
        "step": f"(1 + tanh({u})) / 2",
    }[form]  # fmt: skip


def _signed(value: float) -> str:
    """A number to add: ``+ 0.40``."""
    return f"{value:+.2f}".replace("+", "+ ").replace("-", "− ")


def check(values: Values, path: str) -> None:
    """Refuse a law whose parts do not go together."""
    where, behind = parts.of_pair(str(values["where"]))
    for key in ("variable", "times"):
        variable, of = parts.of_pair(str(values[key]))
        if variable not in follows(where) or (of != behind and (behind if of == 1 else of)):
            known = [parts.in_robot(name, max(behind, 1)) for name in follows(where)]
            raise ArtibotError(
                f"{path}.{key}: '{values[key]}' means nothing to the {place_words(str(values['where']))}; it can "
                f"follow {', '.join(known)}"
            )
    for key, form in (("variable", "form"), ("times", "times_form")):
        if values[key] == "nothing" and values[form] != "constant":
            raise ArtibotError(
                f"{path}.{form}: '{values[form]}' needs a variable; expected '{key}', too, or 'constant'"
            )
        if values[key] != "nothing" and values[form] == "constant":
            others = ", ".join(name for name in FORMS if name != "constant")
            raise ArtibotError(
                f"{path}.{form}: 'constant' does not follow the {variable_words(str(values[key]))[0]}; expected one of "
                f"{others}, or no '{key}'"
            )


_FASTEST = 0.5
"""Speed (m/s) or rate (rad/s) up to which a step that is accepted is stable."""


def steepness(values: Values) -> float:
    """The largest slope of a law by its variable, N or N m per unit of it, up to `_FASTEST`."""
    size, scale = abs(float(values["size"])), abs(float(values["scale"]))
    u, form = _FASTEST / scale, values["form"]
    if form == "power":
        slope = float(values["exponent"]) * max(u, 1e-2) ** (float(values["exponent"]) - 1.0)
    else:
        slope = {"constant": 0.0, "quadratic": 2.0 * u, "periodic": 2.0 * math.pi}.get(form, 1.0)
    return size * slope / scale


def adapt(p: Params, values: Values) -> Params:
    """What a law adds at most to the damping of what it acts on, which limits an explicit step."""
    where, variable, slope = values["where"], values["variable"], steepness(values)
    if where == "joint" and variable == "articulation_rate":
        return p._replace(joint_damping=p.joint_damping + slope)
    if where.endswith("_torque") and variable == "speed":
        changed = {}
        for name in ("right_front", "left_front", "right_back", "left_back"):
            motor = getattr(p, name)
            changed[name] = motor._replace(damping=motor.damping + slope * motor.r_w * motor.tau)
        return p._replace(**changed)
    if where.endswith("_surge") and variable == "speed":
        return p._replace(forward_damping=p.forward_damping + slope / 4.0)
    if where.endswith("_longitudinal") and variable in ("speed", "slip"):
        return p._replace(forward_damping=p.forward_damping + slope / 2.0)
    if where.endswith("_sway") and variable == "lateral_speed":
        return p._replace(lateral_damping=p.lateral_damping + slope / 4.0)
    if where.endswith("_lateral") and variable == "lateral_speed":
        return p._replace(lateral_damping=p.lateral_damping + slope)
    if where.endswith("_yaw") and variable == "yaw_rate":
        arm = p.front.half_x * p.front.half_x
        return p._replace(lateral_damping=p.lateral_damping + slope / (4.0 * arm))
    return p


_ANY = (-math.inf, math.inf)

PARAMETERS: dict[str, EffectParameter] = {
    "size": number("SI", *_ANY, "how large it is: N, or N m of a moment or torque"),
    "where": choice(tuple(PLACES), "where it acts"),
    "variable": choice(tuple(VARIABLES), "what it follows"),
    "form": choice(tuple(FORMS), "in which form"),
    "scale": number("SI", 0.0, math.inf, "what the variable is measured by, in its unit; a period", 1.0, low_open=True),
    "exponent": number("-", 0.0, 10.0, "of a power", 1.0),
    "phase": number("rad", *_ANY, "of what is periodic"),
    "direction": number("rad", *_ANY, "of a place: along which it is measured in map"),
    "offset": number("m", *_ANY, "of a place: from where on it is measured"),
    "times": choice(tuple(VARIABLES), "a second variable, whose form is a factor"),
    "times_form": choice(tuple(FORMS), "the form of that one"),
    "times_scale": number("SI", 0.0, math.inf, "what the second one is measured by", 1.0, low_open=True),
}


def declared(name: str) -> Effect:
    """The law of this name as an effect."""
    return Effect(
        id=name,
        acts="law",
        doc="A force that follows a variable: size · form(variable / scale), see `docs/laws.md`.",
        parameters=PARAMETERS,
        adapt=adapt,
        hooks=HOOKS,
        check=check,
        uniform=False,
    )


EFFECT = declared(NAMES[0])
