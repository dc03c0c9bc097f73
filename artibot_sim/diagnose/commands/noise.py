"""How likely errors of measured motor speeds are: level and colour of the noise as the errors themselves show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from artibot_sim.diagnose.commands.data import LAGS, CommandData
from artibot_sim.estimation.loss import correlation_time
from artibot_sim.experiment.smoothing import noise_of

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FREEDOM = 5.0
"""Degrees of freedom of Student's distribution: tails in which a stamp that went astray weighs little."""
_LEAST = 5e-4
"""Share of the usual speed below which differences are not noise but how both were computed."""
_SOME = 800
"""Samples of a series that tell its noise."""
_FAR = 60
"""Samples back to which whitened errors are looked at for what is still alike."""


@dataclass(frozen=True)
class SpeedNoise:
    """Noise of measured speeds: an autoregression driven by heavy-tailed errors.

    Attributes
    ----------
    sigma : float
        Of what drives it, rad/s.
    colour : array, shape (LAGS,)
        Weights of the errors before.
    thinning : float
        How many samples are worth one, for what the autoregression leaves alike.
    """

    sigma: float
    colour: Array
    thinning: float = 1.0

    def like(self, other: SpeedNoise) -> bool:
        """Whether it is the same to a few per cent."""
        return (
            abs(np.log(self.sigma / other.sigma)) < 0.03
            and float(np.abs(self.colour - other.colour).max()) < 0.03
            and abs(self.thinning - other.thinning) < 0.1
        )

    def whitened(self, data: CommandData, error: Array) -> tuple[Array, Flags]:
        """Errors (n,) less what the ones before foretell, over sigma; and which of them count."""
        return whitened(data, error, self.colour) / self.sigma, data.valid

    def log_likelihood(self, data: CommandData, error: Array, used: Flags | None = None) -> float:
        """Of errors (n,), in nats; `used` leaves some out."""
        scaled, valid = self.whitened(data, error)
        valid = valid if used is None else valid & used
        return float(log_density(scaled[valid]).sum() - valid.sum() * np.log(self.sigma)) / self.thinning

    def weights(self, scaled: Array) -> Array:
        """By which squares of whitened errors count near a solution."""
        return (FREEDOM + 1.0) / (FREEDOM + scaled**2) / self.thinning


def log_density(scaled: Array) -> Array:
    """Logarithm of Student's density."""
    constant = gammaln(0.5 * (FREEDOM + 1.0)) - gammaln(0.5 * FREEDOM) - 0.5 * np.log(FREEDOM * np.pi)
    return np.asarray(constant - 0.5 * (FREEDOM + 1.0) * np.log1p(scaled**2 / FREEDOM))


def whitened(data: CommandData, error: Array, colour: Array) -> Array:
    """Errors (n,) less what the ones before foretell; the first few of a part as they are."""
    rest = error.copy()
    for lag in range(1, LAGS + 1):
        rest[lag:] -= colour[lag - 1] * error[:-lag]
    return rest


def least_noise(data: CommandData) -> float:
    """Noise that is taken at least, rad/s."""
    return _LEAST * float(np.sqrt(np.mean(data.command**2))) + 1e-9


def sensor_noise(data: CommandData) -> SpeedNoise:
    """White noise as neighbouring samples show it: good enough to begin with."""
    levels = [
        noise_of(data.at[mine].mean(axis=1)[:_SOME], data.speed[mine][:_SOME])
        for mine in ((data.recording == r) & (data.motor == m) for r, m in _series(data))
    ]
    known = [level for level in levels if np.isfinite(level)]
    level = float(np.median(known)) if known else 0.1 * float(np.std(data.speed))
    return SpeedNoise(max(level, least_noise(data)), np.zeros(LAGS))


def _series(data: CommandData) -> Sequence[tuple[int, int]]:
    pairs = np.unique(np.column_stack([data.recording, data.motor]), axis=0)
    return [(int(r), int(m)) for r, m in pairs]


def noise_in(data: CommandData, error: Array, used: Flags) -> SpeedNoise:
    """Noise as the errors (n,) of a good prediction show it, from the samples that are `used`."""
    valid = data.valid & used
    if valid.sum() < 20 * LAGS:
        return SpeedNoise(max(_scale(error[data.counts & used]), least_noise(data)), np.zeros(LAGS))
    level = _scale(error[valid])
    calm = np.clip(error, -4.0 * level, 4.0 * level)
    before = np.column_stack([np.concatenate((np.zeros(lag), calm[:-lag])) for lag in range(1, LAGS + 1)])[valid]
    information = before.T @ before + 1e-3 * valid.sum() * level**2 * np.eye(LAGS)
    colour = np.linalg.solve(information, before.T @ calm[valid])
    driven = whitened(data, error, colour)
    sigma = _scale(driven[valid])
    if sigma < least_noise(data):
        return SpeedNoise(least_noise(data), np.zeros(LAGS))
    return SpeedNoise(sigma, colour, _thinning(data, np.where(valid, driven / sigma, 0.0)))


def _scale(error: Array) -> float:
    """Sigma of Student's distribution that fits errors best, by its fixed point."""
    sigma = 1.4826 * float(np.median(np.abs(error))) + 1e-12 if len(error) else 0.0
    for _ in range(20):
        weight = (FREEDOM + 1.0) / (FREEDOM + (error / sigma) ** 2) if sigma > 0.0 else np.ones(len(error))
        sigma = float(np.sqrt(np.mean(weight * error**2))) + 1e-12 if len(error) else 0.0
    return sigma


def _thinning(data: CommandData, scaled: Array) -> float:
    """How many whitened errors (n,) are worth one."""
    calm = np.clip(scaled, -4.0, 4.0)
    power, found = max(float(calm @ calm), 1e-300), [1.0]
    for lag in range(1, min(_FAR, len(calm) // 4)):
        same = (data.recording[lag:] == data.recording[:-lag]) & (data.motor[lag:] == data.motor[:-lag])
        found.append(float((calm[lag:] * calm[:-lag])[same].sum()) / power)
    return correlation_time(np.array(found))
