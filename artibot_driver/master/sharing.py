"""Eq. 30 in the drives' own counts, and the bounds that the motors' limits set to kappa."""

from __future__ import annotations

import math

from artibot_driver.rig import Rig
from artibot_driver.scaling import Scaled, largest_torque
from artibot_sim.errors import ArtibotError
from artibot_sim.model import Robot
from artibot_sim.model.equations.transmission import back_torque_factor


def kappa_bounds(robot: Robot) -> tuple[float, float]:
    """Smallest and largest kappa with which no back motor needs more torque than it has.

    With both front motors at their limit M_f, eq. 30 asks each back motor for M_f (tau_b/tau_f) (1/kappa − 1); that
    this is at most M_b gives ``kappa >= 1/(1 + M_b tau_f/(M_f tau_b))``: 0.622 for Agri.q's four equal motors (section
    6). It is rounded down to thousandths, as the paper states it: a permille of torque is one count. Where the robot
    file limits neither or only one pair of motors the smallest is 0, which kappa has to exceed.
    """
    front, back = robot.drive.front, robot.drive.back
    if back is None or math.isinf(largest_torque(front)) or math.isinf(largest_torque(back)):
        return 0.0, 1.0
    share = largest_torque(back) * front.tau / (largest_torque(front) * back.tau)
    return math.floor(1e3 / (1.0 + share) + 1e-9) / 1e3, 1.0


def check_kappa(robot: Robot, kappa: float) -> float:
    """`kappa`, if it is one that the motors allow.

    Raises
    ------
    ArtibotError
        With the bounds and where they come from.
    """
    low, high = kappa_bounds(robot)
    if not (low <= kappa <= high and kappa > 0.0):  # NaN is not either
        raise ArtibotError(
            f"kappa: found {kappa:g}, expected {low:g} to {high:g} for robot '{robot.name}': with less the back motors "
            "would need more than their torque_max when the front motors are at theirs"
        )
    return kappa


def back_torque(rig: Rig, motor: str, kappa: float, front: tuple[int, int]) -> Scaled:
    """The target torque (6071h) of a back motor's drive by eq. 30, exact to rounding.

    Parameters
    ----------
    front : (int, int)
        Torque actual values (6077h) of the front right and left drive, in their counts.
    """
    right, left = rig.scaling["front_right"].torque, rig.scaling["front_left"].torque
    total = right.si(front[0]) + left.si(front[1])
    return rig.scaling[motor].torque.raw(back_torque_factor(rig.robot, kappa) * total)
