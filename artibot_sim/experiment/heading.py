"""Heading and velocity of a rover whose front module was seen as a point, with the help of its IMU."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.local_fit import local_fit

Samples = tuple[Floats, Floats]
"""Times (n,) in s, and values (n, k)."""

_NODES = 1.0
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
        near = np.abs(times - t) <= COURSE_SPAN
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
        nodes = times[np.unique(np.searchsorted(times, np.arange(times[0], times[-1], _NODES)))]
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
    near = np.abs(times - t) <= CARRIED_SPAN
    if near.sum() < 6 and len(times) >= 6:  # at the ends, or where points are rare
        near = np.abs(times - t) <= np.sort(np.abs(times - t))[5] + 1e-9
    times, points = times[near], points[near]
    around = np.abs(imu_t - t) <= CARRIED_SPAN + 0.1
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
