"""Where the rover was and how it moved, as its recording says: what a simulation starts from and is held against."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from artibot_sim.experiment.columns import Channel, Experiment, Floats
from artibot_sim.experiment.heading import Compass, carried_fit
from artibot_sim.experiment.local_fit import fresh, local_fit, noise_in, rest_of
from artibot_sim.model import MOTORS

POSE_HALF_WIDTH = 0.3
"""s around an instant whose positions give place and velocity there."""
RATE_HALF_WIDTH = 0.05
"""s around an instant whose yaw rates and articulation angles count."""
_EXACT = 1e-5  # m or rad: measurements with less noise are taken as they are, not smoothed


class Motion(NamedTuple):
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
    """Speed along the heading, shape (n,), m/s, of rows of `Motion` (n, 8)."""
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

    def articulation(self) -> tuple[Floats, Floats]:
        """Return times (n,) and articulation angles (n, 1), rad."""
        channel = self.experiment.channels.get("joint_states")
        if channel is None or "articulation_yaw.position" not in channel:
            return _nothing(1)
        return _samples(channel, ("articulation_yaw.position",), self.t_start, self.t_end)

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

    def at(self, t: float) -> Motion:
        """Return the motion at time `t`, by local fits to the measurements before and after it."""
        return Motion(*self.along(np.array([t]))[0].tolist())

    def along(self, times: Floats) -> Floats:
        """Return the motion at times (n,) that increase, (n, 8) in the order of `Motion`."""
        if not len(times):
            return np.empty((0, len(Motion._fields)))
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
    used = np.isfinite(values).all(axis=1) & (channel.t >= t_start - 1e-6) & (channel.t <= t_end + 1e-6)
    times, values = channel.t[used], values[used]
    new = fresh(values)
    return times[new], values[new]


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
        near = slice(*np.searchsorted(self.t, (t - reach, t + reach)))
        return all(noise_in(rest[near]) < _EXACT for rest in self._rests)

    @cached_property
    def _rests(self) -> list[Floats]:
        return [rest_of(self.t, column) for column in self.values.T]
