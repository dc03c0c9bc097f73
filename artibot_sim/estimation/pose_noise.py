"""Noise of measured poses as a recording itself shows it: a constant, and what stamps that jitter add with speed.

A localisation, a logger that polls and a message that waits put each pose at an instant that is off by a few
hundredths of a second, each time by another. A robot that stands does not notice; one that drives at 1 m/s is seen
elsewhere along its track by as many centimetres, and one that turns heads elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.smoothing import local_fit, rest_of

Array = NDArray[np.float64]

LEAST_JITTER = 0.01
"""s from which stamps are said to jitter; smoothing a curved path leaves as much as less."""
LEAST = 1e-3
"""m and rad that the constants are at least: a robot that stands repeats its pose, whatever that is off by."""
_SURE = 15.0
"""Nats by which a recording must be likelier with jitter than without."""
_FEWEST = 60
"""Samples without which nothing is said."""
_EDGE = 3
"""Samples at either end whose fit is one-sided."""
_LEFT = np.sqrt(2.0 / 3.0)
"""Share of white noise that a cubic through seven even samples leaves over at the middle one."""
_TAILS = 4.0
"""Degrees of freedom of the noise: now and then a pose is far off."""
_CORE = 1.1
"""Standard deviation of the normal distribution whose middle half is as wide as that of such noise of scale 1."""
_RATE_HALF_WIDTH = 0.3
"""s around a sample from which its velocity is taken."""


@dataclass(frozen=True)
class PoseNoise:
    """Noise of poses: independent from one sample to the next, its tails heavier than a normal distribution's.

    Attributes
    ----------
    place : float
        Standard deviation of a coordinate of a robot that stands, m.
    heading : float
        Of its heading, rad; NaN where headings do not come with positions.
    jitter : float
        Standard deviation of the instants that stamps are off by, s; 0 where none shows.
    samples : int
        Positions that it was found from.
    """

    place: float
    heading: float
    jitter: float
    samples: int


@dataclass(frozen=True)
class _Rests:
    """What smooth fits leave over, along and across the track (n,), m, and of headings (m,), rad, with the rates."""

    along: Array
    across: Array
    speed: Array
    turn: Array
    rate: Array


def rates(t: Array, values: Array) -> Array:
    """How fast samples (n, k) at times (n,) change there, (n, k)."""
    return local_fit(t, values, t, _RATE_HALF_WIDTH, degree=1)[1]


def _rests(measured: Measured) -> _Rests | None:
    t, points = measured.position()
    if len(t) <= 2 * _EDGE:
        return None
    inner = slice(_EDGE, len(t) - _EDGE)
    rest = np.column_stack([rest_of(t, column) for column in points.T])[inner] / _LEFT
    velocity = rates(t, points)[inner]
    speed = np.hypot(*velocity.T)
    ahead = velocity / np.maximum(speed, 1e-9)[:, None]
    along, across = (ahead * rest).sum(axis=1), ahead[:, 0] * rest[:, 1] - ahead[:, 1] * rest[:, 0]
    turn = rate = np.empty(0)
    if measured.late_heading:
        when, yaw = measured.yaw()
        if len(when) > 2 * _EDGE:
            inner = slice(_EDGE, len(when) - _EDGE)
            turn, rate = rest_of(when, yaw[:, 0])[inner] / _LEFT, rates(when, yaw)[inner, 0]
    return _Rests(along, across, speed, turn, rate)


def pose_noise(measured: Sequence[Measured]) -> PoseNoise | None:
    """The noise of the poses of one sensor, from all segments in which it measured; None for too few samples.

    Scales are those of the likeliest Student distributions of what smooth fits leave over: across the track the
    constant alone, along it constant and jitter times speed, of headings constant and jitter times yaw rate.
    """
    parts = [rests for one in measured if (rests := _rests(one)) is not None]
    if sum(len(part.along) for part in parts) < _FEWEST:
        return None
    along, across, speed, turn, rate = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("along", "across", "speed", "turn", "rate")
    )
    place, heading = (max(1.4826 * float(np.median(np.abs(x))), LEAST) if len(x) else np.nan for x in (across, turn))

    def cost(x: Array, jitter: float) -> float:
        still = np.hypot(np.exp(x), LEAST)
        found = _cost(across, np.full(len(across), still[0])) + _cost(along, np.hypot(still[0], jitter * speed))
        return found + (_cost(turn, np.hypot(still[1], jitter * rate)) if len(turn) else 0.0)

    first = np.log([place, heading] if len(turn) else [place])
    options = {"xatol": 1e-3, "fatol": 1e-2}
    none = minimize(cost, first, (0.0,), "Nelder-Mead", options=options)
    both = minimize(
        lambda x: cost(x[:-1], float(np.exp(x[-1]))), [*none.x, np.log(0.02)], method="Nelder-Mead", options=options
    )
    jitter = float(np.exp(both.x[-1]))
    shows = none.fun - both.fun > _SURE and _CORE * jitter > LEAST_JITTER
    sizes = _CORE * np.hypot(np.exp(both.x[:-1] if shows else none.x), LEAST)
    return PoseNoise(
        float(sizes[0]), float(sizes[1]) if len(turn) else float("nan"), _CORE * jitter if shows else 0.0, len(along)
    )


def _cost(rest: Array, scale: Array) -> float:
    """Minus the logarithm of a Student distribution's density at `rest` (n,), constants apart."""
    return float(np.sum(np.log(scale) + 0.5 * (_TAILS + 1.0) * np.log1p((rest / scale) ** 2 / _TAILS)))
