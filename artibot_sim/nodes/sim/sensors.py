"""What the simulated sensors make of the truth: encoders, torques, articulation, IMU, total station.

Each kind draws from its own stream of one seed, so that switching one on leaves the others' numbers as they were.
With every sigma at zero the numbers pass through untouched, to the bit. What a robot's effects do to its sensors
(`artibot_sim.model.simulate.sensors`) is done first.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects.speed_loop_lag import weights
from artibot_sim.model.robot.parameters import NO_SENSOR_ERRORS, SensorErrors

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorModel:
    """Errors of the sensors (standard deviations unless said otherwise; SI units).

    Attributes
    ----------
    encoder_counts : int
        Counts a turn of the motor; positions are rounded to counts. 0: not rounded.
    velocity, torque, torque_relative, articulation : float
        Of motor velocities (rad/s), motor torques (N·m, and relative to the torque), articulation angles (rad).
    gyro, gyro_bias, acceleration, orientation : float
        Of the IMU: rad/s about each axis, a constant rad/s about z, m/s², rad.
    station, station_loss : float
        Of each coordinate of the total station's point (m); fraction of its points that are lost.
    prism : (float, float, float)
        Where the prism sits in the front module, m.
    """

    encoder_counts: int = 0
    velocity: float = 0.0
    torque: float = 0.0
    torque_relative: float = 0.0
    articulation: float = 0.0
    gyro: float = 0.0
    gyro_bias: float = 0.0
    acceleration: float = 0.0
    station: float = 0.0
    station_loss: float = 0.0
    prism: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: float = 0.0


class SimulatedSensors:
    """The sensors of one rover with their random streams.

    Parameters
    ----------
    model : SensorModel
    seed : int
        Not negative. Same seed and same truth: same readings, to the bit.
    errors : SensorErrors, optional
        Of the robot.
    """

    def __init__(self, model: SensorModel, seed: int, errors: SensorErrors = NO_SENSOR_ERRORS) -> None:
        self.model, self.errors = model, errors
        self._arm = np.array(model.prism) + np.array([errors.arm_x, errors.arm_y, 0.0])
        self._past: deque[tuple[int, Array]] = deque()
        self._smoothed: tuple[int, Array, Array] | None = None
        streams = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(5))
        self._motors, self._joint, self._imu, self._station, self._attitude = streams

    def turned(self, position: Array) -> Array:
        """Motor positions (rad) as encoders turn, not yet counted."""
        return self.errors.encoder_scale * position

    def encoders(self, position: Array) -> Array:
        """Motor positions (rad) as counted."""
        position = self.turned(position)
        if not self.model.encoder_counts:
            return position
        count = 2.0 * math.pi / self.model.encoder_counts
        return np.floor(position / count + 0.5) * count

    def velocities(self, t_ns: int, velocity: Array) -> Array:
        """Motor velocities (rad/s) at an instant as measured: smoothed where the robot's drives do so.

        At the first instant, and where time goes back, what smooths them has settled.
        """
        return _noisy(self._motors, self.errors.encoder_scale * self._smooth(t_ns, velocity), self.model.velocity)

    def _smooth(self, t_ns: int, velocity: Array) -> Array:
        if not self.errors.velocity_filter:
            return velocity
        smoothed = velocity
        if self._smoothed is not None and t_ns > self._smoothed[0]:
            before, came, went = self._smoothed
            now, last, kept = weights(self.errors.velocity_filter, 1e-9 * (t_ns - before))
            smoothed = now * velocity + last * came + kept * went
        self._smoothed = t_ns, velocity.copy(), smoothed
        return smoothed

    def torques(self, torque: Array) -> Array:
        """Motor torques (N·m) as measured."""
        torque, relative = self.errors.torque_scale * torque, self.model.torque_relative
        if relative:
            torque = torque * (1.0 + relative * self._motors.standard_normal(torque.shape))
        return _noisy(self._motors, torque, self.model.torque)

    def articulation(self, angles: Array) -> Array:
        """Articulation angles (rad) as measured."""
        return _noisy(self._joint, angles, self.model.articulation)

    def imu(self, rates: Array, acceleration: Array) -> tuple[Array, Array]:
        """Angular rates (rad/s, shape (3,)) and specific force (m/s², shape (3,)) as measured."""
        noise, tilting = self._imu.standard_normal(4), self._attitude.standard_normal(2)
        bias = np.array([0.0, 0.0, self.errors.gyro_bias + self.model.gyro_bias])
        return (
            rates + bias + self.model.gyro * np.array([*tilting, noise[0]]),
            acceleration + self.model.acceleration * noise[1:],
        )

    def orientation(self, rpy: Array) -> Array:
        """Roll, pitch and yaw (rad) as measured."""
        return _noisy(self._attitude, rpy, self.model.orientation)

    def follow(self, t_ns: int, position: Array, attitude: Array) -> Array:
        """Where the prism was when that was measured which is stamped `t_ns`, in `map` (m, shape (3,)).

        Parameters
        ----------
        t_ns : int
            Now; call it at every publication, for the delay needs what was before.
        position : array, shape (3,)
            Front module's origin, m.
        attitude : array, shape (3, 3)
            Its rotation.
        """
        point = position + attitude @ self._arm
        if not self.errors.delay:
            return point
        then, past = t_ns - round(self.errors.delay * 1e9), self._past
        past.append((t_ns, point))
        while len(past) > 1 and past[1][0] <= then:
            past.popleft()
        begun, before = past[0]
        if then <= begun:  # before the first publication it stood there, or is not to be known
            return before
        end, after = past[1]
        return before + (then - begun) / (end - begun) * (after - before)

    def station(self, point: Array) -> Array | None:
        """The prism at `point` in `map` (m, shape (3,)) as measured, or None when the point is lost."""
        lost = self._station.random() < self.model.station_loss
        noise = self._station.standard_normal(3)
        return None if lost else point + self.model.station * noise


def _noisy(stream: np.random.Generator, values: Array, sigma: float) -> Array:
    return values + sigma * stream.standard_normal(values.shape) if sigma else values
