"""What sensors see of a rollout at their own instants, compiled: see `window_inputs.KINDS` for the order.

A rollout's rows stand in one flat array, whether it ran alone or side by side with others (`lanes`): column c of row i
of lane e at ``rows[(i * COLUMNS + c) * lanes + e]``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.kernels.compilation import inlined, kernel
from artibot_sim.model.kernels.elementary import cubic_at, cubic_between, sincos
from artibot_sim.model.kernels.layout import ACC, BACK, F_L, F_N, F_T, GAMMA, M_M, SAT, X, Y

POSE_AT, YAW_AT, YAW_BACK_AT, SPEED_AT, TURN_AT, TURN_BACK_AT, PUSH_AT, TORQUE_AT, SLIDING_AT, GRIP_AT = map(
    np.int64, (0, 2, 3, 4, 6, 7, 8, 10, 14, 15)
)
"""Columns: x, y and yaw of the front module, yaw of the back one; their rates; acceleration along x and y of the front
module's origin in `map`; torques of the four motors; which wheels slide, and the largest share that one holds. (Not
Python's integers, for each of whose values numba would compile every function anew.)"""

COLUMNS = 16

ENCODER_SCALE, TORQUE_SCALE, ARM_X, ARM_Y, DELAY, GYRO_BIAS, HEADING, VELOCITY_FILTER = range(8)
"""Places in `sensors.SensorErrors`."""
LAST_LATE = 2
"""The first three kinds are stamped when positions are."""

_ROUNDING = 1e-7
"""Sensor stamps are whole nanoseconds, knots are not."""


@inlined
def sliding(w, i):
    """Which wheels slide at a row: bit k for wheel k."""
    bits = 0.0
    for k in range(8):
        bits += w[i, SAT + k] * 2.0**k
    return bits


@inlined
def grip(w, i):
    """Largest share of its normal force that a wheel holds at a row; 0 where all slide."""
    most = 0.0
    for k in range(8):
        F_n = w[i, F_N + k]
        if w[i, SAT + k] == 0.0 and F_n > 0.0:
            most = max(most, math.hypot(w[i, F_L + k], w[i, F_T + k]) / F_n)
    return most


@kernel
def gather(q, v, w, count, rows):
    """`count` rows that an integration loop keeps, of shape (n, 16), (n, 16) and (n, ROW), as `rows`."""
    for i in range(count):
        o = i * COLUMNS
        for j, c in enumerate((X, Y, GAMMA, BACK + GAMMA)):
            rows[o + POSE_AT + j], rows[o + SPEED_AT + j] = q[i, c], v[i, c]
        rows[o + PUSH_AT], rows[o + PUSH_AT + 1] = w[i, ACC + X], w[i, ACC + Y]
        for motor in range(4):
            rows[o + TORQUE_AT + motor] = w[i, M_M + motor]
        rows[o + SLIDING_AT], rows[o + GRIP_AT] = sliding(w, i), grip(w, i)


@inlined
def hermite_at(rows, at, lanes, c, rate, share, h):
    """Column `c` between two rows by the cubic that the rates in column `rate` give; `at` is the first one's lane."""
    i, j, d_i, d_j = at + c * lanes, at + (COLUMNS + c) * lanes, at + rate * lanes, at + (COLUMNS + rate) * lanes
    rate_h = rows[d_i] * h
    c_2, c_3 = cubic_between(rows[i], rows[j], rate_h, rows[d_j] * h, 1.0)
    return cubic_at(rows[i], rate_h, c_2, c_3, share)[0]


@inlined
def between(rows, at, lanes, c, share):
    """Column `c` between two rows, linearly."""
    first = rows[at + c * lanes]
    return first + share * (rows[at + (COLUMNS + c) * lanes] - first)


@inlined
def in_frame(rows, at, lanes, c, share, h, sideways):
    """The vector of `map` in columns `c` and c + 1 at an instant, forwards or to the left of the front module."""
    s_g, c_g = sincos(hermite_at(rows, at, lanes, YAW_AT, TURN_AT, share, h))
    x, y = between(rows, at, lanes, c, share), between(rows, at, lanes, c + 1, share)
    return c_g * y - s_g * x if sideways else c_g * x + s_g * y


@inlined
def pose_at(rows, at, lanes, c, share, h):
    """x, y or yaw of the front module; before the first row by its velocity there, which turns with it."""
    if share >= 0.0:
        return hermite_at(rows, at, lanes, POSE_AT + c, SPEED_AT + c, share, h)
    since, rates = share * h, at + SPEED_AT * lanes
    value, rate = rows[at + (POSE_AT + c) * lanes], rows[rates + c * lanes]
    if c == 2:
        return value + since * rate
    sideways = rows[rates] if c == 1 else -rows[rates + lanes]
    return value + since * (rate + 0.5 * since * rows[rates + 2 * lanes] * sideways)


@inlined
def point_at(rows, at, lanes, c, share, h, sensors, r):
    """x or y of the tracked point."""
    place, x, y = pose_at(rows, at, lanes, c, share, h), sensors[r, ARM_X], sensors[r, ARM_Y]
    if x == 0.0 and y == 0.0:
        return place
    s_g, c_g = sincos(pose_at(rows, at, lanes, 2, share, h))
    return place + (s_g * x + c_g * y if c == 1 else c_g * x - s_g * y)


@inlined
def sensor_value(rows, at, lanes, h, two, share, kind, sensors, r):
    """One sample of one kind."""
    if kind <= 1:
        return point_at(rows, at, lanes, kind, share, h, sensors, r)
    if kind == 2:
        return pose_at(rows, at, lanes, kind, share, h) + sensors[r, HEADING]
    if kind == 3:
        front = hermite_at(rows, at, lanes, YAW_AT, TURN_AT, share, h)
        return hermite_at(rows, at, lanes, YAW_BACK_AT, TURN_BACK_AT, share, h) - front if two else 0.0
    if kind == 4:
        return between(rows, at, lanes, TURN_AT, share) + sensors[r, GYRO_BIAS]
    if kind == 5 or kind == 6:
        return in_frame(rows, at, lanes, SPEED_AT, share, h, kind == 6)
    if kind == 7 or kind == 8:
        return in_frame(rows, at, lanes, PUSH_AT, share, h, kind == 8)
    if kind == 9:
        front = between(rows, at, lanes, TURN_AT, share)
        return between(rows, at, lanes, TURN_BACK_AT, share) - front if two else 0.0
    if kind == 14 or kind == 15:
        return rows[at + kind * lanes]
    if kind >= 16 and kind <= 18:
        return hermite_at(rows, at, lanes, POSE_AT + kind - 16, SPEED_AT + kind - 16, share, h)
    if kind == 19:
        return between(rows, at, lanes, TURN_AT, share)
    return between(rows, at, lanes, kind, share) * sensors[r, TORQUE_SCALE]


class LaneRows(NamedTuple):
    """The `kept` rows, `h` (s) apart, of a `lane` of so many, whose rover has `two` modules or one."""

    rows: NDArray[np.float64]
    lane: int
    lanes: int
    h: float
    kept: int
    two: bool


class Wanted(NamedTuple):
    """Samples `first` to `last` of (t, kind), see `sample`."""

    t: NDArray[np.float64]
    kind: NDArray[np.int64]
    first: int
    last: int


@inlined
def sample_lane(of, wanted, sensors, r, out, to):
    """What is `wanted` of a lane's rows into `out` from place `to` on; instants past them are left as they are.

    `sensors` are as in `sample`, in row `r`.
    """
    t, kind, first, last = wanted
    for k in range(first, last):
        since = t[k] - sensors[r, DELAY] if kind[k] <= LAST_LATE else t[k]
        i = min(max(int((since + _ROUNDING) / of.h), 0), of.kept - 2)
        share = since / of.h - i
        if share <= 1.0 + 1e-3:
            out[to + k - first] = sensor_value(
                of.rows, i * COLUMNS * of.lanes + of.lane, of.lanes, of.h, of.two, share, kind[k], sensors, r
            )


@kernel
def sample(rows, h, count, two, t, kind, sensors, r, out):
    """Samples into `out` (m,) from the first `count` rows of a rollout that ran alone.

    Parameters
    ----------
    t : array, shape (m,)
        s after the first row.
    kind : array of int, shape (m,)
        Positions in `window_inputs.KINDS`.
    sensors : array, shape (robots, 8)
        `SensorErrors` in their order, in row `r`: a lever arm of kinds 0 and 1, a delay of kinds 0 to 2, an offset of
        kind 2, a bias of kind 4, a scale of kinds 10 to 13. (Scale and low-pass of encoders have acted before, on
        what turned the motors.)
    """
    sample_lane(LaneRows(rows, 0, 1, h, count, two), Wanted(t, kind, 0, t.shape[0]), sensors, r, out, 0)
