"""What sensors see of a rollout at their own instants, compiled: see `windows.KINDS` for the order."""

from __future__ import annotations

import math

from artibot_sim.model.compiled import inlined, kernel
from artibot_sim.model.layout import ACC, BACK, F_L, F_N, F_T, GAMMA, M_M, SAT

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
def seen(q, v, w, h, two, i, share, kind):
    """One sample of one kind."""
    if kind == 0 or kind == 1:
        return hermite_at(q, v, i, kind, share, h)
    if kind == 2:
        return hermite_at(q, v, i, GAMMA, share, h)
    if kind == 3:
        if not two:
            return 0.0
        return hermite_at(q, v, i, BACK + GAMMA, share, h) - hermite_at(q, v, i, GAMMA, share, h)
    if kind == 4:
        return between(v, i, GAMMA, share)
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
    return between(w, i, M_M + kind - 10, share)


@kernel
def sample(q, v, w, h, rows, two, t, kind, out):
    """Samples into `out` (m,) from the first `rows` rows, `h` apart; instants past them are left as they are.

    Parameters
    ----------
    q, v, w : array, shape (n, 16), (n, 16), (n, ROW)
        What an integration loop keeps.
    t : array, shape (m,)
        s after the first row.
    kind : array of int, shape (m,)
        Positions in `windows.KINDS`.
    """
    for k in range(t.shape[0]):
        place = (t[k] + _ROUNDING) / h
        i = min(max(int(place), 0), rows - 2)
        share = t[k] / h - i
        if share > 1.0 + 1e-3:
            continue
        out[k] = seen(q, v, w, h, two, i, share, kind[k])
