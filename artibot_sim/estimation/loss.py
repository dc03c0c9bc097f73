"""How much a residual counts: Huber's function for samples, and again for a window's whole channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation import kernels
from artibot_sim.estimation.kernels import WindowSamples
from artibot_sim.estimation.windows import CHANNEL_NAMES, Window

Array = NDArray[np.float64]

SAMPLE_BEND = 2.5
"""Residual, in units of the inflated noise, from which a sample counts by its size instead of its square."""
BLOCK_BEND = 2.0
"""Mean square, in the same units, from which a window's whole channel does, as long as the fit is rough."""
FIRM_BEND = 4.0
"""Excess of a window's channel over what noise gives, in standard deviations of that, from which it counts by its
logarithm in the end. A wheel that all but breaks away, and in the model does, is no evidence for another soil."""
_LAGS = 60
"""Samples of lag up to which autocorrelations are summed, at most."""
_FEWEST = 12
"""Samples of a window, without which their autocorrelation is not asked for."""
_UNEXPLAINED = 3.0
"""Power of a window's residuals, in that of the window in the middle, from which they say nothing of the noise."""


@dataclass(frozen=True)
class Loss:
    """A robust sum of squares.

    Attributes
    ----------
    inflation : float
        One factor on all noise levels. It starts large and falls to 1, in common: one of its own for each channel
        would let the well-fitted channel hold the soil.
    thinning : array, shape (channels,)
        How many samples of a channel are worth one, because neighbours err alike.
    firm : bool
        Whether windows' channels that are not explained lose nearly all their influence. From the start that would
        trap the fit.
    """

    inflation: float
    thinning: Array
    firm: bool = False

    def totals(self, of: WindowSamples, residuals: Array) -> Array:
        """Loss of each window, shape (sets, windows), of several sets of residuals (sets, n)."""
        count, total = self._blocks(of, residuals)
        loss, _ = _firm(count, total) if self.firm else _rough(count, total)
        return np.asarray(loss.sum(axis=-1), float)

    def weights(self, of: WindowSamples, residuals: Array) -> Array:
        """Weights (n,) for the squares of residuals (n,)."""
        count, total = self._blocks(of, residuals[None])
        _, share = _firm(count, total[0]) if self.firm else _rough(count, total[0])
        found = np.empty(len(residuals))
        factor = share / self.thinning / self.inflation**2
        kernels.sample_weights(of, residuals, self.inflation, SAMPLE_BEND, factor, found)
        return found

    def _blocks(self, of: WindowSamples, residuals: Array) -> tuple[Array, Array]:
        """How many samples each window's channels are worth (w, channels), and their losses (sets, w, channels)."""
        total = np.empty((len(residuals), of.windows, len(CHANNEL_NAMES)))
        kernels.block_sums(of, residuals, self.inflation, SAMPLE_BEND, total)
        return of.counts / self.thinning, total / self.thinning


def _rough(count: Array, total: Array) -> tuple[Array, Array]:
    """Loss and slope of blocks: square roots of what is more than BLOCK_BEND times their counts."""
    allowed = BLOCK_BEND * np.maximum(count, 1.0)
    bent = np.maximum(total, allowed)
    return np.minimum(total, 2.0 * np.sqrt(allowed * bent) - allowed), np.sqrt(allowed / bent)


def _firm(count: Array, total: Array) -> tuple[Array, Array]:
    """Loss and slope of blocks: logarithms of what noise does not explain."""
    sd = np.sqrt(2.0 * np.maximum(count, 1.0))
    allowed, scale = count + FIRM_BEND * sd, 2.0 * sd
    excess = np.maximum(total - allowed, 0.0) / scale
    return np.minimum(total, allowed) + scale * np.log1p(excess), 1.0 / (1.0 + excess)


def spread(windows: Sequence[Window], residuals: Sequence[Array]) -> float:
    """A common inflation with which most windows' channels are within their noise (at least 1)."""
    means = [
        float(np.median(r[w.channel == c] ** 2)) / 0.455
        for w, r in zip(windows, residuals, strict=True)
        for c in np.unique(w.channel)
    ]
    return float(max(1.0, np.sqrt(np.median(means)))) if means else 1.0


def channel_levels(windows: Sequence[Window], residuals: Sequence[Array]) -> dict[str, float]:
    """Residuals of each channel over its noise: the median over windows of their medians, as standard deviations."""
    found: dict[str, list[float]] = {}
    for w, r in zip(windows, residuals, strict=True):
        for c in np.unique(w.channel):
            found.setdefault(CHANNEL_NAMES[c], []).append(1.4826 * float(np.median(np.abs(r[w.channel == c]))))
    return {name: float(np.median(values)) for name, values in found.items()}


def thinning(windows: Sequence[Window], residuals: Sequence[Array]) -> Array:
    """How many samples of each channel are worth one: the autocorrelation time of its residuals, in samples.

    A continuous function of the residuals: fits that end close to each other weigh their samples alike. Windows with
    more than the usual power are not explained yet, and their errors are no noise: they count the less the more they
    have of it, and from `_UNEXPLAINED` on not at all.
    """
    factor = np.ones(len(CHANNEL_NAMES))
    for c in range(len(CHANNEL_NAMES)):
        kinds = [(w, r, kind) for w, r in zip(windows, residuals, strict=True) for kind in _kinds(w, c)]
        parts = [np.clip(r[w.plan.kind == kind], -4.0, 4.0) for w, r, kind in kinds]
        if parts := [part for part in parts if len(part) >= _FEWEST]:
            factor[c] = _correlation_time(parts)
    return factor


def _kinds(window: Window, channel: int) -> Array:
    """What is sampled of a channel in a window."""
    return np.unique(window.plan.kind[window.channel == channel])


def _correlation_time(parts: Sequence[Array]) -> float:
    """1 + 2 Σ autocorrelation of series with weights of their own, see `correlation_time`."""
    power = np.array([float(part @ part) / len(part) for part in parts])
    usual = max(float(np.median(power)), 1e-300)
    weight = np.maximum(0.0, 1.0 - (power / (_UNEXPLAINED * usual)) ** 2) ** 2  # Tukey's biweight
    found = [1.0]
    for lag in range(1, min(_LAGS, int(np.median([len(part) for part in parts])) // 2)):
        long = [(w, part) for w, part in zip(weight, parts, strict=True) if len(part) > 2 * lag]
        whole = sum(w * float(part @ part) for w, part in long)
        found.append(sum(w * float(part[lag:] @ part[:-lag]) for w, part in long) / max(whole, 1e-300))
    return correlation_time(np.array(found))


def correlation_time(autocorrelation: Array) -> float:
    """How many samples are worth one, of their autocorrelation at lags 0, 1, 2, …: at least 1.

    Geyer's initial monotone sequence (1992), as in Stan: sums of two neighbouring lags, each at most as large as those
    before it and none negative. What is added past the place where they vanish vanishes with them, so that there is no
    lag at which the estimate jumps.
    """
    even = autocorrelation[: len(autocorrelation) // 2 * 2]
    pairs = np.minimum.accumulate(np.maximum(even.reshape(-1, 2).sum(axis=1), 0.0))
    return max(1.0, 2.0 * float(pairs.sum()) - 1.0)


def merged(levels: Mapping[str, float]) -> Array:
    """Levels by channel as an array in the order of CHANNEL_NAMES, 1 where a channel is absent."""
    return np.array([levels.get(name, 1.0) for name in CHANNEL_NAMES])
