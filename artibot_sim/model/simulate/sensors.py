"""What a robot's own sensors make of the truth, where effects say so: scales, a bias, a lever arm, an angle, a delay.

The rover itself knows nothing of them. They act where something is measured: in `sampling` (predictions of a fit), in
what a rollout is written as, in the simulator's sensors; and, the other way round, on measurements that go into the
model: rotations that turn its motors (`WindowBatch`) and starts (`true_starts`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import at_work
from artibot_sim.model.effects.speed_loop_lag import weights
from artibot_sim.model.robot.parameters import NO_SENSOR_ERRORS, SensorErrors
from artibot_sim.model.robot.robot import Robot

Array = NDArray[np.float64]


def sensor_errors(robot: Robot) -> SensorErrors:
    """The sensor errors that a robot's effects make."""
    errors = NO_SENSOR_ERRORS
    for effect, values in at_work(robot.effects).values():
        if effect.sensor is not None:
            errors = effect.sensor(errors, values)
    return errors


def tracked_point(errors: SensorErrors, pose: Array) -> Array:
    """Where the tracked point is in `map`, shape (n, 2), m, for poses (n, 3) of the front module: x, y, yaw."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y = errors.arm_x, errors.arm_y
    return np.column_stack([pose[:, 0] + (c * x - s * y), pose[:, 1] + (s * x + c * y)])


def low_passed(t: Array, values: Array, time_constant: float) -> Array:
    """What comes out of a first-order low-pass, shape as `values` (n, k), whose instants `t` (n,) increase, s.

    Exact for values that are linear in between; at the first instant it has settled.
    """
    found = np.array(values, dtype=float)
    for i, h in enumerate(np.diff(t).tolist() if time_constant > 0.0 else (), 1):
        now, before, kept = weights(time_constant, h)
        found[i] = now * values[i] + before * values[i - 1] + kept * found[i - 1]
    return found


def true_starts(errors: Array, starts: Array, late: NDArray[np.bool_]) -> Array:
    """The rover's own motion at an instant, from what sensors with errors make of it then.

    Parameters
    ----------
    errors : array, shape (n, 8) or (1, 8)
        Rows of SensorErrors.
    starts : array, shape (n, k), k ≥ 6
        Measured: x, y, yaw in `map` (m, rad), forward and leftward velocity (m/s) of the tracked point, yaw rate
        (rad/s); further columns are passed through.
    late : array of bool, shape (n,)
        Whether the heading came with the positions, and as late. Velocities always do.

    Notes
    -----
    Over the delay d the twist (v, ω) of the front module is taken as constant, so that with yaw' its heading d
    earlier (measured less the heading's offset, where both come together), p = P − R(yaw') arm + R(yaw') ∫ R(ω t) v dt
    over d, P being the tracked point. `measured_starts` is the inverse, to rounding.
    """
    _, _, arm_x, arm_y, delay, bias, offset, _ = errors.T
    x, y, yaw, u, w, rate = starts[:, :6].T
    omega = rate - bias
    turned = omega * delay
    before = np.where(late, yaw - offset, yaw - turned)
    c, s = np.cos(yaw - before), np.sin(yaw - before)
    forward, left = c * u - s * w + omega * arm_y, s * u + c * w - omega * arm_x
    ahead, aside = _displacement(turned, delay, forward, left)
    c, s = np.cos(before), np.sin(before)
    true = starts.copy()
    true[:, 0] = x + (c * (ahead - arm_x) - s * (aside - arm_y))
    true[:, 1] = y + (s * (ahead - arm_x) + c * (aside - arm_y))
    true[:, 2], true[:, 3], true[:, 4], true[:, 5] = before + turned, forward, left, omega
    return true


def measured_starts(errors: Array, starts: Array, late: NDArray[np.bool_]) -> Array:
    """What sensors with errors make of the rover's motion: the inverse of `true_starts`, shapes as there."""
    _, _, arm_x, arm_y, delay, bias, offset, _ = errors.T
    x, y, yaw, forward, left, omega = starts[:, :6].T
    turned = omega * delay
    before = yaw - turned
    ahead, aside = _displacement(turned, delay, forward, left)
    c, s = np.cos(before), np.sin(before)
    seen = starts.copy()
    seen[:, 0] = x - (c * (ahead - arm_x) - s * (aside - arm_y))
    seen[:, 1] = y - (s * (ahead - arm_x) + c * (aside - arm_y))
    seen[:, 2] = np.where(late, before + offset, yaw)
    u, w = forward - omega * arm_y, left + omega * arm_x
    c, s = np.cos(before - seen[:, 2]), np.sin(before - seen[:, 2])
    seen[:, 3], seen[:, 4], seen[:, 5] = c * u - s * w, s * u + c * w, omega + bias
    return seen


def _displacement(turned: Array, delay: Array, forward: Array, left: Array) -> tuple[Array, Array]:
    """How far a module gets over the delay at a constant twist that turns it by `turned`, in its frame before, m."""
    half = 0.5 * turned
    chord = delay * np.sinc(half / np.pi)
    c, s = chord * np.cos(half), chord * np.sin(half)
    return c * forward - s * left, s * forward + c * left
