"""A trajectory driven under a torque-sharing law, cycle by cycle as a driver does: figures and one sheet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.metrics import position_error, yaw_error
from artibot_sim.model import Mode, Robot, Status, initial_state
from artibot_sim.model.kernels.layout import GAMMA, MOTOR_COORDINATES
from artibot_sim.model.simulate.rollout import integration
from artibot_sim.model.simulate.stepper import MotorCommand, Stepper
from artibot_sim.planning import Plan, PlanSample
from artibot_sim.report import style
from artibot_sim.report.panels import Line, Panel
from artibot_sim.reproduce.result import PLANNED, TIME, Sheet, curve, panel
from artibot_sim.sharing import Cycle, Law

# ----------------------------------------------------------------------
# A trajectory driven under a torque-sharing law, cycle by cycle as a driver does, and its figures of merit.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

CYCLE = 0.01
"""Period in which a law decides, s: the driver's."""
STEP = 1e-3
_PEAK = 0.1
"""s."""
_MOTORS = list(MOTOR_COORDINATES)


@dataclass(frozen=True, eq=False)
class TrajectoryRun:
    """What a law made of a trajectory: rows every `CYCLE`.

    Attributes
    ----------
    law : Law
    plan : Plan
    planned : PlanSample
        The plan at `t`.
    t : array, shape (n,), s
    pose : array, shape (n, 3)
        x, y (m) and yaw (rad) of the front module.
    velocity, torque : array, shape (n, 4)
        Motor-side, rad/s and N m, in the order of MOTORS.
    """

    law: Law
    plan: Plan
    planned: PlanSample
    t: Array
    pose: Array
    velocity: Array
    torque: Array

    @property
    def e_gamma(self) -> float:
        """Eq. 31, a fraction."""
        return yaw_error(self.pose[:, 2], self.planned.pose[:, 2], self.t)

    @property
    def e_x(self) -> float:
        """Eq. 32, a fraction."""
        return position_error(self.pose[-1, :2], self.planned.pose[-1, :2], self.plan.path_length)

    @property
    def peak_front(self) -> float:
        """Largest torque of a front motor, N m (see `_peak`)."""
        return _peak(self.torque[:, :2])

    @property
    def rms_front(self) -> float:
        """Root mean square of both front motors' torques, N m."""
        return float(np.sqrt(np.mean(self.torque[:, :2] ** 2)))

    @property
    def peak_back(self) -> float:
        """Largest torque of a back motor, N m (see `_peak`)."""
        return _peak(self.torque[:, 2:])

    @property
    def energy(self) -> float:
        """What the motors put in mechanically, J; what they get back while they brake is lost."""
        power = np.maximum(self.torque * self.velocity, 0.0).sum(axis=1)
        return float(np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(self.t)))


def _peak(torque: Array) -> float:
    """Largest mean of a motor's torque over `_PEAK`: where its curvature jumps a plan asks for any torque at once."""
    size = min(round(_PEAK / CYCLE), len(torque))
    means = [np.convolve(np.abs(column), np.ones(size) / size, "valid") for column in torque.T]
    return float(np.max(means))


def actuate(
    robot: Robot, plan: Plan, law: Law, *, limited: bool = False, progress: Callable[[float], None] | None = None
) -> TrajectoryRun:
    """Drive a plan under a law.

    The front motors' velocity loops follow the plan and the back motors get the law's torques, both set once a
    `CYCLE` from what the drives measured at its beginning, as the driver does it.

    Parameters
    ----------
    robot : Robot
        Articulated.
    plan : Plan
    law : Law
    limited : bool
        Whether the front motors are held to their torque_max; if not they follow the plan whatever it takes, as in
        section 7.
    progress : callable, optional
        Called with the share that is done.

    Raises
    ------
    ArtibotError
        For a rigid robot, a law that gives no torques, or a rollout that diverges.
    """
    if robot.drive.back is None:
        raise ArtibotError(f"robot '{robot.name}' has no back module: there is no torque to share")
    rover = robot if limited else _without_front_limit(robot)
    integrator, step = integration(rover, STEP, (Mode.TORQUE,) * 4)
    stepper = Stepper(rover, dt=step, integrator=integrator, state=initial_state(rover, *plan.start))
    count = max(1, math.ceil(plan.duration / CYCLE - 1e-9))
    t: Array = CYCLE * np.arange(count + 1, dtype=float)
    speed = plan.at(t).velocity
    rows, back = [_row(stepper)], (0.0, 0.0)
    for k in range(count):
        right, left = speed[k].tolist()
        measured = (float(stepper.torque[0]), float(stepper.torque[1]))
        back = _checked(law, law.torques(robot, Cycle((right, left), measured, back, robot.control.kappa)))
        front = [MotorCommand((float(a), float(b))) for a, b in speed[k : k + 2].T]
        turns = (front[0], front[1], MotorCommand(torque=back[0]), MotorCommand(torque=back[1]))
        if stepper.advance(round(CYCLE / step), turns) is not Status.OK:
            raise ArtibotError(f"law {law}: the simulation {stepper.message}; it may feed back too strongly")
        rows.append(_row(stepper))
        if progress is not None and k % 100 == 0:
            progress(k / count)
    pose, velocity, torque = (np.array(part) for part in zip(*rows, strict=True))
    return TrajectoryRun(law, plan, plan.at(t), t, pose, velocity, torque)


def _without_front_limit(robot: Robot) -> Robot:
    return robot.replace({"drive.front.torque_max": math.inf})


def _row(stepper: Stepper) -> tuple[Array, Array, Array]:
    return stepper.q[[0, 1, GAMMA]].copy(), stepper.v[_MOTORS].copy(), stepper.torque.copy()


def _checked(law: Law, torques: tuple[float, float]) -> tuple[float, float]:
    right, left = torques
    if not math.isfinite(right + left):
        raise ArtibotError(f"law {law}: gives torques {right:g} and {left:g} N·m; expected finite numbers")
    return float(right), float(left)


# ----------------------------------------------------------------------
# The laws' paths, yaw errors and torques as one sheet.
# ----------------------------------------------------------------------


def sheet(found: Sequence[TrajectoryRun], robot: str, manoeuvre: str) -> Sheet:
    """Paths and yaw errors above, front and back torques below."""
    colours = style.BAGS
    widths = np.linspace(3.6, 1.2, len(found)).tolist()  # laws that drive alike lie on each other
    strokes = [style.Stroke(colours[i % len(colours)], width) for i, width in enumerate(widths)]

    def curves(x: Callable[[TrajectoryRun], Array], y: Callable[[TrajectoryRun], Array]) -> list[Line]:
        return [curve(str(a.law), x(a), y(a), stroke) for a, stroke in zip(found, strokes, strict=True)]

    planned = found[0].planned
    path = panel(
        "path", "path of the front module", ("x", "m"), ("y", "m"),
        [curve("planned", planned.pose[:, 0], planned.pose[:, 1], PLANNED),
         *curves(lambda a: a.pose[:, 0], lambda a: a.pose[:, 1])],
    )  # fmt: skip
    rows: tuple[tuple[Panel, ...], ...] = (
        (
            path,
            panel("yaw", "yaw error", TIME, ("yaw − planned", "°"),
                  curves(_time, lambda a: np.degrees(a.pose[:, 2] - a.planned.pose[:, 2]))),
        ),
        (
            panel("front", "larger front motor torque", TIME, ("torque", "N·m"),
                  curves(_time, lambda a: np.abs(a.torque[:, :2]).max(axis=1))),
            panel("back", "back right motor torque", TIME, ("torque", "N·m"),
                  curves(_time, lambda a: a.torque[:, 2])),
        ),
    )  # fmt: skip
    caption = (
        f"{found[0].plan.path_length:.1f} m in {found[0].plan.duration:.1f} s. Each law sets the back motors' torques "
        "every 10 ms from the front motors' torques and the commanded speeds; the front motors follow the plan."
    )
    return Sheet("actuation", f"Torque-sharing laws: {robot} on {manoeuvre}", caption, rows)


def _time(a: TrajectoryRun) -> Array:
    return a.t
