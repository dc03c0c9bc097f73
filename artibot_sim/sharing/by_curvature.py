"""More help from the back module the tighter the turn."""

from __future__ import annotations

from artibot_sim.model import Robot
from artibot_sim.sharing.base import Cycle, Law, Pair, eq30


def share(robot: Robot, cycle: Cycle, straight: float = 1.0, turn: float = 0.65, radius: float = 2.0) -> Pair:
    """Eq. 30 with kappa falling from `straight` to `turn` while the planned radius falls to `radius` (m)."""
    bend = min(1.0, abs(cycle.bend) * radius / (0.5 * robot.front.i_y))
    each = eq30(robot, straight + (turn - straight) * bend, cycle.front_torque)
    return each, each


LAW = Law(
    "by_curvature", "Eq. 30 with a kappa that falls with the curvature of the commanded path.", share,
    kappas=("straight", "turn"),
)  # fmt: skip
