"""Where a sampled position has a kink, its speed jumps; it is fitted on either side and not across.

A smooth fit across makes a ramp of the jump, a tenth of a second long. Slip is a small difference of large speeds: the
wheel then slides where it held, or holds where it slid.
"""

from __future__ import annotations

import numpy as np

from artibot_sim.experiment.columns import Floats
from artibot_sim.experiment.local_fit import local_fit, noise_in, rest_of

_CLEAR = 8.0
"""What a smooth fit leaves over, in standard deviations of the noise, from which it is a kink."""
_LEAST = 0.03
"""The smallest jump that is looked for, as a share of the largest speed."""
_SAMPLES = 7
"""That a side needs at least: kinks closer to each other are taken as one."""
_LEFT_OVER = 2.0 / 7.0
"""Of the jump times the sample period: what a cubic through a kink and three samples on either side leaves there."""
_DEGREE = 2
"""Of the fit that ends at a kink: the slope of a cubic at its own end is mostly noise."""


def kinks(t: Floats, y: Floats) -> Floats:
    """Times at which the rate of samples (n,) jumps, s, increasing; `t` (n,) are theirs."""
    if len(t) < 4 * _SAMPLES:
        return np.empty(0)
    rest, period = rest_of(t, y), float(np.median(np.diff(t)))
    jump = np.abs(rest) / (_LEFT_OVER * period)
    rate = np.abs(np.diff(y)) / np.maximum(np.diff(t), 1e-9)
    noise = _CLEAR * noise_in(rest) / (_LEFT_OVER * period)
    least = max(noise, _LEAST * float(np.quantile(rate, 0.95)))
    return np.array([_place(t, y, i) for i in _peaks(jump, least)])


def _peaks(size: Floats, least: float) -> list[int]:
    """Places of the largest values above `least`, each far enough from the next and from the ends."""
    found: list[int] = []
    for i in np.argsort(-size).tolist():
        if size[i] <= least:
            break
        if _SAMPLES <= i < len(size) - _SAMPLES and all(abs(i - other) > _SAMPLES for other in found):
            found.append(i)
    return sorted(found)


def _place(t: Floats, y: Floats, near: int) -> float:
    """Where the curves on both sides meet, s: of the samples around `near` the border that leaves least over."""
    best, place = np.inf, float(t[near])
    for first in range(near - 2, near + 3):  # the first sample behind the border
        sides = [slice(max(0, first - _SAMPLES), first), slice(first, first + _SAMPLES)]
        fits = [np.polyfit(t[side] - t[first], y[side], _DEGREE) for side in sides]
        rests = [np.polyval(fit, t[side] - t[first]) - y[side] for fit, side in zip(fits, sides, strict=True)]
        left = float(sum(rest @ rest for rest in rests))
        if left < best:
            best, (before, after) = left, fits
            gap, rate = float(before[-1] - after[-1]), float(after[-2] - before[-2])
            meet = gap / rate if rate else 0.0
            place = float(t[first] + np.clip(meet, t[first - 1] - t[first], 0.0))
    return place


def fit_beside(t: Floats, y: Floats, at: Floats, half_width: float) -> tuple[Floats, Floats]:
    """A local fit's values and rates (m,): of samples on both sides where no kink is near, of one side where one is.

    Parameters
    ----------
    t, y : (n,) samples.
    at : (m,) times wanted, s.
    half_width : of the fit, s.
    """
    value, rate = local_fit(t, y, at, half_width)
    places = kinks(t, y)
    if not len(places):
        return value, rate
    edges = np.concatenate(([-np.inf], places, [np.inf]))
    away = np.abs(at[:, None] - places).min(axis=1)
    for a, b in zip(edges, edges[1:], strict=False):
        own, mine = (t > a) & (t <= b), (at > a) & (at <= b) & (away <= half_width)
        if own.any() and mine.any():
            value[mine], rate[mine] = local_fit(t[own], y[own], at[mine], half_width, _DEGREE, _SAMPLES)
    return value, rate
