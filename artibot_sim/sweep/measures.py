"""What is kept of a run: eqs 31 and 32, radii, slip, torques, energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.metrics import fit_circle, path_length, position_error, yaw_error
from artibot_sim.model import Rollout, Status
from artibot_sim.model.kernels.layout import (
    E_GEAR,
    E_MOTOR,
    E_NORMAL,
    E_OFFSET,
    E_ROLLING,
    E_SLIP_L,
    E_SLIP_T,
    M_M,
    SAT,
)
from artibot_sim.planning import Plan, PlanSample

Array = NDArray[np.float64]

RADII = 6
"""Arcs whose radius has a column."""

MEASURES: dict[str, tuple[str, str]] = {
    "e_gamma": ("", "relative yaw error (eq. 31)"),
    "e_x": ("", "relative error of the final position (eq. 32)"),
    "radius_ratio": ("", "driven over planned radius, mean of the arcs"),
    **{f"radius_{i}": ("m", f"radius of what was driven on arc {i}") for i in range(1, RADII + 1)},
    "path_length": ("m", "length of what was driven"),
    "planned_length": ("m", "length of the planned path"),
    "duration": ("s", "length of the run"),
    "x_end": ("m", "final position"),
    "y_end": ("m", "final position"),
    "yaw_end": ("rad", "final yaw"),
    "articulation_max": ("rad", "largest articulation yaw"),
    "sliding_front": ("", "share of wheels and time that slide (eq. 16)"),
    "sliding_back": ("", "share of wheels and time that slide (eq. 16)"),
    "torque_front_max": ("N m", "largest torque of a motor at a row"),
    "torque_back_max": ("N m", "largest torque of a motor at a row"),
    "energy_front": ("J", "work of the front motors"),
    "energy_back": ("J", "work of the back motors"),
    "energy_per_metre": ("J/m", "work of all motors over the length driven"),
    "loss_slip": ("J", "lost between wheels and ground"),
    "loss_rolling": ("J", "lost in rolling"),
    "loss_gear": ("J", "lost in the gears"),
}
"""Name → unit and meaning of every measure; NaN where a run has none."""


class PlannedArc(NamedTuple):
    """Start and end (s) and radius (m) of an arc of a plan."""

    start: float
    end: float
    radius: float


def measure(result: Rollout, plan: Plan, planned: PlanSample, curves: Sequence[PlannedArc]) -> dict[str, float]:
    """All measures of a run that reached its end; those it has not are absent.

    Parameters
    ----------
    result : Rollout
    plan : Plan
        Of the manoeuvre.
    planned : PlanSample
        The plan at the result's times.
    curves : sequence of PlannedArc
        The plan's arcs.
    """
    pose, t = result.pose, result.t
    found = {"planned_length": plan.path_length, "duration": float(t[-1] - t[0])}
    found["path_length"] = path_length(pose[:, 0], pose[:, 1])
    found |= dict(zip(("x_end", "y_end", "yaw_end"), pose[-1].tolist(), strict=True))
    _try(found, "e_gamma", lambda: yaw_error(pose[:, 2], planned.pose[:, 2], t))
    _try(found, "e_x", lambda: position_error(pose[-1, :2], planned.pose[-1, :2], plan.path_length))
    found |= _radii(pose, t, curves)
    sat, torque = result.row[:, SAT : SAT + 8], np.abs(result.row[:, M_M : M_M + 4])
    found |= {"sliding_front": float(sat[:, :4].mean()), "torque_front_max": float(torque[:, :2].max())}
    if result.robot.articulated:
        found |= {"sliding_back": float(sat[:, 4:].mean()), "torque_back_max": float(torque[:, 2:].max())}
        found["articulation_max"] = float(np.abs(result.articulation_yaw).max())
    if result.energy is not None:
        found |= _energies(result.energy[-1], found["path_length"], result.robot.articulated)
    return found


def _energies(total: Array, length: float, articulated: bool) -> dict[str, float]:
    front, back = float(total[E_MOTOR : E_MOTOR + 2].sum()), float(total[E_MOTOR + 2 : E_GEAR].sum())
    found = {"energy_front": front} | ({"energy_back": back} if articulated else {})
    if length > 0:
        found["energy_per_metre"] = (front + back) / length
    slip = total[E_SLIP_L:E_SLIP_T].sum() + total[E_SLIP_T:E_OFFSET].sum() + total[E_OFFSET:E_ROLLING].sum()
    found["loss_slip"] = float(slip)
    found["loss_rolling"] = float(total[E_ROLLING:E_NORMAL].sum())
    found["loss_gear"] = float(total[E_GEAR:E_SLIP_L].sum())
    return found


def _radii(pose: Array, t: Array, curves: Sequence[PlannedArc]) -> dict[str, float]:
    """Radii of circles through what was driven while arcs were planned."""
    found: dict[str, float] = {}
    ratios = []
    for i, (start, end, radius) in enumerate(curves, 1):
        rows = (t >= start) & (t <= end)
        try:
            driven = fit_circle(pose[rows, 0], pose[rows, 1]).radius
        except ArtibotError:
            continue
        ratios.append(driven / radius)
        if i <= RADII:
            found[f"radius_{i}"] = driven
    if ratios:
        found["radius_ratio"] = math.fsum(ratios) / len(ratios)
    return found


def arcs(plan: Plan) -> list[PlannedArc]:
    """The arcs of a plan, in order."""
    found = []
    for mark in plan.marks:
        if mark.label.endswith(".arc"):
            ends = plan.at(np.array([mark.start, mark.end]))
            turn = abs(float(np.diff(ends.pose[:, 2])[0]))
            found.append(PlannedArc(mark.start, mark.end, float(np.diff(ends.travelled)[0]) / turn))
    return found


def _try(found: dict[str, float], name: str, compute: Callable[[], float]) -> None:
    """Add a measure, unless this manoeuvre has none."""
    try:
        found[name] = compute()
    except ArtibotError:
        return


def status_of(result: Rollout) -> str:
    """In a word: ok, diverged, tipped, airborne or invalid."""
    return Status(result.status).name.lower()


def names(radii: int, articulated: bool, energy: bool) -> Sequence[str]:
    """Measures that runs of this kind have, in the table's order."""
    without = {f"radius_{i}" for i in range(radii + 1, RADII + 1)} | ({"radius_ratio"} if not radii else set())
    if not articulated:
        without |= {"articulation_max", "sliding_back", "torque_back_max", "energy_back"}
    if not energy:
        without |= {name for name in MEASURES if name.startswith(("energy", "loss"))}
    return [name for name in MEASURES if name not in without]
