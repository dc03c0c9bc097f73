"""Sizes of the effects at which each is plain to see (Agri.q), for the tests."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import pytest

from artibot_sim.model.effects import LAWS

SEVERITY_1 = {
    "torque_limit": {"front_max": 0.36},
    "battery_sag": {"stall": 0.8, "no_load_speed": 250.0, "supply": 0.9},
    "velocity_loop": {"gain": 0.06, "integral": 8.0, "windup": 0.3},
    "motor_drag": {"torque": 0.25, "motor": "back_left"},
    "gear_efficiency": {"scale": 0.77},
    "gear_no_load": {"torque": 0.1},
    "wheel_radius": {"scale": 0.97},
    "wheel_radius_mismatch": {"relative": 0.02},
    "slope": {"grade": 0.05, "heading": 0.7},
    "external_force": {"force": 35.0, "heading": -0.4},
    "friction_patch": {"scale": 0.55, "x": 1.0, "y": -2.0, "radius": 0.5},
    "soil_softening": {"rate": 0.008},
    "back_friction": {"scale": 0.6},
    "stiction": {"length": 0.005},
    "wheel_windup": {"way": 0.02},
    "stribeck": {"velocity": 0.08, "early": 0.6},
    "bulldozing": {"coefficient": 900.0, "load": 2.0},
    "tyre_relaxation": {"length": 0.3},
    "wheel_runout": {"relative": 0.03, "phase": 0.7, "wheel": "front_left_back"},
    "rolling_resistance_speed": {"coefficient": 1.5},
    "com_offset": {"x": 0.06, "y": -0.04},
    "com_height": {"height": 0.35},
    "residual_force": {"back_turn": 10.0, "front_sway": 10.0, "front_sway_rate": -3.0, "since": 1.0, "fall": 0.25},
    "motion_resistance": {"force": 30.0},
    "wheel_resistance": {"share": 0.08},
    "slip_ratio": {"exponent": 0.95},  # all that RK4 takes at 1 ms: the ground is stiff at low speed
    "load_sensitivity": {"exponent": 0.3},
    "friction_anisotropy": {"ratio": 0.7},
    "payload": {"mass": 15.0, "module": "back"},
    "joint_friction": {"torque": 10.0},
    "joint_damping": {"coefficient": 30.0},
    "joint_stiffness": {"stiffness": 25.0},
    "joint_stop": {"angle": 0.2},
    "force_law": {
        "size": 25.0, "where": "wheels_lateral", "variable": "place", "form": "periodic", "scale": 1.1, "phase": 0.4,
        "direction": 0.3,
    },
    "force_law_2": {
        "size": 0.3, "where": "front_left_torque", "variable": "time", "form": "decaying", "scale": 8.0,
        "times": "speed", "times_form": "coulomb", "times_scale": 0.02,
    },
    "force_law_3": {
        "size": -12.0, "where": "front_yaw", "variable": "yaw_rate", "form": "threshold", "scale": 0.1,
    },
}  # fmt: skip
"""Effect → parameters at the contract's severity 1."""

SENSORS_1 = {
    "encoder_scale": {"scale": 1.02},
    "torque_scale": {"scale": 0.85},
    "pose_lever_arm": {"x": 0.12, "y": -0.08},
    "pose_heading_offset": {"angle": 0.03},
    "pose_delay": {"delay": 0.12},
    "gyro_bias": {"bias": -0.01},
    "velocity_filter": {"time_constant": 0.1},
}
"""The same of those that act on measurements."""


LISTED = [name for name in SEVERITY_1 if name not in LAWS]
"""The same without laws."""


def stepped(effects: Sequence[Any], *steps: Any) -> list[Any]:
    """Parameters of tests that try each of `effects` with each of `steps`: the effect, then the step, the method first.

    Of semi-implicit steps laws are long tests: robots with laws have loops of their own, compiled in a minute each, and
    both ways to step ask laws in the lines in which they ask all effects.
    """
    found = []
    for effect in effects:
        for step in steps:
            knows_laws = effect == "all" or not {*LAWS}.isdisjoint([effect] if isinstance(effect, str) else effect)
            marks = [pytest.mark.long] if knows_laws and step[0] == "semi_implicit" else []
            found.append(pytest.param(effect, *step, marks=marks, id="-".join(map(str, (_name(effect), *step)))))
    return found


def _name(effect: Any) -> str:
    return effect if isinstance(effect, str) else next(iter(effect), "paper")


def with_effects(robot, *names, **changes):
    """The robot with some effects at severity 1, or with the parameters given by name."""
    chosen = {name: (SEVERITY_1 | SENSORS_1)[name] for name in names} | changes
    return dataclasses.replace(robot, effects=dict(robot.effects) | chosen)
