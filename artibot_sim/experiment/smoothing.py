"""Local polynomials through irregular samples: values, rates and noise, with kinks where a speed jumps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from artibot_sim.experiment.columns import Floats

# ----------------------------------------------------------------------
# Local polynomials through irregular samples: values and rates from noisy measurements, and how noisy they are.
# ----------------------------------------------------------------------


HELD, HELD_TIMES = 4, 3.0
"""Equal samples in a row, at most, that count as one sample and its repetitions, and the same in times of the usual
number of repetitions; more are a standstill. A message that comes late or is lost makes a run longer."""
_USUAL = 20
"""Runs of equal samples that show how many are usual."""
STAMP = 1e-6
"""s that a stamp and a border may differ by and still be the same instant: sums of seconds round by their last bit."""
_BLOCK = 8192
"""Instants that are fitted at once."""
_NOISE_SAMPLES = 7
"""Samples of the cubic whose rest shows white noise."""
_FEWEST = 15
"""Samples without which nothing is said of noise."""
_NOISE_LEVERAGE = 7.0 / 21.0  # weight of the middle one of seven even samples in a cubic's value there
_WIDTHS = (5, 7, 9, 11, 15, 21, 31, 41)
"""Samples through which cubics are tried, from narrow to wide."""
_APART = (5, 11)
"""Samples of the two cubics by which white noise is told from motion."""
_TELLING = 100
"""Samples without which white noise is not told from motion: its variance is known to a quarter from so many, and to a
half from the 20 of a segment of 2 s, for half of which the widest cubics were taken."""


def local_fit(
    t: ArrayLike, y: ArrayLike, at: ArrayLike, half_width: float, degree: int = 3, least: int | None = None
) -> tuple[Floats, Floats]:
    """Fit a polynomial to the samples around each time, and return its value and its rate there.

    Parameters
    ----------
    t : (n,) times of the samples, s, increasing.
    y : (n,) or (n, k) samples.
    at : (m,) times wanted, s.
    half_width : samples up to this far before and after are used, s.
    degree : of the polynomial; less where there are not enough samples.
    least : fewest samples to fit (default 2·degree + 1); the neighbourhood grows for them, to one side at the ends.

    Returns
    -------
    (m,) or (m, k) values, and rates per s
        NaN if there is no sample at all; a rate of 0 if there is only one.
    """
    times, wanted, samples = np.asarray(t, float), np.asarray(at, float), np.asarray(y, float)
    shape = (len(wanted), *samples.shape[1:])
    count = len(times)
    if not count:
        return np.full(shape, np.nan), np.full(shape, np.nan)
    table = samples.reshape(count, -1)
    value, rate = np.empty((2, len(wanted), table.shape[1]))
    order = min(degree, count - 1)
    fewest = min(count, 2 * degree + 1 if least is None else least)
    low, high = _neighbourhoods(times, wanted, half_width, fewest)
    for k in range(0, len(wanted), _BLOCK):
        part = slice(k, k + _BLOCK)
        value[part], rate[part] = _fit(times, table, wanted[part], low[part], high[part], order)
    return value.reshape(shape), rate.reshape(shape)


def _neighbourhoods(t: Floats, at: Floats, half_width: float, fewest: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the one past the last sample to use at each time."""
    low = np.searchsorted(t, at - half_width - STAMP, side="left")
    high = np.searchsorted(t, at + half_width + STAMP, side="right")
    size = np.maximum(high - low, fewest)
    low = np.maximum(low - (size - (high - low) + 1) // 2, 0)
    high = np.minimum(low + size, len(t))
    return np.maximum(high - size, 0), high


def _fit(t: Floats, table: Floats, at: Floats, low: np.ndarray, high: np.ndarray, order: int) -> tuple[Floats, Floats]:
    """Solve all the least squares at once: gather each neighbourhood into a row, with weight 0 past its end."""
    index = low[:, None] + np.arange(int((high - low).max()))
    weight = (index < high[:, None]).astype(float)
    index = np.minimum(index, len(t) - 1)
    since = t[index] - at[:, None]
    scale = np.maximum((np.abs(since) * weight).max(axis=1), 1e-9)
    powers = (since / scale[:, None])[..., None] ** np.arange(order + 1) * weight[..., None]
    offset = table[low]  # large values with small changes keep their digits
    change = (table[index] - offset[:, None]) * weight[..., None]
    q, r = np.linalg.qr(powers)
    solved = np.linalg.solve(r + 1e-300 * np.eye(order + 1), np.einsum("mij,mik->mjk", q, change))
    slope = solved[:, 1] / scale[:, None] if order else np.zeros_like(offset)
    return offset + solved[:, 0], slope


def fresh(y: ArrayLike) -> np.ndarray:
    """Say which samples (n,) or (n, k) are new: False for one that merely repeats the one before.

    A recorder that samples faster than the sensor measures holds values; held ones would look like a staircase.
    More equal ones in a row than `HELD` and `HELD_TIMES` the usual are a standstill, and all of them are new. What is
    usual shows in a whole recording, not in a second of it.
    """
    samples = np.asarray(y, float)
    if len(samples) < 2:
        return np.ones(len(samples), bool)
    table = samples.reshape(len(samples), -1)
    repeats = np.concatenate(([False], (table[1:] == table[:-1]).all(axis=1)))
    run = np.cumsum(~repeats) - 1
    length = np.bincount(run)
    usual = float(np.median(length)) if len(length) >= _USUAL else 1.0
    return ~repeats | (length[run] > max(HELD, HELD_TIMES * usual))


def noise_of(t: ArrayLike, y: ArrayLike) -> float:
    """Estimate the standard deviation of the noise in samples (n,) of something smooth.

    It is what a cubic through each sample and the three on either side leaves over (a high-pass that motion
    slower than some five sample periods does not pass), by its median, so outliers and brief events do not count.
    Noise that is correlated over such times passes unseen. Held samples are left out.

    Returns
    -------
    float
        In the unit of `y`; NaN for fewer than 15 samples.
    """
    times, samples = np.asarray(t, float), np.asarray(y, float)
    used = np.isfinite(samples)
    times, samples = times[used], samples[used]
    new = fresh(samples)
    times, samples = times[new], samples[new]
    return noise_in(rest_of(times, samples)) if len(times) >= _FEWEST else float("nan")


def rest_of(t: Floats, y: Floats) -> Floats:
    """What a cubic through each sample (n,) and the three on either side leaves over."""
    value, _ = local_fit(t, y, t, 0.0, least=_NOISE_SAMPLES)
    return np.asarray(y - value, float)


def noise_in(rest: Floats) -> float:
    """The standard deviation of noise that leaves `rest` (n,), see `rest_of`; NaN for fewer than 15 samples."""
    if len(rest) < _FEWEST:
        return float("nan")
    left = np.abs(rest[3:-3])
    left = left[left > 0]
    if not len(left):
        return 0.0
    return float(1.4826 * np.median(left) / np.sqrt(1.0 - _NOISE_LEVERAGE))


def smoothed(t: Floats, y: Floats) -> Floats:
    """Samples (n,) of something smooth with less of their white noise: local cubics, as wide as these samples allow.

    The width is that of least estimated risk (Mallows' C_p): the mean square of what cubics leave over, and what their
    noise adds. Samples without white noise, or with changes that no cubic follows, and short pieces of a recording stay
    as they are.
    """
    moving = y != 0.0  # what stands is silent
    if moving.sum() < _TELLING:
        return y
    fits = {count: local_fit(t, y, t, 0.0, least=count)[0] for count in _APART}
    noise = _white_variance({count: (y - value)[moving] for count, value in fits.items()})
    best, least = y, 2.0 * noise
    for count in _WIDTHS if noise else ():
        value = fits[count] if count in fits else local_fit(t, y, t, 0.0, least=count)[0]
        risk = float(np.mean((y - value) ** 2)) + 2.0 * noise * (1.0 - _passed(count)[0])
        if risk >= least:
            break
        best, least = value, risk
    return best


def _white_variance(rests: Mapping[int, Floats]) -> float:
    """Variance of white noise of which cubics through so many samples leave these `rests`; 0 where they are motion.

    A narrow and a wide cubic leave nearly as much of white noise and not of a random walk. The wheels of a Warthog on
    asphalt waver as a random walk up to 10 Hz, and its gyroscope shows it.
    """
    left = [1.4826 * float(np.median(np.abs(rest))) for rest in rests.values()]
    white, _ = np.linalg.solve([_passed(count) for count in rests], np.square(left))
    return max(float(white), 0.0)


def _passed(count: int) -> tuple[float, float]:
    """Variances at the middle of `count` even samples that a cubic leaves of white noise and of a random walk of 1."""
    powers = np.vander(np.arange(count) - count // 2, 4)
    rest = -(powers @ np.linalg.pinv(powers))[count // 2]
    rest[count // 2] += 1.0
    return float(rest @ rest), float(np.sum(np.cumsum(rest)[:-1] ** 2))


def bridge(t: Floats, at: Floats, value: Floats, rate: Floats, gap: float) -> tuple[Floats, Floats]:
    """Replace fitted values and rates (m, k) where there are no samples to fit.

    Parameters
    ----------
    t : (n,) times of the samples, s; n ≥ 1.
    at : (m,) times, s, increasing, evenly spaced enough to have one near each end of a gap.
    value, rate : fits there.
    gap : longest distance of samples that still counts as sampled, s.

    Returns
    -------
    value, rate
        The cubic that meets both ends inside a gap; before the first and after the last sample the rate is held.
    """
    value, rate = value.copy(), rate.copy()
    breaks = np.flatnonzero(np.diff(t) > gap)
    for a, b in zip(t[breaks], t[breaks + 1], strict=True):
        inside = np.flatnonzero((at > a + STAMP) & (at < b - STAMP))
        if not len(inside) or inside[0] == 0 or inside[-1] == len(at) - 1:
            continue
        i, j = inside[0] - 1, inside[-1] + 1
        value[inside], rate[inside] = hermite(at[i], at[j], value[i], value[j], rate[i], rate[j], at[inside])
    for outside, edge in (
        (at < t[0] - STAMP, np.searchsorted(at, t[0] - STAMP)),
        (at > t[-1] + STAMP, np.searchsorted(at, t[-1] + STAMP, "right") - 1),
    ):
        edge = int(np.clip(edge, 0, len(at) - 1))
        rate[outside] = rate[edge]
        value[outside] = value[edge] + (at[outside] - at[edge])[:, None] * rate[edge]
    return value, rate


def hermite(
    t0: Floats | float, t1: Floats | float, p0: Floats, p1: Floats, v0: Floats, v1: Floats, at: Floats
) -> tuple[Floats, Floats]:
    """Return value and rate, (m, k), of the cubic from (t0, p0, v0) to (t1, p1, v1) at times (m,)."""
    start, h = np.reshape(t0, (-1, 1)), np.reshape(np.subtract(t1, t0), (-1, 1))
    s = (at[:, None] - start) / h
    rise = (p1 - p0) / h
    value = p0 + h * s * (v0 + s * (3 * rise - 2 * v0 - v1 + s * (v0 + v1 - 2 * rise)))
    rate = v0 + s * (2 * (3 * rise - 2 * v0 - v1) + s * 3 * (v0 + v1 - 2 * rise))
    return value, rate


# ----------------------------------------------------------------------
# Where a sampled position has a kink, its speed jumps; it is fitted on either side and not across.
#
# A smooth fit across makes a ramp of the jump, a tenth of a second long. Slip is a small difference of large
# speeds: the wheel then slides where it held, or holds where it slid.
# ----------------------------------------------------------------------


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


def fit_around_kinks(t: Floats, y: Floats, at: Floats, half_width: float) -> tuple[Floats, Floats]:
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
    edges = np.concatenate(([-np.inf], places + STAMP, [np.inf]))
    away = np.abs(at[:, None] - places).min(axis=1)
    for a, b in zip(edges, edges[1:], strict=False):
        own, mine = (t > a) & (t <= b), (at > a) & (at <= b) & (away <= half_width + STAMP)
        if own.any() and mine.any():
            value[mine], rate[mine] = local_fit(t[own], y[own], at[mine], half_width, _DEGREE, _SAMPLES)
    return value, rate
