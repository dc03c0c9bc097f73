"""Simulations with their figures of merit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.metrics import position_error, yaw_error
from artibot_sim.model import WHEELS, Robot, Rollout, Status, rollout
from artibot_sim.planning import Manoeuvre, Plan, Sample, plan

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Run:
    """A manoeuvre that a robot drove with prescribed front motors.

    Attributes
    ----------
    robot : Robot
    kappa : float
    plan : Plan
    planned : Sample
        The plan at the result's times.
    result : Rollout
    """

    robot: Robot
    kappa: float
    plan: Plan
    planned: Sample
    result: Rollout

    @property
    def e_gamma(self) -> float:
        """Eq. 31, a fraction; negative where the rover turned less than planned."""
        return yaw_error(self.result.pose[:, 2], self.planned.pose[:, 2], self.result.t)

    @property
    def e_x(self) -> float:
        """Eq. 32, a fraction."""
        return position_error(self.result.pose[-1, :2], self.planned.pose[-1, :2], self.plan.path_length)

    def during(self, first: int, last: int) -> NDArray[np.bool_]:
        """Rows (n,) from the start of a segment of the plan to the end of another."""
        t = self.result.t
        return (t >= self.plan.marks[first].start) & (t <= self.plan.marks[last].end)


def drive(robot: Robot, manoeuvre: Manoeuvre, kappa: float) -> Run:
    """Simulate as section 7 does: the front motors follow the plan without a limit, eq. 30 moves the back ones.

    Raises
    ------
    ArtibotError
        If the simulation diverges.
    """
    planned = plan(manoeuvre, robot)
    result = checked(rollout(robot, planned.commands(), kappa=kappa), f"{robot.name}, κ = {kappa:g}")
    return Run(robot, kappa, planned, planned.at(result.t), result)


def checked(result: Rollout, what: str) -> Rollout:
    """The rollout, if it reached its end."""
    if result.status is not Status.OK:
        raise ArtibotError(f"reproduce: {what}: {result.message}")
    return result


def sliding(result: Rollout, module: str) -> Array:
    """How many of a module's four wheels slide (eq. 16), (n,)."""
    columns = [result[f"sat_{wheel}"] for wheel in WHEELS if wheel.startswith(module)]
    return np.sum(columns, axis=0)


@dataclass(frozen=True)
class YawParts:
    """Eq. 31 of a run on Table 6's trajectory, split in what steady turning and what the changes between turns add.

    Attributes
    ----------
    left, right : float
        Steady yaw rate in the turn over the planned one, less 1.
    steady, entries : float
        Their parts of e_gamma; the sum is e_gamma.
    """

    left: float
    right: float
    steady: float
    entries: float


def yaw_parts(run: Run) -> YawParts:
    """Split a run's e_gamma.

    The steady yaw rate is that of each turn's last third. What it adds to the yaw error is integrated over the
    run; all else comes from the joint swinging from one side to the other where the curvature jumps.
    """
    t, error = run.result.t, run.result.pose[:, 2] - run.planned.pose[:, 2]
    steady, rates = np.zeros(len(t)), []
    for mark, direction in zip(run.plan.marks[2:4], (1.0, -1.0), strict=True):
        late = (t >= mark.end - (mark.end - mark.start) / 3) & (t <= mark.end)
        slope = float(np.polyfit(t[late], error[late], 1)[0])
        steady += slope * np.clip(t - mark.start, 0.0, mark.end - mark.start)
        turn = run.plan.at(0.5 * (mark.start + mark.end)).twist[0, 1]
        rates.append(slope / (direction * abs(turn)))
    part = yaw_error(run.planned.pose[:, 2] + steady, run.planned.pose[:, 2], t)
    return YawParts(rates[0], rates[1], part, run.e_gamma - part)
