"""Manoeuvres of the paper's sections 6 and 7 and others, as data, and plans of them for a robot.

>>> from artibot_sim.model import load_robot
>>> from artibot_sim.planning import load_manoeuvre, plan
>>> p = plan(load_manoeuvre("table6_agriq"), load_robot("agriq"))
>>> p.duration, p.path_length, p.at(12.0).pose
"""

from __future__ import annotations

from typing import Any

from artibot_sim.planning.files import load_manoeuvre, manoeuvre_from_dict, manoeuvre_names, manoeuvre_to_dict
from artibot_sim.planning.manoeuvre import (
    Arc,
    Dwell,
    Eight,
    Manoeuvre,
    Ramp,
    Repeat,
    Segment,
    Slalom,
    SpeedChirp,
    Spiral,
    Stop,
    Straight,
    TurnInPlace,
    YawRateChirp,
)
from artibot_sim.planning.plan import FrontKinematics, Plan, PlanSample, plan
from artibot_sim.planning.route import Mark, PlannedMotion

__all__ = [
    "MANOEUVRES",
    "Arc",
    "Dwell",
    "Eight",
    "FrontKinematics",
    "Manoeuvre",
    "Mark",
    "Plan",
    "PlanSample",
    "PlannedMotion",
    "Ramp",
    "Repeat",
    "Segment",
    "Slalom",
    "SpeedChirp",
    "Spiral",
    "Stop",
    "Straight",
    "TurnInPlace",
    "YawRateChirp",
    "load_manoeuvre",
    "manoeuvre_from_dict",
    "manoeuvre_names",
    "manoeuvre_to_dict",
    "plan",
]


def __getattr__(name: str) -> Any:
    if name == "MANOEUVRES":  # found when asked for: importing must not depend on where the files are
        return manoeuvre_names()
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
