"""Eq. 30 as printed."""

from __future__ import annotations

import math

from artibot_sim.model import Robot
from artibot_sim.sharing.base import Cycle, Law, Pair, eq30


def share(robot: Robot, cycle: Cycle, kappa: float = math.nan) -> Pair:
    """Both back motors alike; NaN is the kappa that the driver or the robot file has."""
    each = eq30(robot, cycle.kappa if math.isnan(kappa) else kappa, cycle.front_torque)
    return each, each


LAW = Law("constant", "Eq. 30 with a constant kappa, the paper's.", share, kappas=("kappa",))
