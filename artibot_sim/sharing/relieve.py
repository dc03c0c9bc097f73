"""As much help from the back module as keeps the front motors within their torque."""

from __future__ import annotations

from artibot_sim.model import Robot
from artibot_sim.sharing.base import Cycle, Law, Pair, eq30


def share(robot: Robot, cycle: Cycle, limit: float = 0.9, least: float = 0.622, gain: float = 0.2) -> Pair:
    """Eq. 30 with the largest kappa at which no front motor needs more than `limit` times its rated torque.

    The traction that the manoeuvre needs (eq. 29) hardly changes from cycle to cycle, so what a front motor has too
    much, both of them have to hand over. `gain` is the part of it that is handed over in a cycle.
    """
    right, left = cycle.front_torque
    front = right + left
    back = sum(cycle.back_torque)
    ratio = robot.drive.front.tau / robot.drive.back.tau if robot.drive.back else 0.0
    now = front / (front + ratio * back) if front * (front + ratio * back) > 0.0 else 1.0
    allowed = limit * robot.drive.front.rated_torque
    excess = max(abs(right), abs(left)) - allowed
    kappa = now * (1.0 - gain * 2.0 * excess / max(abs(front), allowed))
    each = eq30(robot, min(1.0, max(least, kappa)), cycle.front_torque)
    return each, each


LAW = Law(
    "relieve", "Eq. 30 with the largest kappa that keeps the front motors under a share of their rated torque.", share
)
