"""Plans: a manoeuvre for a certain robot, sampled, with the motor velocities that would drive it without slip."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands
from artibot_sim.model.robot.robot import Robot
from artibot_sim.planning.manoeuvre import Manoeuvre
from artibot_sim.planning.paths import Array
from artibot_sim.planning.route import Mark, PlannedMotion, Route

# ----------------------------------------------------------------------
# Inverse and forward kinematics of the front module without slip.
#
# A wheel at lateral position y rolls at ``v - y * yaw_rate``; the right wheels are at -i_y/2, the left ones at
# +i_y/2, and a motor turns 1/tau times as fast as its wheels. The lateral speed that a skid-steer's wheels have in
# a turn is disregarded, as in section 6 of the paper.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class FrontKinematics:
    """Between the front module's motion and its two motors.

    Attributes
    ----------
    track : float
        Lateral spacing i_y of the wheels, m.
    travel : float
        Distance that a wheel rolls while its motor turns by one radian, r_w * tau, m/rad.
    """

    track: float
    travel: float

    @classmethod
    def of(cls, robot: Robot) -> FrontKinematics:
        """The kinematics of a robot's front module."""
        return cls(track=robot.front.i_y, travel=robot.wheel.r_w * robot.drive_front.tau)

    def inverse(self, forward: Array, turn: Array) -> Array:
        """Motor motion [front_right, front_left], (n, 2), motor-side.

        Parameters
        ----------
        forward, turn : (n,) arrays
            Speed (m/s) and yaw rate (rad/s) for velocities in rad/s; distance (m) and yaw (rad) since the start for
            rotations in rad.
        """
        side = 0.5 * self.track * turn
        return np.stack([forward + side, forward - side], axis=-1) / self.travel

    def forward(self, motors: Array) -> tuple[Array, Array]:
        """The inverse of :meth:`inverse`: forward and turning motion from [front_right, front_left], (n, 2)."""
        right, left = motors[..., 0] * self.travel, motors[..., 1] * self.travel
        return 0.5 * (right + left), (right - left) / self.track


# ----------------------------------------------------------------------
# Plans: a manoeuvre for a certain robot, sampled, with the motor velocities that would drive it without slip.
# ----------------------------------------------------------------------


MAX_SAMPLES = 2_000_000
"""Most samples that a plan may have (at 10 ms more than five hours)."""


@dataclass(frozen=True)
class PlanSample(PlannedMotion):
    """A plan at times `t`: :class:`PlannedMotion` and what the front motors do for it.

    Attributes
    ----------
    velocity : (n, 2) array
        Front motors [front_right, front_left], motor-side, rad/s.
    position : (n, 2) array
        Their rotations since the start, rad: the exact integral of the velocity.
    """

    velocity: Array
    position: Array


@dataclass(frozen=True, eq=False)
class Plan:
    """A manoeuvre planned for a robot. Arrays are read-only.

    Attributes
    ----------
    manoeuvre : Manoeuvre
    robot : str
        Name of the robot that the motor velocities are for.
    dt : float
        Sampling interval, s.
    start : (x, y, yaw)
        Start pose, m, m, rad.
    duration, path_length : float
        Of the manoeuvre, s and m (sigma of eq. 32).
    marks : tuple of Mark
        When each segment begins and ends.
    warnings : tuple of str
        What may keep the robot from following.
    t : (n,) array, s
        Multiples of `dt` from 0; the last is the first not before the end.
    pose : (n, 3) array
        x, y (m) and continuous yaw (rad) of the origin of {f} in `map`.
    twist : (n, 2) array
        Forward speed (m/s) and yaw rate (rad/s). At a jump of the curvature, the value after it.
    travelled : (n,) array, m
        Length of the path so far.
    velocity, position : (n, 2) arrays
        Front motors [front_right, front_left], motor-side, rad/s and rad.
    """

    manoeuvre: Manoeuvre
    robot: str
    dt: float
    start: tuple[float, float, float]
    duration: float
    path_length: float
    marks: tuple[Mark, ...]
    warnings: tuple[str, ...]
    t: Array
    pose: Array
    twist: Array
    travelled: Array
    velocity: Array
    position: Array
    _route: Route = field(repr=False)
    _kinematics: FrontKinematics = field(repr=False)

    def at(self, t: float | Array) -> PlanSample:
        """The plan at any times, independent of `dt`.

        Parameters
        ----------
        t : float or (n,) array, s
            Before 0 the rover rests at the start; after the end its last twist goes on (rest, as a rule).

        Returns
        -------
        PlanSample
            Arrays of n rows (one row for a float).
        """
        return _sample(self._route, self._kinematics, np.atleast_1d(np.asarray(t, dtype=float)))

    def commands(self) -> Commands:
        """The front motor profile as :class:`artibot_sim.model.Commands`; the back motors are left to eq. 30."""
        velocity = np.full((len(self.t), 4), np.nan)
        position = velocity.copy()
        velocity[:, :2], position[:, :2] = self.velocity, self.position
        return Commands(self.dt, velocity=velocity, position=position)


def plan(
    manoeuvre: Manoeuvre,
    robot: Robot,
    dt: float = 0.01,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    wheel_speed_limit: float | None = None,
) -> Plan:
    """Plan a manoeuvre for a robot.

    Lengths, times, headings and motor rotations are closed forms; so are positions, except on spirals, slaloms and
    yaw rate chirps, where they are integrated to rounding. Segment boundaries fall where they fall: sampling does
    not move them.

    Parameters
    ----------
    manoeuvre : Manoeuvre
    robot : Robot
    dt : float
        Sampling interval, s.
    start : (x, y, yaw)
        Pose of {f} in `map` at the start, m, m, rad.
    wheel_speed_limit : float, optional
        Largest speed that a wheel reaches on the ground, m/s; a plan beyond it gets a warning.

    Raises
    ------
    ArtibotError
        Naming the segment that cannot be driven, or the argument that is out of range.
    """
    if not (math.isfinite(dt) and 1e-5 <= dt <= 1.0):
        raise ArtibotError(f"dt: found {dt:g} s, expected a sampling interval from 1e-5 to 1 s")
    pose = tuple(float(value) for value in start)
    if len(pose) != 3 or not all(math.isfinite(value) for value in pose):
        raise ArtibotError(f"start: found {tuple(start)}, expected x, y, yaw as three finite numbers (m, m, rad)")
    route = _route(manoeuvre, pose)
    steps = math.ceil(route.duration / dt - 1e-6)
    if steps >= MAX_SAMPLES:
        raise ArtibotError(
            f"{manoeuvre.name}: {route.duration:g} s at {dt:g} s make {steps} samples, expected at most {MAX_SAMPLES}; "
            "take a larger dt or a shorter manoeuvre"
        )
    kinematics = FrontKinematics.of(robot)
    sample = _sample(route, kinematics, np.arange(steps + 1, dtype=np.float64) * dt)
    for array in (sample.t, sample.pose, sample.twist, sample.travelled, sample.velocity, sample.position):
        array.flags.writeable = False
    return Plan(
        manoeuvre=manoeuvre,
        robot=robot.name,
        dt=dt,
        start=(pose[0], pose[1], pose[2]),
        duration=route.duration,
        path_length=route.path_length,
        marks=route.marks,
        warnings=_warnings(route, kinematics, sample, wheel_speed_limit),
        t=sample.t,
        pose=sample.pose,
        twist=sample.twist,
        travelled=sample.travelled,
        velocity=sample.velocity,
        position=sample.position,
        _route=route,
        _kinematics=kinematics,
    )


def _route(manoeuvre: Manoeuvre, start: Sequence[float]) -> Route:
    try:
        return Route(manoeuvre, start)
    except ArtibotError as error:
        raise ArtibotError(f"{manoeuvre.name}: {error}") from error


def _sample(route: Route, kinematics: FrontKinematics, t: Array) -> PlanSample:
    motion = route.at(t)
    velocity = kinematics.inverse(motion.twist[:, 0], motion.twist[:, 1])
    position = kinematics.inverse(motion.arc, motion.pose[:, 2] - route.start_yaw)
    return PlanSample(**vars(motion), velocity=velocity, position=position)


def _warnings(
    route: Route, kinematics: FrontKinematics, sample: PlanSample, wheel_speed_limit: float | None
) -> tuple[str, ...]:
    found = []
    speed = float(route.at(np.array([route.duration])).twist[0, 0])
    if abs(speed) > 1e-9:
        found.append(f"it ends at {speed:g} m/s; add a stop, or whoever follows it has to halt by itself")
    fastest = float(np.max(np.abs(sample.velocity), initial=0.0)) * kinematics.travel
    if wheel_speed_limit is not None and fastest > wheel_speed_limit:
        found.append(
            f"a wheel runs at up to {fastest:.3g} m/s, the limit is {wheel_speed_limit:g}; "
            "the robot will lag behind: lower the speed or widen the turns"
        )
    return tuple(found)
