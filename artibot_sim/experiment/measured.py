"""Where the rover was and how it moved, as its recording says."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment.columns import Channel, Experiment, Floats
from artibot_sim.experiment.smoothing import STAMP, fresh, local_fit, noise_in, rest_of
from artibot_sim.model import MOTORS

# ----------------------------------------------------------------------
# What a rover believes: dead reckoning from its wheels' rotations without slip.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


def dead_reckon(travelled: Array, turned: Array, start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """Integrate forward motion and turning, each step along its exact arc.

    Parameters
    ----------
    travelled : (n,) distance rolled since any origin, m, negative backwards.
    turned : (n,) yaw turned since any origin, rad.
    start : x, y (m) and yaw (rad) at the first sample.

    Returns
    -------
    (n, 3) array
        x, y (m) and continuous yaw (rad).
    """
    forward, turn = np.diff(travelled), np.diff(turned)
    yaw = start[2] + np.concatenate([[0.0], turned[1:] - turned[0]])
    chord = forward * np.sinc(turn / (2.0 * np.pi))  # sin(turn/2)/(turn/2): from arc to chord
    heading = yaw[:-1] + turn / 2.0
    x = start[0] + np.concatenate([[0.0], np.cumsum(chord * np.cos(heading))])
    y = start[1] + np.concatenate([[0.0], np.cumsum(chord * np.sin(heading))])
    return np.column_stack([x, y, yaw])


# ----------------------------------------------------------------------
# Heading and velocity of a rover whose front module was seen as a point, with the help of its IMU.
# ----------------------------------------------------------------------


Samples = tuple[Floats, Floats]
"""Times (n,) in s, and values (n, k)."""

_NODES = 1.0
"""s between headings that are fitted."""
COURSE_SPAN = 30.0
"""s before and after an instant whose course and yaw rate give its heading."""
COURSE_HALF_WIDTH = 0.3
"""s around an instant whose positions give the velocity there."""
CARRIED_SPAN = 1.0
"""s before and after an instant over which the accelerometer is trusted to connect positions."""
_SLOWEST = 0.1  # m/s: slower, the direction of motion is noise
_COURSE_NOISE = 0.005  # m/s, of the velocity that a course comes from
_SLIP = 0.5  # rad of side slip per rad/s of yaw rate that changes from turn to turn; rather too much: few turns
_MEAN_SLIP = 0.3  # rad of side slip per rad/s of yaw rate that does not
_DRIFT = 1e-3  # rad per root second, of an integrated yaw rate
_BIAS = 0.003  # rad/s, of a gyroscope that was never seen at rest
_STILL = 1.0  # rad/s: slower, a motor stands
_GYRO_NOISE = 0.01  # rad/s a sample, rather too much


@dataclass(frozen=True)
class Compass:
    """Headings from the course over ground and a gyroscope.

    Attributes
    ----------
    position : points (n, 2), m.
    yaw_rate : (n, 1) rad/s; may be empty.
    speeds : of the front motors (n, 2), rad/s, for forwards, backwards and standstill; may be empty.
    sensed : forward and leftward acceleration (m/s²) and yaw rate (rad/s), (n, 3); may be empty.
    """

    position: Samples
    yaw_rate: Samples
    speeds: Samples
    sensed: Samples

    def heading(self, t: float) -> float:
        """Return the heading at `t`, rad; 0 if the rover never moves.

        Course and heading differ by the side slip, and the integrated yaw rate from the heading by a constant and
        the gyroscope's bias. So course − integral = heading at `t` − bias·time + slip·rate is fitted by least
        squares over `COURSE_SPAN`, straight stretches weighing most: there is nearly no slip, and in turns it is
        not even sure to which side. At standstill the gyroscope shows its bias. Without a yaw rate it is the course.
        """
        times, course, speed = self._course
        if not len(times):
            return 0.0
        gyro_t, _ = self.yaw_rate
        near = np.abs(times - t) <= COURSE_SPAN + STAMP
        if len(gyro_t) < 2 or near.sum() < 8:
            return float(np.interp(t, times, course))
        turned, turned_then, rate = self._turned
        times, course, speed, rate = times[near], course[near], speed[near], rate[near]
        offset = course - turned_then[near] + np.interp(t, gyro_t, turned)
        away = np.abs(times - t)
        sigma = np.sqrt((_COURSE_NOISE / speed) ** 2 + (_SLIP * rate) ** 2 + _DRIFT**2 * away)
        bias, bound = self._bias
        return _fit_heading(times - t, rate, offset, 1.0 / sigma, (bias, bound))

    def headings(self, times: Floats) -> Floats:
        """Return headings at times (n,) that increase: fitted every `_NODES` s, the gyroscope's between."""
        nodes = times[np.unique(np.searchsorted(times, np.arange(times[0], times[-1], _NODES) - STAMP))]
        nodes = np.unique(np.append(nodes, times[-1]))
        fitted = np.array([self.heading(t) for t in nodes.tolist()])
        if len(nodes) == len(times):
            return fitted
        gyro_t, _ = self.yaw_rate
        if len(gyro_t) < 2:
            return np.array([self.heading(t) for t in times.tolist()])
        turned = self._turned[0]
        return np.interp(times, nodes, fitted - np.interp(nodes, gyro_t, turned)) + np.interp(times, gyro_t, turned)

    @cached_property
    def _turned(self) -> tuple[Floats, Floats, Floats]:
        """Return the integrated yaw rate (rad), the same wherever the rover moves, and the yaw rate there."""
        gyro_t, gyro = self.yaw_rate
        turned = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(gyro_t) * (gyro[1:, 0] + gyro[:-1, 0]))))
        times = self._course[0]
        return turned, np.interp(times, gyro_t, turned), local_fit(gyro_t, gyro[:, 0], times, 0.2, degree=1)[0]

    @cached_property
    def _course(self) -> tuple[Floats, Floats, Floats]:
        """Return times, direction of the front module (rad, continuous) and speed (m/s) wherever it moves."""
        times, points = self.position
        if len(times) < 4:
            return times[:0], times[:0], times[:0]
        _, velocity = local_fit(times, points, times, COURSE_HALF_WIDTH)
        sign = self._direction(times)
        speed = np.hypot(*velocity.T)
        moving = (speed > _SLOWEST) & (sign != 0)
        times, sign, velocity = times[moving], sign[moving], velocity[moving]
        if len(self.sensed[0]):
            velocity = self._carried_velocity(times, velocity, sign)
        heading = np.arctan2(sign * velocity[:, 1], sign * velocity[:, 0])
        return times, np.unwrap(heading), np.hypot(*velocity.T)

    def _carried_velocity(self, times: Floats, velocity: Floats, sign: Floats) -> Floats:
        """Return better velocities (n, 2), m/s, with the accelerometer turned to the course; it absorbs the slip."""
        better = velocity.copy()
        for row, (t, v) in enumerate(zip(times.tolist(), velocity * sign[:, None], strict=True)):
            found = carried_fit(self.position, *self.sensed, t, float(np.arctan2(v[1], v[0])))
            if found is not None and np.hypot(*(found[1] - velocity[row])) < _SLOWEST:
                better[row] = found[1]
        return better

    def _direction(self, t: Floats) -> Floats:
        """Return 1 where the front motors turn forwards, −1 backwards, 0 where one does not (turning on the spot)."""
        times, speeds = self.speeds
        if not len(times):
            return np.ones(len(t))
        smooth, _ = local_fit(times, speeds, t, 0.1, degree=1)
        sign = np.sign(smooth)
        return np.where(sign[:, 0] == sign[:, 1], sign[:, 0], 0.0)

    @cached_property
    def _bias(self) -> tuple[float, float]:
        """Return the gyroscope's bias and its standard deviation, rad/s."""
        times, speeds = self.speeds
        gyro_t, gyro = self.yaw_rate
        if not len(times):
            return 0.0, _BIAS
        smooth, _ = local_fit(times, speeds, gyro_t, 0.1, degree=1)
        still = (np.abs(smooth) < _STILL).all(axis=1) & (gyro_t >= times[0]) & (gyro_t <= times[-1])
        weight = still.sum() / _GYRO_NOISE**2
        return float(gyro[still].sum() / _GYRO_NOISE**2 / (weight + _BIAS**-2)), float((weight + _BIAS**-2) ** -0.5)


def _fit_heading(since: Floats, rate: Floats, offset: Floats, weight: Floats, bias: tuple[float, float]) -> float:
    """Solve offset ≈ heading − bias·since + slip·rate, bias known within bounds; Cauchy's function tames outliers."""
    rows = np.column_stack([np.ones(len(since)), -since, rate])
    known = np.array([0.0, bias[1] ** -2, _MEAN_SLIP**-2])
    pulled = known * np.array([0.0, bias[0], 0.0])
    w, x = weight, np.zeros(3)
    for _ in range(5):
        weighted = rows.T * w**2
        x = np.linalg.solve(weighted @ rows + np.diag(known), weighted @ offset + pulled)
        w = weight / np.sqrt(1.0 + ((offset - rows @ x) * weight / 3.0) ** 2)
    return float(x[0])


def carried_fit(
    position: Samples, imu_t: Floats, sensed: Floats, t: float, heading: float
) -> tuple[Floats, Floats] | None:
    """Return place (2,) m and velocity (2,) m/s at `t`, from positions around it that the accelerometer connects.

    Parameters
    ----------
    position : points (n, 2), m.
    imu_t, sensed : times (m,) and forward and leftward acceleration (m/s²) and yaw rate (rad/s), (m, 3).
    heading : at `t`, rad.

    Returns
    -------
    tuple or None
        None if fewer than six positions lie within `CARRIED_SPAN`, or the IMU was silent there. Position =
        place + velocity·time + acceleration twice integrated + a constant acceleration·time²/2 (tilt, bias, a
        wrong heading) is solved by least squares.
    """
    times, points = position
    near = np.abs(times - t) <= CARRIED_SPAN + STAMP
    if near.sum() < 6 and len(times) >= 6:  # at the ends, or where points are rare
        near = np.abs(times - t) <= np.sort(np.abs(times - t))[5] + STAMP
    times, points = times[near], points[near]
    around = np.abs(imu_t - t) <= CARRIED_SPAN + 0.1 + STAMP
    if len(times) < 6 or around.sum() < 20 or max(np.diff(imu_t[around])) > 0.1:
        return None
    grid = imu_t[around]
    step = np.diff(grid)[:, None]
    turned = np.concatenate(([0.0], np.cumsum(0.5 * step[:, 0] * (sensed[around][1:, 2] + sensed[around][:-1, 2]))))
    yaw = heading + turned - np.interp(t, grid, turned)
    c, s, (ax, ay) = np.cos(yaw), np.sin(yaw), sensed[around][:, :2].T
    acceleration = np.column_stack([c * ax - s * ay, s * ax + c * ay])
    speed = np.vstack([np.zeros((1, 2)), np.cumsum(0.5 * step * (acceleration[1:] + acceleration[:-1]), axis=0)])
    way = np.vstack([np.zeros((1, 2)), np.cumsum(0.5 * step * (speed[1:] + speed[:-1]), axis=0)])
    since = times - t
    rows = np.column_stack([np.ones(len(times)), since, 0.5 * since**2])
    at = [np.column_stack([np.interp(when, grid, column) for column in table.T])
          for when, table in ((times, way), (np.array([t]), way), (np.array([t]), speed))]  # fmt: skip
    known = at[0] - at[1] - since[:, None] * at[2]  # 0 at `t`, with rate 0 there
    solved = np.linalg.lstsq(rows, points - known, rcond=None)[0]
    return solved[0], solved[1]


# ----------------------------------------------------------------------
# Where the rover was and how it moved, as its recording says: what a simulation starts from and is held against.
# ----------------------------------------------------------------------


POSE_HALF_WIDTH = 0.3
"""s around an instant whose positions give place and velocity there."""
RATE_HALF_WIDTH = 0.05
"""s around an instant whose yaw rates and articulation angles count."""
TORQUE_OF_CURRENT = "torque"
"""Quantity of a motor on the channel of currents: its torque by them, N m, once it is known how they go together."""
TORQUE_DEVIATION = "torque_deviation"
"""How exactly currents say that: a standard deviation, N m."""
_EXACT = 1e-5  # m or rad: measurements with less noise are taken as they are, not smoothed


class MeasuredMotion(NamedTuple):
    """Pose (m, rad, `map`), velocity (m/s, `map`), yaw rate (rad/s), articulation (rad, rad/s); NaN if unknown."""

    x: float
    y: float
    yaw: float
    vx: float
    vy: float
    yaw_rate: float
    articulation: float
    articulation_rate: float


def forward_speed(motion: Floats) -> Floats:
    """Speed along the heading, shape (n,), m/s, of rows of `MeasuredMotion` (n, 8)."""
    yaw, vx, vy = motion[:, 2:5].T
    return np.cos(yaw) * vx + np.sin(yaw) * vy


@dataclass(frozen=True)
class Measured:
    """Measurements of a recording's motion within one segment.

    Attributes
    ----------
    experiment : the recording.
    t_start, t_end : s, the segment; nothing outside is used.
    """

    experiment: Experiment
    t_start: float
    t_end: float

    @property
    def position_source(self) -> Channel | None:
        """The topic that says where the rover went: `/total_station/point`, else `/ground_truth/odom`."""
        channels = self.experiment.channels
        return channels.get("total_station") or channels.get("ground_truth_odom")

    def position(self) -> tuple[Floats, Floats]:
        """Return times (n,) and points (n, 2), m; held samples are left out."""
        channel = self.position_source
        return _samples(channel, ("x", "y"), self.t_start, self.t_end) if channel else _nothing(2)

    @property
    def late_heading(self) -> bool:
        """Whether headings come in the messages that positions come in, and so as late as they do."""
        source = self.position_source
        return source is not None and source is self.experiment.channels.get("ground_truth_odom") and "yaw" in source

    def yaw(self) -> tuple[Floats, Floats]:
        """Return times (n,) and measured headings (n, 1), rad; none where only points were measured."""
        channel = self.experiment.channels.get("ground_truth_odom")
        return _samples(channel, ("yaw",), self.t_start, self.t_end) if channel else _nothing(1)

    def yaw_rate(self) -> tuple[Floats, Floats]:
        """Return times (n,) and yaw rates (n, 1), rad/s: of the IMU, else of the ground truth's twist."""
        for key in ("imu", "ground_truth_odom"):
            channel = self.experiment.channels.get(key)
            if channel is not None and "yaw_rate" in channel:
                found = _samples(channel, ("yaw_rate",), self.t_start, self.t_end)
                if len(found[0]):
                    return found
        return _nothing(1)

    def articulation(self, joint: int = 0) -> tuple[Floats, Floats]:
        """Return times (n,) and angles (n, 1), rad, of the first articulation or of one behind it."""
        channel = self.experiment.channels.get("joint_states")
        name = f"articulation_yaw{f'_{joint + 1}' if joint else ''}.position"
        if channel is None or name not in channel:
            return _nothing(1)
        return _samples(channel, (name,), self.t_start, self.t_end)

    def torques(self, motors: tuple[str, ...]) -> tuple[Floats, Floats]:
        """Return times (n,) and torques (n, k) of these motors, N·m."""
        channels = self.experiment.channels
        for key, quantity in (("motor_torques", "effort"), ("motor_currents", TORQUE_OF_CURRENT)):
            names = tuple(f"{motor}.{quantity}" for motor in motors)
            if key in channels:
                found = _samples(channels[key], names, self.t_start, self.t_end)
                if len(found[0]):
                    return found
        return _nothing(len(motors))

    def torque_deviation(self, motors: tuple[str, ...]) -> float:
        """Return the standard deviation, N m, of torques of these motors that currents say; NaN of measured ones."""
        torques, currents = (self.experiment.channels.get(key) for key in ("motor_torques", "motor_currents"))
        name = f"{motors[0]}.{TORQUE_DEVIATION}"
        measured = torques is not None and f"{motors[0]}.effort" in torques
        return float("nan") if measured or currents is None or name not in currents else float(currents[name][0])

    def motors(self, articulated: bool) -> dict[str, tuple[Floats, Floats]]:
        """Return times (n,) and values (n, 2) of `front_velocity` (rad/s), `torque_front` and `torque_back` (N·m)."""
        channel = self.experiment.channels.get("motor_torques")
        wanted = {"front_velocity": (MOTORS[:2], "velocity"), "torque_front": (MOTORS[:2], "effort")}
        if articulated:
            wanted["torque_back"] = (MOTORS[2:], "effort")
        if channel is None:
            return {}
        return {
            name: _samples(channel, tuple(f"{motor}.{quantity}" for motor in motors), self.t_start, self.t_end)
            for name, (motors, quantity) in wanted.items()
        }

    def at(self, t: float) -> MeasuredMotion:
        """Return the motion at time `t`, by local fits to the measurements before and after it."""
        return MeasuredMotion(*self.along(np.array([t]))[0].tolist())

    def behind(self, t: float, joints: int) -> Floats:
        """Return angles and rates (2, joints) of so many joints behind the first at `t`; NaN where not recorded."""
        return self.behind_along(np.array([t]), joints)[0].reshape(joints, 2).T

    def behind_along(self, times: Floats, joints: int) -> Floats:
        """Return angle and rate of each of so many joints behind the first, (n, 2 joints), at times (n,)."""
        found = np.full((len(times), 2 * joints), np.nan)
        for j in range(joints):
            table = self.articulation(j + 1)
            if len(table[0]):
                found[:, 2 * j : 2 * j + 2] = np.column_stack(Local(*table).at(times, RATE_HALF_WIDTH))
        return found

    def along(self, times: Floats) -> Floats:
        """Return the motion at times (n,) that increase, (n, 8) in the order of `MeasuredMotion`."""
        if not len(times):
            return np.empty((0, len(MeasuredMotion._fields)))
        of = self._local
        bend, bend_rate = of["articulation"].at(times, RATE_HALF_WIDTH)
        yaw, yaw_slope = of["yaw"].at(times, POSE_HALF_WIDTH)
        rate = of["yaw_rate"].at(times, RATE_HALF_WIDTH, degree=1)[0] if len(of["yaw_rate"].t) else yaw_slope
        heading = yaw[:, 0] if np.isfinite(yaw).all() else self._compass.headings(times)
        position, velocity = of["position"].at(times, POSE_HALF_WIDTH)
        for row, found in enumerate(map(self._carried, times.tolist(), heading.tolist())):
            if found is not None:
                position[row], velocity[row] = found
        if len(of["twist"].t):
            forward, left = of["twist"].at(times, RATE_HALF_WIDTH)[0].T
            c, s = np.cos(heading), np.sin(heading)
            velocity = np.column_stack([c * forward - s * left, s * forward + c * left])
        return np.column_stack([position, heading, velocity, rate, bend, bend_rate])

    @cached_property
    def _local(self) -> dict[str, Local]:
        """What `at` fits."""
        series = {
            "articulation": self.articulation(), "yaw": self.yaw(), "yaw_rate": self.yaw_rate(),
            "position": self.position(), "twist": self._twist(),
        }  # fmt: skip
        return {name: Local(*samples) for name, samples in series.items()}

    @cached_property
    def _compass(self) -> Compass:
        """What gives headings where only points were measured."""
        return Compass(self.position(), self.yaw_rate(), self.speeds(), self.sensed)

    def speeds(self) -> tuple[Floats, Floats]:
        """Return times (n,) and the speeds of the front motors (n, 2), rad/s."""
        motors = self.experiment.channels.get("motor_torques")
        names = ("front_right.velocity", "front_left.velocity")
        return _samples(motors, names, self.t_start, self.t_end) if motors else _nothing(2)

    def _carried(self, t: float, heading: float) -> tuple[Floats, Floats] | None:
        """Return place and velocity (2,) at `t` with the help of the accelerometer, None if there is none."""
        position = self._local["position"]
        return carried_fit((position.t, position.values), *self.sensed, t, heading) if len(self.sensed[0]) else None

    @cached_property
    def sensed(self) -> tuple[Floats, Floats]:
        """Times (n,), forward and leftward acceleration (m/s²) and yaw rate (rad/s), (n, 3); zeros measure nothing."""
        imu = self.experiment.channels.get("imu")
        times, sensed = _samples(imu, ("ax", "ay", "yaw_rate"), self.t_start, self.t_end) if imu else _nothing(3)
        return (times, sensed) if len(times) >= 20 and sensed[:, :2].any() else _nothing(3)

    def _twist(self) -> tuple[Floats, Floats]:
        """Return times (n,) and velocities (n, 2) in the rover's frame, m/s, if the ground truth has them."""
        channel = self.experiment.channels.get("ground_truth_odom")
        return _samples(channel, ("vx", "vy"), self.t_start, self.t_end) if channel else _nothing(2)


def _nothing(columns: int) -> tuple[Floats, Floats]:
    return np.empty(0), np.empty((0, columns))


def _samples(channel: Channel, names: tuple[str, ...], t_start: float, t_end: float) -> tuple[Floats, Floats]:
    """Return times (n,) and values (n, k) of columns where all are finite and new."""
    if not set(names) <= set(channel.columns):
        return _nothing(len(names))
    values = np.column_stack([channel[name] for name in names])
    finite = np.isfinite(values).all(axis=1)
    times, values = channel.t[finite], values[finite]
    used = fresh(values) & (times >= t_start - STAMP) & (times <= t_end + STAMP)
    return times[used], values[used]


@dataclass(frozen=True)
class Local:
    """Samples `values` (n, k) at times `t` (n,), of which values and rates at other times are wanted."""

    t: Floats
    values: Floats

    def at(self, at: Floats, half_width: float, degree: int = 3) -> tuple[Floats, Floats]:
        """Return values and rates (m, k) at times (m,): of local fits, or of the samples if those are exact."""
        times, values = self.t, self.values
        value, rate = local_fit(times, values, at, half_width, degree)
        for row, t in enumerate(at.tolist()):
            if len(times) and times[0] <= t <= times[-1] and self._exact(t, 20 * half_width):
                value[row] = [np.interp(t, times, column) for column in values.T]
        return value, rate

    def _exact(self, t: float, reach: float) -> bool:
        """Whether samples as far as `reach` from `t` have next to no noise."""
        near = slice(*np.searchsorted(self.t, (t - reach - STAMP, t + reach + STAMP)))
        return all(noise_in(rest[near]) < _EXACT for rest in self._rests)

    @cached_property
    def _rests(self) -> list[Floats]:
        return [rest_of(self.t, column) for column in self.values.T]
