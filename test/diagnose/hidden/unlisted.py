"""Things that are on no list: a diagnosis must not force them into the nearest known name."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin
from typing import Any

import numpy as np
from diagnose.hidden.effects import MOTORS, Recipe, Rng, Values
from diagnose.hidden.ground import OTHER_GROUND
from diagnose.hidden.machine import Machine
from diagnose.hidden.parts import Hidden


def _hide(machine: Machine, values: Values) -> Machine:
    """All numbers that `Hidden` knows; what else is there is for the reader."""
    return machine.hiding(**{name: value for name, value in values.items() if name in Hidden._fields})


def _yaw_drag(rng: Rng, s: float, track: np.ndarray) -> Values:
    return {"yaw_drag": 60.0 * s}


def _wandering_moment(rng: Rng, s: float, track: np.ndarray) -> Values:
    """Two slow waves of time, the same in every run."""
    slow, fast = 2 * pi / rng.uniform(20.0, 35.0), 2 * pi / rng.uniform(7.0, 14.0)
    return {"wander": (14.0 * s, float(slow), _phase(rng), 9.0 * s, float(fast), _phase(rng))}


def _phase(rng: Rng) -> float:
    return float(rng.uniform(-pi, pi))


def _ridges(rng: Rng, s: float, track: np.ndarray) -> Values:
    """Ploughed ground: each wheel is pushed sideways, periodically in its own place."""
    period, across = float(rng.uniform(0.6, 1.6)), _phase(rng)
    wave = 2 * pi / period
    return {
        "ridge": 30.0 * s, "ridge_x": wave * cos(across), "ridge_y": wave * sin(across), "ridge_phase": _phase(rng),
        "period": period,
    }  # fmt: skip


def _lame_wheel(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A wheel out of round: its longitudinal force goes up and down once a turn."""
    return {"lame_wheel": float(rng.integers(8)), "lame": 40.0 * s, "lame_phase": _phase(rng)}


def _tether(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A spring that pulls the front module towards a point of the map."""
    x, y = track.mean(axis=0)
    return {"tether": 10.0 * s, "tether_x": float(x), "tether_y": float(y)}


def _joint_preload(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A hose that bends the articulation to one side, whatever its angle."""
    return {"preload": float(rng.choice((-1.0, 1.0))) * 12.0 * s}


def _cold_gear(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A motor that drags until it is warm."""
    motor = int(rng.integers(4))
    return {"drag_motor": float(motor), "drag": 0.3 * s, "drag_fades": 12.0, "motor": MOTORS[motor]}


def _air_drag(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A force against the front module's motion that grows with the square of its speed."""
    return {"air": 90.0 * s}


def _command_ceiling(rng: Rng, s: float, track: np.ndarray) -> Values:
    """Drives that turn no faster than so much, whatever they are commanded."""
    return {"fastest": 110.0 / s**0.3}


def _ceiling(machine: Machine, values: Values) -> Machine:
    return replace(machine, way=replace(machine.way, fastest=values["fastest"]))


UNLISTED: dict[str, Recipe] = {
    "yaw_drag": Recipe(_yaw_drag, _hide),
    "wandering_moment": Recipe(_wandering_moment, _hide),
    "ridges": Recipe(_ridges, _hide),
    "wheel_out_of_round": Recipe(_lame_wheel, _hide),
    "tether": Recipe(_tether, _hide),
    "joint_preload": Recipe(_joint_preload, _hide),
    "cold_gear": Recipe(_cold_gear, _hide),
    "air_drag": Recipe(_air_drag, _hide),
}
"""By names of the tests' own."""


def _speed_yaw_drag(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A moment against turning that grows with the speed: a product of two variables."""
    return {"gyre": 120.0 * s}


def _creep_drag(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A drag that begins at a speed."""
    return {"creep": 160.0 * s, "creep_from": float(rng.uniform(0.25, 0.35))}


def _joint_hysteresis(rng: Rng, s: float, track: np.ndarray) -> Values:
    """Friction in the joint that grows with its angle: bending back and forth takes another way each."""
    return {"hysteresis": 45.0 * s}


def _elastic_friction(rng: Rng, s: float, track: np.ndarray) -> Values:
    """Friction in the joint that gives before it slides: its torque depends on how the joint came to its angle."""
    return {"bristle": 20.0 * s, "bristle_angle": float(rng.uniform(0.2, 0.35))}


def _relaxing_hose(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A hose across the joint that resists bending and gives within seconds: it remembers what was a while ago."""
    return {"hose": 40.0 * s, "hose_time": float(rng.uniform(1.5, 4.0))}


def _fresh_grease(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A motor that drags until it has turned so far: what it remembers is its angle, not the time."""
    motor = int(rng.integers(4))
    turns = float(rng.uniform(300.0, 600.0))
    return {"grease": 0.3 * s, "grease_motor": float(motor), "grease_turns": turns, "motor": MOTORS[motor]}


def _skidding_wheel(rng: Rng, s: float, track: np.ndarray) -> Values:
    """One wheel that resists sliding sideways more than the others do."""
    return {"skid": 900.0 * s, "skid_wheel": float(rng.integers(8))}


def _growing_drag(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A drag that grows with the time of day."""
    return {"growing": 1.2 * s}


def _soft_half(rng: Rng, s: float, track: np.ndarray) -> Values:
    """A drag on one side of a line in the map."""
    return {"bog": 30.0 * s, "bog_x": float(np.median(track[:, 0]))}


LAWS: dict[str, Recipe] = {
    "speed_yaw_drag": Recipe(_speed_yaw_drag, _hide),
    "creep_drag": Recipe(_creep_drag, _hide),
    "joint_hysteresis": Recipe(_joint_hysteresis, _hide),
    "elastic_friction": Recipe(_elastic_friction, _hide),
    "relaxing_hose": Recipe(_relaxing_hose, _hide),
    "fresh_grease": Recipe(_fresh_grease, _hide),
    "skidding_wheel": Recipe(_skidding_wheel, _hide),
    "growing_drag": Recipe(_growing_drag, _hide),
    "soft_half": Recipe(_soft_half, _hide),
}
"""More of them: products, thresholds, hysteresis, memory, a single wheel, time and place. Nothing was tuned on them."""

ON_COMMANDS: dict[str, Recipe] = {"command_ceiling": Recipe(_command_ceiling, _ceiling)}
"""What happens to commands, and is on no list."""

ACTS_ON: dict[str, dict[str, Any]] = {
    "yaw_drag": {"force": "yaw moment", "variable": "yaw rate"},
    "wandering_moment": {"force": "yaw moment", "variable": "time"},
    "ridges": {"force": "lateral", "variable": "place"},
    "wheel_out_of_round": {"force": "longitudinal", "variable": "wheel angle"},
    "tether": {"force": "front", "variable": "place"},
    "joint_preload": {"force": "yaw moment", "variable": ""},
    "cold_gear": {"force": "torque", "variable": "time"},
    "air_drag": {"force": "surge", "variable": "speed"},
    "speed_yaw_drag": {"force": "yaw moment", "variable": "yaw rate"},
    "creep_drag": {"force": "surge", "variable": "speed"},
    "joint_hysteresis": {"force": "yaw moment", "variable": "articulation"},
    "elastic_friction": {"force": "yaw moment", "variable": "articulation"},
    "relaxing_hose": {"force": "yaw moment", "variable": "articulation"},
    "fresh_grease": {"force": "torque"},
    "skidding_wheel": {"force": "lateral", "variable": "lateral speed"},
    "growing_drag": {"force": "surge", "variable": "time"},
    "soft_half": {"variable": "place"},
    "command_ceiling": {"force": "front motors' speed", "variable": "command"},
    OTHER_GROUND: {"variable": "recording"},
}
"""Words that a good answer holds."""
