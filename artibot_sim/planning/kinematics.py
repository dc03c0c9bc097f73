"""Inverse and forward kinematics of the front module without slip.

A wheel at lateral position y rolls at ``v - y * yaw_rate``; the right wheels are at -i_y/2, the left ones at
+i_y/2, and a motor turns 1/tau times as fast as its wheels. The lateral speed that a skid-steer's wheels have in a
turn is disregarded, as in section 6 of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from artibot_sim.model.robot import Robot
from artibot_sim.planning.quadrature import Array


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
