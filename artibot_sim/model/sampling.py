"""What sensors see of a rollout at their own instants, compiled: see `windows.KINDS` for the order."""

from __future__ import annotations

import math

from artibot_sim.model.compiled import inlined, kernel
from artibot_sim.model.layout import ACC, BACK, F_L, F_N, F_T, GAMMA, M_M, SAT

TORQUE_SCALE, ARM_X, ARM_Y, DELAY, GYRO_BIAS = 1, 2, 3, 4, 5
"""Places in `sensors.SensorErrors`."""
LAST_LATE = 2
"""The first three kinds are stamped when positions are."""

_ROUNDING = 1e-7
"""Sensor stamps are whole nanoseconds, knots are not."""


@inlined
def hermite_at(q, v, i, c, share, h):
    """Coordinate `c` between rows i and i + 1 by the cubic that its rates give."""
    a, b = v[i, c] * h, v[i + 1, c] * h
    rise = q[i + 1, c] - q[i, c]
    return q[i, c] + share * (a + share * (3.0 * rise - 2.0 * a - b + share * (a + b - 2.0 * rise)))


@inlined
def between(table, i, c, share):
    """Column `c` between rows i and i + 1, linearly."""
    return table[i, c] + share * (table[i + 1, c] - table[i, c])


@inlined
def in_frame(q, v, i, share, h, x, y, sideways):
    """A vector of the map at an instant, forwards or to the left of the front module."""
    yaw = hermite_at(q, v, i, GAMMA, share, h)
    if sideways:
        return math.cos(yaw) * y - math.sin(yaw) * x
    return math.cos(yaw) * x + math.sin(yaw) * y


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


@inlined
def pose_at(q, v, i, c, share, h):
    """x, y or yaw of the front module; before the first row by its velocity there, which turns with it."""
    if share >= 0.0 or i > 0:
        return hermite_at(q, v, i, c, share, h)
    since = share * h
    if c == GAMMA:
        return q[0, GAMMA] + since * v[0, GAMMA]
    sideways = v[0, 0] if c == 1 else -v[0, 1]
    return q[0, c] + since * (v[0, c] + 0.5 * since * v[0, GAMMA] * sideways)


@inlined
def point_at(q, v, i, share, h, sensors, c):
    """x or y of the tracked point."""
    yaw = pose_at(q, v, i, GAMMA, share, h)
    x, y = sensors[ARM_X], sensors[ARM_Y]
    arm = math.sin(yaw) * x + math.cos(yaw) * y if c == 1 else math.cos(yaw) * x - math.sin(yaw) * y
    return pose_at(q, v, i, c, share, h) + arm


@inlined
def seen(q, v, w, h, two, i, share, kind, sensors):
    """One sample of one kind."""
    if kind == 0 or kind == 1:
        return point_at(q, v, i, share, h, sensors, kind)
    if kind == 2:
        return pose_at(q, v, i, GAMMA, share, h)
    if kind == 3:
        if not two:
            return 0.0
        return hermite_at(q, v, i, BACK + GAMMA, share, h) - hermite_at(q, v, i, GAMMA, share, h)
    if kind == 4:
        return between(v, i, GAMMA, share) + sensors[GYRO_BIAS]
    if kind == 5 or kind == 6:
        return in_frame(q, v, i, share, h, between(v, i, 0, share), between(v, i, 1, share), kind == 6)
    if kind == 7 or kind == 8:
        return in_frame(q, v, i, share, h, between(w, i, ACC, share), between(w, i, ACC + 1, share), kind == 8)
    if kind == 9:
        return between(v, i, BACK + GAMMA, share) - between(v, i, GAMMA, share) if two else 0.0
    if kind == 14:
        return sliding(w, i)
    if kind == 15:
        return grip(w, i)
    if kind == 16 or kind == 17:
        return hermite_at(q, v, i, kind - 16, share, h)
    if kind == 18:
        return hermite_at(q, v, i, GAMMA, share, h)
    if kind == 19:
        return between(v, i, GAMMA, share)
    return between(w, i, M_M + kind - 10, share) * sensors[TORQUE_SCALE]


@kernel
def sample(q, v, w, h, rows, two, t, kind, sensors, out):
    """Samples into `out` (m,) from the first `rows` rows, `h` apart; instants past them are left as they are.

    Parameters
    ----------
    q, v, w : array, shape (n, 16), (n, 16), (n, ROW)
        What an integration loop keeps.
    t : array, shape (m,)
        s after the first row.
    kind : array of int, shape (m,)
        Positions in `windows.KINDS`.
    sensors : array, shape (6,)
        `SensorErrors` in their order: a lever arm and a delay of kinds 0 to 2, a bias of kind 4, a scale of kinds 10
        to 13. (The scale of encoders has acted before, on what turned the motors.)
    """
    for k in range(t.shape[0]):
        since = t[k] - sensors[DELAY] if kind[k] <= LAST_LATE else t[k]
        place = (since + _ROUNDING) / h
        i = min(max(int(place), 0), rows - 2)
        share = since / h - i
        if share > 1.0 + 1e-3:
            continue
        out[k] = seen(q, v, w, h, two, i, share, kind[k], sensors)
