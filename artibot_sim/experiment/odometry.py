"""What a rover believes: dead reckoning from its wheels' rotations without slip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
