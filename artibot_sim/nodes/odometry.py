"""Odometry: where a rover believes it is, from the rotations of its front wheels."""

from __future__ import annotations

import math

from artibot_sim.model import Robot


def metres_per_radian(robot: Robot) -> float:
    """``r_w tau``: ground covered per radian of a front motor."""
    return robot.wheel.r_w * robot.drive.front.tau


class Odometry:
    """What the robot believes: its pose from the front wheels' rotations, no slip.

    Parameters
    ----------
    metres_per_radian : float
        ``r_w tau``, ground per radian of a front motor.
    track : float
        ``i_y`` of the front module, m.
    """

    def __init__(self, metres_per_radian: float, track: float) -> None:
        self._metres = metres_per_radian
        self._track = track
        self.pose = (0.0, 0.0, 0.0)
        self.twist = (0.0, 0.0)
        self._last: tuple[float, float] | None = None

    def reset(self, x: float, y: float, yaw: float) -> None:
        """Believe this pose (m, rad), at rest; the next motor positions are taken as the zero of rotation."""
        self.pose, self.twist, self._last = (x, y, yaw), (0.0, 0.0), None

    def update(self, position: tuple[float, float], velocity: tuple[float, float]) -> None:
        """Go on by the front motors' positions (rad) and velocities (rad/s), right and left.

        Between two readings the path is an arc, followed by its chord at mean yaw.
        """
        right, left = self._metres * velocity[0], self._metres * velocity[1]
        self.twist = (0.5 * (right + left), (right - left) / self._track)
        if self._last is not None:
            right = self._metres * (position[0] - self._last[0])
            left = self._metres * (position[1] - self._last[1])
            turn, x, y, yaw = (right - left) / self._track, *self.pose
            length = 0.5 * (right + left) * (math.sin(0.5 * turn) / (0.5 * turn) if abs(turn) > 1e-9 else 1.0)
            self.pose = (x + length * math.cos(yaw + 0.5 * turn), y + length * math.sin(yaw + 0.5 * turn), yaw + turn)
        self._last = position
