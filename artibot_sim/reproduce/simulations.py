"""Simulations of the paper's runs with their figures of merit: trajectories of section 7, circles of section 6."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.metrics import position_error, radius, yaw_error
from artibot_sim.model import WHEELS, Commands, Mode, Robot, Rollout, Status, rollout
from artibot_sim.model.kernels.layout import MOTOR_COORDINATES
from artibot_sim.model.simulate.stepper import MotorCommand, Stepper
from artibot_sim.planning import Arc, FrontKinematics, Manoeuvre, Plan, PlanSample, load_manoeuvre, plan
from artibot_sim.reproduce.paper import ODOMETRIC, PLANNED, TEST_A_MAX, TESTS

# ----------------------------------------------------------------------
# Simulations with their figures of merit.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Run:
    """A manoeuvre that a robot drove with prescribed front motors.

    Attributes
    ----------
    robot : Robot
    kappa : float
    plan : Plan
    planned : PlanSample
        The plan at the result's times.
    result : Rollout
    """

    robot: Robot
    kappa: float
    plan: Plan
    planned: PlanSample
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


# ----------------------------------------------------------------------
# Section 6's tests, simulated: a ramp, a straight and a circle at constant speed.
# ----------------------------------------------------------------------


ENTRY = 0.1
"""Time constant with which the front wheels go over to the speeds of the circle, s: real ones do not jump."""

ANGLE = 3.0 * math.pi
"""Planned arc that is simulated, rad: radii are taken from its second half, where transients are over."""

DRIVEN = (Mode.DRIVEN, Mode.DRIVEN, Mode.TORQUE, Mode.TORQUE)


@dataclass(frozen=True, eq=False)
class CircleRun:
    """A simulated test.

    Attributes
    ----------
    robot : Robot
    test : str
        ``test1`` or ``test2``.
    kappa : float
    plan : Plan
        What was planned, up to the end of the arc.
    planned : PlanSample
        The plan at the result's times.
    result : Rollout
    """

    robot: Robot
    test: str
    kappa: float
    plan: Plan
    planned: PlanSample
    result: Rollout

    @property
    def arc_start(self) -> float:
        """When the circle begins, s."""
        return self.plan.marks[2].start

    @property
    def steady(self) -> NDArray[np.bool_]:
        """Rows (n,) of the second half of the circle."""
        return self.result.t > 0.5 * (self.arc_start + self.plan.duration)

    @property
    def radius(self) -> float:
        """Radius of the front module's path, m."""
        rows = self.steady
        return radius(self.result.pose[rows, 0], self.result.pose[rows, 1])

    @property
    def odometric_radius(self) -> float:
        """Radius that the front wheels' rotations stand for without slip, m."""
        forward, turn = FrontKinematics.of(self.robot).forward(self.result.motor_velocity[self.steady, :2])
        return float(forward.mean() / turn.mean())

    @property
    def torque(self) -> Array:
        """Mean steady motor torques (4,), N m."""
        mean: Array = self.result.motor_torque[self.steady].mean(axis=0)
        return mean

    def steady_share(self, column: str) -> float:
        """Mean of a column of the result over the second half of the circle."""
        return float(self.result[column][self.steady].mean())

    def until(self, angle: float) -> NDArray[np.bool_]:
        """Rows (n,) up to where `angle` (rad) of the circle is planned to be done."""
        span = self.plan.duration - self.arc_start
        return self.result.t <= self.arc_start + span * angle / ANGLE + 1e-9

    def errors(self, angle: float) -> tuple[float, float]:
        """e_gamma and e_x (eqs 31, 32), fractions, of a test that ends after `angle` (rad) of the planned circle."""
        rows = self.until(angle)
        last = int(np.flatnonzero(rows)[-1])
        pose, planned = self.result.pose, self.planned.pose
        e_gamma = yaw_error(pose[rows, 2], planned[rows, 2], self.result.t[rows])
        return e_gamma, position_error(pose[last, :2], planned[last, :2], float(self.planned.arc[last]))


def planned_circle(test: str, robot: Robot) -> Plan:
    """The test's plan up to the end of an arc of `ANGLE`."""
    return plan(_long(test), robot)


@cache
def _long(test: str) -> Manoeuvre:
    """The shipped manoeuvre with an arc of `ANGLE` at its end."""
    shipped = load_manoeuvre(test)
    ramp, straight, arc = shipped.segments[:3]
    assert isinstance(arc, Arc)
    return dataclasses.replace(shipped, segments=(ramp, straight, dataclasses.replace(arc, angle=ANGLE)))


def odometric_speed(test: str) -> float:
    """Mean forward speed on the circle that the wheels' rotations stand for, m/s.

    The paper does not print it, but it prints the odometric radius and e_gamma, and on a circle
    1 + e_gamma = (v_o / R_o) / (v / R): Table 5 and section 6.
    """
    printed = TESTS[test]
    ratio = printed.radius[ODOMETRIC] / printed.radius[PLANNED]
    return printed.speed * (1.0 + printed.e_gamma[ODOMETRIC] / 100.0) * ratio


def rotation_driven(robot: Robot, test: str, kappa: float = 1.0, entry: float = ENTRY) -> CircleRun:
    """Drive as section 6 does: front wheels turn as recorded, that is, at the paper's odometric radius.

    Parameters
    ----------
    robot : Robot
    test : str
        ``test1`` or ``test2``.
    kappa : float
        The paper does not say which; see `section6`.
    entry : float
        Time constant with which the wheels go over to the circle's speeds, s; 0 makes them jump.
    """
    planned = planned_circle(test, robot)
    v = odometric_speed(test)
    goal = FrontKinematics.of(robot).inverse(np.array([v]), np.array([v / TESTS[test].radius[ODOMETRIC]]))[0]
    velocity = np.full((len(planned.t), 4), np.nan)
    velocity[:, :2] = planned.velocity
    since = planned.t - planned.marks[2].start
    on_circle = since >= 0
    before = velocity[np.flatnonzero(~on_circle)[-1], :2]
    share = 1.0 - np.exp(-since[on_circle] / entry) if entry > 0 else np.ones(int(on_circle.sum()))
    velocity[on_circle, :2] = before + share[:, None] * (goal - before)
    return _run(robot, test, kappa, planned, Commands(planned.dt, velocity), None)


def torque_limited(robot: Robot, test: str, limit: float, kappa: float = 1.0) -> CircleRun:
    """Drive as the robot does: front motors follow the plan by a velocity loop, within ±`limit` (N m)."""
    limited = robot.replace({"drive.front.torque_max": limit}, source="assumed: a limit under test")
    planned = planned_circle(test, limited)
    return _run(limited, test, kappa, planned, planned.commands(), DRIVEN)


@dataclass(frozen=True)
class TorqueSpeedLine:
    """A motor's torque-speed line at full supply: its torque at rest (N m), and its speed without load (rad/s)."""

    stall: float
    free: float

    @staticmethod
    def through(first: tuple[float, float], second: tuple[float, float]) -> TorqueSpeedLine:
        """The line through two points of speed (rad/s) and torque (N m); an infinite speed where it does not fall."""
        fall = (first[1] - second[1]) / (second[0] - first[0])
        stall = first[1] + fall * first[0]
        return TorqueSpeedLine(stall, stall / fall if fall > 0 else math.inf)

    def limit(self, speed: float) -> float:
        """Largest torque at a speed (rad/s), N m."""
        return self.stall * min(max(1.0 - abs(speed) / self.free, 0.0), 1.0)


SLICE = 5
"""Steps of 1 ms for which the limit of a torque-speed line is held."""


def line_limited(robot: Robot, test: str, line: TorqueSpeedLine, kappa: float = 1.0) -> tuple[float, float]:
    """Drive as `torque_limited` does, within a torque-speed line: odometric radius and radius of the circle, m."""
    unlimited = {f"drive.{module}.torque_max": 10.0 for module in ("front", "back")}
    robot = robot.replace({"control.kappa": kappa} | unlimited, source="assumed: limited by a line under test")
    planned, rover, h = planned_circle(test, robot), Stepper(robot, dt=1e-3), SLICE * 1e-3
    t = np.arange(0.0, planned.duration, h)
    velocity = planned.at(np.append(t, planned.duration)).velocity
    where, speeds, shared = np.empty((len(t), 2)), np.empty((len(t), 2)), MotorCommand(torque=math.nan)
    for k in range(len(t)):
        right, left = (
            MotorCommand((velocity[k, i], velocity[k + 1, i]), limit=line.limit(rover.v[c]))
            for i, c in enumerate(MOTOR_COORDINATES[:2])
        )
        if rover.advance(SLICE, (right, left, shared, shared)) is not Status.OK:
            raise ArtibotError(f"reproduce: {test}, {robot.name}, κ = {kappa:g}: {rover.message}")
        where[k], speeds[k] = rover.q[:2], rover.v[list(MOTOR_COORDINATES[:2])]
    late = t > 0.5 * (planned.marks[2].start + planned.duration)
    forward, turn = FrontKinematics.of(robot).forward(speeds[late])
    return float(forward.mean() / turn.mean()), radius(where[late, 0], where[late, 1])


def _run(
    robot: Robot, test: str, kappa: float, planned: Plan, commands: Commands, modes: tuple[Mode, ...] | None
) -> CircleRun:
    result = checked(rollout(robot, commands, kappa=kappa, modes=modes), f"{test}, {robot.name}, κ = {kappa:g}")
    return CircleRun(robot, test, kappa, planned, planned.at(result.t), result)


def ideal_circle(test_radius: float, e_gamma: float, angle: Array) -> Array:
    """Where a rover is that drives a test's circle with another constant radius and yaw rate.

    Parameters
    ----------
    test_radius : m.
    e_gamma : fraction by which its yaw rate is off the planned one.
    angle : (n,) array, rad of the planned circle.

    Returns
    -------
    (n, 2) array
        x and y, m, from where the circle begins, which is tangent to x.
    """
    turned = (1.0 + e_gamma) * np.asarray(angle)
    return test_radius * np.column_stack([np.sin(turned), 1.0 - np.cos(turned)])


def circle_error(test: str, kind: str, angle: Array, before: float) -> Array:
    """e_x (n,) of a perfect circle of a printed radius and e_gamma, over the planned angle (n,) at which it ends.

    Parameters
    ----------
    test : str
    kind : str
        Whose radius and e_gamma: ``odometric``, ``measured`` or ``simulated``.
    before : m, length of the way up to the circle.
    """
    printed, planned = TESTS[test], TESTS[test].radius[PLANNED]
    there = ideal_circle(printed.radius[kind], printed.e_gamma[kind] / 100, angle)
    off = there - ideal_circle(planned, 0.0, angle)
    return np.hypot(*off.T) / (before + planned * np.asarray(angle))


def ramp_length(test: str) -> float:
    """Length of the cubic ramp up to a test's speed, m: half of what the cruise speed makes in 1.5 v / a_max."""
    return 0.75 * TESTS[test].speed ** 2 / TEST_A_MAX
