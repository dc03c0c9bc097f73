"""The contract's 27 effects: a size drawn for each, and what it changes in a machine.

`severity` scales the departure from neutral (the two limits as the contract says); directions, signs and choices are
drawn. Sizes that would turn a factor negative stop at 0.05.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, sin
from typing import Any, NamedTuple

import numpy as np
from diagnose.hidden.machine import Machine
from diagnose.hidden.parts import GRAVITY

Rng = np.random.Generator
Values = dict[str, Any]
MOTORS = ("front_right", "front_left", "back_right", "back_left")
LEAST = 0.05
"""Of a factor, however severe."""


class Recipe(NamedTuple):
    """How an effect is drawn, and what it does.

    Attributes
    ----------
    draw : function of (rng, severity, track) to parameters under the contract's names
        `track` (n, 2) is where the rover was without the effect, m.
    apply : function of (machine, parameters) to a machine
    """

    draw: Callable[[Rng, float, np.ndarray], Values]
    apply: Callable[[Machine, Values], Machine]


def _sign(rng: Rng) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _heading(rng: Rng) -> float:
    return float(rng.uniform(-pi, pi))


def _sized(name: str, size: float) -> Callable[[Rng, float, np.ndarray], Values]:
    """One parameter, neutral at 0, of one sign."""
    return lambda rng, s, track: {name: size * s}


def _signed(name: str, size: float, neutral: float = 0.0) -> Callable[[Rng, float, np.ndarray], Values]:
    return lambda rng, s, track: {
        name: max(LEAST, neutral + _sign(rng) * size * s) if neutral else _sign(rng) * size * s
    }


def _factor(name: str, at_one: float) -> Callable[[Rng, float, np.ndarray], Values]:
    return lambda rng, s, track: {name: max(LEAST, 1.0 - (1.0 - at_one) * s)}


def _field(name: str, parameter: str) -> Callable[[Machine, Values], Machine]:
    """An effect that is one number of `Hidden`."""
    return lambda machine, values: machine.hiding(**{name: values[parameter]})


def _way(name: str, parameter: str) -> Callable[[Machine, Values], Machine]:
    return lambda machine, values: replace(machine, way=replace(machine.way, **{name: values[parameter]}))


def _sensor(**names: str) -> Callable[[Machine, Values], Machine]:
    def apply(machine: Machine, values: Values) -> Machine:
        found = {name: values[parameter] for name, parameter in names.items()}
        return replace(machine, sensing=replace(machine.sensing, **found))

    return apply


def _drag(machine: Machine, values: Values) -> Machine:
    return machine.hiding(drag_motor=float(MOTORS.index(values["motor"])), drag=values["torque"])


def _gears(machine: Machine, values: Values) -> Machine:
    gears = (machine.rover.front_gear, machine.rover.back_gear)
    front, back = (gear._replace(eta_d=min(1.0, gear.eta_d * values["scale"])) for gear in gears)
    return machine.with_rover(front_gear=front, back_gear=back)


def _radii(machine: Machine, values: Values) -> Machine:
    half, rover = 0.5 * values["relative"], machine.rover
    return machine.with_rover(r_right=rover.r_right * (1.0 + half), r_left=rover.r_left * (1.0 - half))


def _worn(machine: Machine, values: Values) -> Machine:
    scale, rover = values["scale"], machine.rover
    return machine.with_rover(r_right=rover.r_right * scale, r_left=rover.r_left * scale)


def _slope(machine: Machine, values: Values) -> Machine:
    along, heading = GRAVITY * sin(values["grade"]), values["heading"]
    return machine.hiding(
        pull_x=along * cos(heading), pull_y=along * sin(heading), gravity=GRAVITY * cos(values["grade"])
    )


def _push(machine: Machine, values: Values) -> Machine:
    force, heading = values["force"], values["heading"]
    return machine.hiding(push_x=force * cos(heading), push_y=force * sin(heading))


def _draw_patch(rng: Rng, s: float, track: np.ndarray) -> Values:
    x, y = track[int(rng.integers(len(track)))]
    return {"scale": max(LEAST, 1.0 - 0.45 * s), "x": float(x), "y": float(y), "radius": float(rng.uniform(1.2, 2.2))}


def _patch(machine: Machine, values: Values) -> Machine:
    return machine.hiding(**{f"patch_{name}": value for name, value in values.items()})


def _centre(machine: Machine, values: Values) -> Machine:
    return machine.with_rover(front=machine.rover.front._replace(c_x=values["x"], c_y=values["y"]))


def _payload(machine: Machine, values: Values) -> Machine:
    body = getattr(machine.rover, values["module"])
    return machine.with_rover(**{values["module"]: body._replace(m=body.m + values["mass"])})


def _draw_two(x: float, y: float) -> Callable[[Rng, float, np.ndarray], Values]:
    return lambda rng, s, track: {"x": _sign(rng) * x * s, "y": _sign(rng) * y * s}


def _chosen(
    size: str, at_one: float, name: str, choices: tuple[str, ...]
) -> Callable[[Rng, float, np.ndarray], Values]:
    return lambda rng, s, track: {size: at_one * s, name: str(rng.choice(choices))}


def _towards(size: str, at_one: float) -> Callable[[Rng, float, np.ndarray], Values]:
    return lambda rng, s, track: {size: at_one * s, "heading": _heading(rng)}


LISTED: dict[str, Recipe] = {
    "torque_limit": Recipe(lambda rng, s, track: {"front_max": 0.36 * s**-0.2}, _field("front_max", "front_max")),
    "speed_loop_lag": Recipe(_sized("time_constant", 0.25), _way("time_constant", "time_constant")),
    "command_delay": Recipe(_sized("delay", 0.15), _way("delay", "delay")),
    "deadband": Recipe(_sized("threshold", 45.0), _way("deadband", "threshold")),
    "motor_drag": Recipe(_chosen("torque", 0.25, "motor", MOTORS), _drag),
    "gear_efficiency": Recipe(_factor("scale", 0.77), _gears),
    "wheel_radius_mismatch": Recipe(_signed("relative", 0.02), _radii),
    "slope": Recipe(_towards("grade", 0.05), _slope),
    "external_force": Recipe(_towards("force", 35.0), _push),
    "friction_patch": Recipe(_draw_patch, _patch),
    "soil_softening": Recipe(_sized("rate", 0.008), _field("softening", "rate")),
    "back_friction": Recipe(_factor("scale", 0.6), _field("back_scale", "scale")),
    "stribeck": Recipe(_sized("velocity", 0.08), _field("stribeck", "velocity")),
    "bulldozing": Recipe(_sized("coefficient", 900.0), _field("bulldozing", "coefficient")),
    "tyre_relaxation": Recipe(_sized("length", 0.3), _field("relaxation", "length")),
    "rolling_resistance_speed": Recipe(_sized("coefficient", 1.5), _field("rolling_speed", "coefficient")),
    "com_offset": Recipe(_draw_two(0.06, 0.04), _centre),
    "payload": Recipe(_chosen("mass", 15.0, "module", ("front", "back")), _payload),
    "joint_friction": Recipe(_sized("torque", 10.0), _field("joint_friction", "torque")),
    "joint_damping": Recipe(_sized("coefficient", 30.0), _field("joint_damping", "coefficient")),
    "joint_stiffness": Recipe(_sized("stiffness", 25.0), _field("joint_stiffness", "stiffness")),
    "joint_stop": Recipe(lambda rng, s, track: {"angle": 0.35 * s**-0.4}, _field("joint_stop", "angle")),
    "encoder_scale": Recipe(_signed("scale", 0.02, 1.0), _sensor(encoder_scale="scale")),
    "torque_scale": Recipe(_signed("scale", 0.15, 1.0), _sensor(torque_scale="scale")),
    "pose_lever_arm": Recipe(_draw_two(0.12, 0.08), _sensor(lever_x="x", lever_y="y")),
    "pose_delay": Recipe(_sized("delay", 0.12), _sensor(pose_delay="delay")),
    "gyro_bias": Recipe(_signed("bias", 0.01), _sensor(gyro_bias="bias")),
}
"""By the contract's id."""

WHEELS = tuple(f"{motor}_{end}" for motor in MOTORS for end in ("front", "back"))


def _draw_runout(rng: Rng, s: float, track: np.ndarray) -> Values:
    return {"relative": 0.03 * s, "phase": _heading(rng), "wheel": str(rng.choice(WHEELS))}


def _runout(machine: Machine, values: Values) -> Machine:
    wheel = float(WHEELS.index(values["wheel"]))
    return machine.hiding(runout=values["relative"], runout_wheel=wheel, runout_phase=values["phase"])


def _sag(machine: Machine, values: Values) -> Machine:
    return machine.hiding(stall=values["stall"], no_load=values["no_load_speed"])


def _draw_sag(rng: Rng, s: float, track: np.ndarray) -> Values:
    return {"stall": 0.6 * s**-0.2, "no_load_speed": 250.0 * s**-0.2}


ADDED: dict[str, Recipe] = {
    "battery_sag": Recipe(_draw_sag, _sag),
    "command_rate_limit": Recipe(lambda rng, s, track: {"rate": 150.0 * s**-0.4}, _way("ramp", "rate")),
    "velocity_filter": Recipe(_sized("time_constant", 0.1), _sensor(smoothed="time_constant")),
    "wheel_radius": Recipe(_signed("scale", 0.02, 1.0), _worn),
    "wheel_runout": Recipe(_draw_runout, _runout),
}
"""Effects that came to the contract's 27 later; they take nothing from the cases that are drawn of those."""
