"""What the simulated sensors make of the truth: encoders, torques, articulation, IMU, total station.

Each kind draws from its own stream of one seed, so that switching one on leaves the others' numbers as they were.
With every sigma at zero the numbers pass through untouched, to the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    gyro, gyro_bias, acceleration : float
        Of the IMU: rad/s, a constant rad/s, m/s².
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


class Sensors:
    """The sensors of one rover with their random streams.

    Parameters
    ----------
    model : SensorModel
    seed : int
        Not negative. Same seed and same truth: same readings, to the bit.
    """

    def __init__(self, model: SensorModel, seed: int) -> None:
        self.model = model
        streams = np.random.SeedSequence(seed).spawn(4)
        self._motors, self._joint, self._imu, self._station = (np.random.default_rng(stream) for stream in streams)

    def encoders(self, position: Array) -> Array:
        """Motor positions (rad) as counted."""
        if not self.model.encoder_counts:
            return position
        count = 2.0 * math.pi / self.model.encoder_counts
        return np.floor(position / count + 0.5) * count

    def velocities(self, velocity: Array) -> Array:
        """Motor velocities (rad/s) as measured."""
        return _noisy(self._motors, velocity, self.model.velocity)

    def torques(self, torque: Array) -> Array:
        """Motor torques (N·m) as measured."""
        relative = self.model.torque_relative
        if relative:
            torque = torque * (1.0 + relative * self._motors.standard_normal(torque.shape))
        return _noisy(self._motors, torque, self.model.torque)

    def articulation(self, angles: Array) -> Array:
        """Articulation angles (rad) as measured."""
        return _noisy(self._joint, angles, self.model.articulation)

    def imu(self, yaw_rate: float, acceleration: Array) -> tuple[float, Array]:
        """Yaw rate (rad/s) and specific force (m/s², shape (3,)) as measured."""
        noise = self._imu.standard_normal(4)
        return (
            yaw_rate + self.model.gyro_bias + self.model.gyro * float(noise[0]),
            acceleration + self.model.acceleration * noise[1:],
        )

    def station(self, position: Array, attitude: Array) -> Array | None:
        """The prism in `map` (m, shape (3,)) as measured, or None when the point is lost.

        Parameters
        ----------
        position : array, shape (3,)
            Front module's origin, m.
        attitude : array, shape (3, 3)
            Its rotation.
        """
        lost = self._station.random() < self.model.station_loss
        noise = self._station.standard_normal(3)
        if lost:
            return None
        return position + attitude @ np.array(self.model.prism) + self.model.station * noise


def _noisy(stream: np.random.Generator, values: Array, sigma: float) -> Array:
    return values + sigma * stream.standard_normal(values.shape) if sigma else values
