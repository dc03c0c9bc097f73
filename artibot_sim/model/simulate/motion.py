"""How a rover moves as sensors on it see it, which roll and pitch with their module."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.equations.kinematics import articulations
from artibot_sim.model.kernels.layout import ALPHA, BACK, BETA, GAMMA, Z

Array = NDArray[np.float64]


def linear_velocity(q: Array, v: Array, module: int = 0) -> Array:
    """Velocity of a module's origin in its own frame, m/s, shape (…, 3), at states (…, 16)."""
    return velocities(q, v, module)[0]


def angular_velocity(q: Array, v: Array, module: int = 0) -> Array:
    """Angular velocity of a module in its own frame, from the rates of its angles (eq. 2), rad/s, shape (…, 3)."""
    return velocities(q, v, module)[1]


def velocities(q: Array, v: Array, module: int = 0) -> tuple[Array, Array]:
    """`linear_velocity` and `angular_velocity` of a module."""
    s_a, c_a, s_b, c_b, s_g, c_g = _turns(q, module)
    x, y, up, roll, pitch, yaw = _parts(v, *(BACK * module + i for i in (0, 1, Z, ALPHA, BETA, GAMMA)))
    forward, left = c_g * x + s_g * y, c_g * y - s_g * x
    ahead, over = c_b * forward - s_b * up, s_b * forward + c_b * up
    return (
        _in_columns(ahead, c_a * left + s_a * over, c_a * over - s_a * left),
        _in_columns(roll - s_b * yaw, c_a * pitch + s_a * c_b * yaw, c_a * c_b * yaw - s_a * pitch),
    )


def _parts(of: Array, *places: int) -> list[Any]:
    """Components (…) of (…, n): plain numbers of one state, which a node asks for a hundred times a second."""
    if of.ndim > 1:
        return [of[..., i] for i in places]
    values = of.tolist()
    return [values[i] for i in places]


def _in_columns(*parts: Any) -> Array:
    """Components (…) as (…, n)."""
    return np.stack(parts, axis=-1) if np.ndim(parts[0]) else np.array(parts)


def axes_of(q: Array, module: int = 0) -> Array:
    """R_z R_y R_x (eq. 2), shape (…, 3, 3): a module's axes in `map`, column by column."""
    s_a, c_a, s_b, c_b, s_g, c_g = _turns(q, module)
    return np.stack(
        [
            np.stack([c_g * c_b, c_g * s_b * s_a - s_g * c_a, c_g * s_b * c_a + s_g * s_a], axis=-1),
            np.stack([s_g * c_b, s_g * s_b * s_a + c_g * c_a, s_g * s_b * c_a - c_g * s_a], axis=-1),
            np.stack([-s_b, c_b * s_a, c_b * c_a], axis=-1),
        ],
        axis=-2,
    )


def joint_motion(q: Array, v: Array) -> tuple[Array, Array]:
    """Angles of the joints as encoders in them turn (rad), yaw and roll of each, and their rates, (…, 2 · joints).

    Level modules differ by them in yaw and roll. Where one of two modules is tilted, the joint turns about the z axis
    of the front one and about the x axis of the back one (eq. 13).
    """
    angles, rates = articulations(q), articulations(v)
    tilts = [ALPHA, BETA, BACK + ALPHA, BACK + BETA]
    if q.ndim == 1 and not (any(_parts(q, *tilts)) or any(_parts(v, *tilts))):
        return angles, rates
    tilted = np.asarray(q[..., tilts].any(axis=-1) | v[..., tilts].any(axis=-1))
    if q.shape[-1] != 2 * BACK or not tilted.any():
        return angles, rates
    front, back = axes_of(q), axes_of(q, 1)
    between = np.swapaxes(front, -1, -2) @ back
    yaw, roll = np.arctan2(between[..., 1, 0], between[..., 0, 0]), np.arctan2(between[..., 2, 1], between[..., 2, 2])
    turning = (back @ angular_velocity(q, v, 1)[..., None] - front @ angular_velocity(q, v)[..., None])[..., 0]
    about = [(turning * front[..., 2]).sum(axis=-1), (turning * back[..., 0]).sum(axis=-1)]
    exact = np.stack([yaw, roll], axis=-1), np.stack(about, axis=-1)
    return np.where(tilted[..., None], exact[0], angles), np.where(tilted[..., None], exact[1], rates)


def _turns(q: Array, module: int) -> tuple[Any, ...]:
    """Sines and cosines of roll, pitch and yaw."""
    angles = _parts(q, *(BACK * module + i for i in (ALPHA, BETA, GAMMA)))
    turns: Any = (np.sin, np.cos) if q.ndim > 1 else (math.sin, math.cos)
    return tuple(turn(angle) for angle in angles for turn in turns)
