"""Lateral forces that lag, where windows start: they remember the way that the wheels came."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment.measured import forward_speed
from artibot_sim.identify.sensing import PAST, Stretch
from artibot_sim.identify.windows import Window
from artibot_sim.model import Robot
from artibot_sim.model.effects.tyre_relaxation import EFFECT, SLOWEST
from artibot_sim.model.layout import BACK, GAMMA, X, Y
from artibot_sim.model.params import params
from artibot_sim.model.sensors import sensor_errors

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SAMPLES = round(6.0 / PAST)
"""So many before a window's start are remembered."""
_NEAR = 0.25
"""s around a start whose motion, in the mean, is the start's: single rates are noisy."""


class Past(NamedTuple):
    """How wheels came to where windows start, as measured.

    Attributes
    ----------
    way : array, shape (windows, m + 1)
        How far away each of m intervals before the start begins, m, the oldest first; 0 at the start.
    aside : array, shape (windows, m, 2, 4)
        By how much each module's lateral velocity (m/s) and turn rate (rad/s) differed in those from what they are
        at the start; last, by how much what the place of the tracked point adds to that velocity did, for a metre
        ahead of the front module's origin and for a metre to its left (m/s).
    """

    way: Array
    aside: Array


def past_of(stretches: Sequence[Stretch], windows: Sequence[Window], arms: tuple[float, float]) -> Past:
    """The way before every window; before a stretch begins all was as it starts. `arms` are l_f and l_b, m."""
    way, aside = np.zeros((len(windows), _SAMPLES + 1)), np.zeros((len(windows), _SAMPLES, 2, 4))
    for i, window in enumerate(windows):
        times, motion = stretches[window.stretch].motion
        last = int(np.searchsorted(times, window.t, side="right"))
        speed, side = _in_modules(motion[max(0, last - _SAMPLES) : last], arms)
        n = len(speed)
        if not n:
            continue
        _, here = _in_modules(motion[np.abs(times - window.t) <= _NEAR], arms)
        side = side - here.mean(axis=0)
        steps = PAST * np.maximum(np.abs(speed), SLOWEST)
        way[i, :] = steps.sum()
        way[i, _SAMPLES - n : -1] = np.cumsum(steps[::-1])[::-1]
        way[i, -1] = 0.0
        aside[i, _SAMPLES - n :] = side
    return Past(way, aside)


def relaxation_length(robot: Robot) -> float:
    """Way over which its tyres' lateral forces build up, m; 0 where they do so at once."""
    return float(robot.effects.get(EFFECT.id, {}).get("length", 0.0))


def time_over(stretch: Stretch, t: float, way: float) -> float:
    """Time from `t` (s) on in which the wheels come so far (m) as lagging forces count it, s."""
    times, motion = stretch.motion
    speed = np.abs(forward_speed(np.nan_to_num(motion[times >= t])))
    return PAST * int(np.searchsorted(np.cumsum(PAST * np.maximum(speed, SLOWEST)), way))


def _in_modules(motion: Array, arms: tuple[float, float]) -> tuple[Array, Array]:
    """Forward speed (n,) of the tracked point; both modules' lateral velocities, turn rates and leverage (n, 2, 4)."""
    motion = np.nan_to_num(motion)
    _, _, yaw, vx, vy, rate, bend, bend_rate = motion.T
    forward, left = forward_speed(motion), np.cos(yaw) * vy - np.sin(yaw) * vx
    c, s, rate_b = np.cos(bend), np.sin(bend), rate + bend_rate
    behind = -s * forward + c * (left - arms[0] * rate) - arms[1] * rate_b
    front = np.column_stack([left, rate, rate, np.zeros_like(rate)])
    return forward, np.stack([front, np.column_stack([behind, rate_b, c * rate, s * rate])], axis=1)


def lagging_forces(robots: Sequence[Robot], robot: Indices, window: Indices, q: Array, v: Array, past: Past) -> Array:
    """Lateral forces (n, 8) at starts q and v (n, 16): what the starts ask for, less what has yet to build up.

    dF/dt = (F_steady − F) |p_x| / length is a mean over the way that the wheel came, the last `length` weighing most.
    """
    found = np.zeros((len(robot), 8))
    for r, one in enumerate(robots):
        rows = np.flatnonzero(robot == r)
        length = relaxation_length(one)
        if not length or not len(rows):
            continue
        p, seen = params(one), sensor_errors(one)
        left = np.exp(-past.way[window[rows]] / length)
        weight = np.diff(left, axis=1)
        weight[:, 0] += left[:, 0]
        behind = np.einsum("wm,wmab->wab", weight, past.aside[window[rows]])
        for module, body in enumerate((p.front, p.back) if one.articulated else (p.front,)):
            b = BACK * module
            c, s = np.cos(q[rows, b + GAMMA]), np.sin(q[rows, b + GAMMA])
            aside = c * v[rows, b + Y] - s * v[rows, b + X] + behind[:, module, 0]
            aside -= seen.arm_x * behind[:, module, 2] + seen.arm_y * behind[:, module, 3]
            sweep = body.half_x * (v[rows, b + GAMMA] + behind[:, module, 1])
            ends = -body.k_t * np.column_stack([aside + sweep, aside - sweep])
            found[rows, 4 * module : 4 * module + 4] = np.tile(ends, 2)
    return found
