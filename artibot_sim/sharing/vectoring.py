"""Torque from the inner to the outer back motor in a turn."""

from __future__ import annotations

from artibot_sim.model import Robot
from artibot_sim.sharing.base import Cycle, Law, Pair, eq30


def share(robot: Robot, cycle: Cycle, gain: float = 1.0) -> Pair:
    """Eq. 30 on average; the outer motor gets more, by `gain` times the bend of the path times the front's torque."""
    each = eq30(robot, cycle.kappa, cycle.front_torque)
    shift = gain * cycle.bend * 0.5 * (abs(cycle.front_torque[0]) + abs(cycle.front_torque[1]))
    return each + shift, each - shift


LAW = Law("vectoring", "Eq. 30 on average, with torque moved from the inner to the outer back motor.", share)
