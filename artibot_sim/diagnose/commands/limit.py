"""A torque limit as the command view shows it: speeds that fall short of the command while the torque is at its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from artibot_sim.diagnose.commands.data import CommandData
from artibot_sim.diagnose.commands.noise import SpeedNoise, log_density
from artibot_sim.experiment.smoothing import noise_of

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_AFTER = 3
"""Samples after one at the limit in which the velocity loop (gain 40 /s) catches up."""
_LEFT = (0.4, 0.3)
"""Share of a shortfall that is left in the next sample, and how sure that is."""
_NEAR = 2.5
"""Noises of the torque within which it is at its limit."""
_SHARE = 0.5
"""Probability beforehand that a motor near the limit is at it."""
_RELATIVE = 0.01
"""Noise of torques relative to them, and of a limit found."""


@dataclass(frozen=True)
class Limit:
    """A limit of the front motors' torque.

    Attributes
    ----------
    torque, sd : float
        N m.
    nats : float
        Gained over errors that are the sensors' alone.
    held : array of bool, shape (n,)
        Samples at the limit, or catching up after.
    """

    torque: float
    sd: float
    nats: float
    held: Flags


def torque_limit(data: CommandData, noise: SpeedNoise, error: Array) -> Limit | None:
    """The limit that explains errors (n,) of predicted speeds (measured − predicted) best; None without torques.

    A motor at the limit falls short of its command, exponentially distributed; elsewhere errors are the sensors'. A
    limit that recorded torques exceed is improbable as Gauss says.
    """
    if not _driven(data):
        return None
    size = np.abs(np.nan_to_num(data.torque))
    top, spread = _top(data, size)
    plain = -error * np.sign(data.torque) > 4.0 * _level(noise, error)
    found = None
    for limit in top + spread * np.linspace(-7.0, 1.5, 18):
        nats, held, at = _at(data, noise, error, size, float(limit), spread)
        if found is None or nats > found.nats:
            found = Limit(*_refined(size, at, plain, spread, float(limit)), nats, held)
    return found


def excluded_limit(data: CommandData, noise: SpeedNoise, error: Array, enough: float) -> float:
    """The torque (N m) such that every limit below it loses `enough` nats; 0 where there is none, or no torques.

    Limits are tried down to half of what was reached: below that they lose more.
    """
    if not _driven(data):
        return 0.0
    size = np.abs(np.nan_to_num(data.torque))
    top, spread = _top(data, size)
    found = 0.0
    for limit in np.linspace(0.5 * top, top, 51):
        if _at(data, noise, error, size, float(limit), spread)[0] > -enough:
            break
        found = float(limit)
    return found


def _driven(data: CommandData) -> bool:
    """Whether torques are known, and any is not nothing."""
    known = np.isfinite(data.torque)
    return bool(known.any()) and float(np.abs(data.torque[known]).max()) > 0.0


def _top(data: CommandData, size: Array) -> tuple[float, float]:
    """The largest torque, N m, and how sure a single one is."""
    top = float(np.sort(size)[-10:].mean()) if len(size) > 50 else float(size.max())
    return top, float(np.hypot(_noise_of_torques(data), _RELATIVE * top))


def _at(
    data: CommandData, noise: SpeedNoise, error: Array, size: Array, limit: float, spread: float
) -> tuple[float, Flags, Flags]:
    """Nats that a limit gains; samples that it explains, and those that are near it."""
    known = np.isfinite(data.torque)
    near = known & (size > limit - _NEAR * spread)
    held, gain = _gain(data, near, -error * np.sign(data.torque), error, _level(noise, error))
    excess = np.maximum((size[known] - limit) / spread - 1.0, 0.0)
    return (gain - 0.5 * float(excess @ excess)) / noise.thinning, held, near


def _refined(size: Array, at: Flags, plain: Flags, spread: float, limit: float) -> tuple[float, float]:
    """The limit as the torques of motors that plainly fall short have it, and its standard deviation."""
    rows = at & plain
    count = int(rows.sum())
    if count < 5:
        return limit, spread
    middle = float(np.median(size[rows]))
    return middle, float(np.hypot(1.25 * spread / np.sqrt(count), _RELATIVE * middle))


def _gain(data: CommandData, at: Flags, short: Array, error: Array, sigma: float) -> tuple[Flags, float]:
    """Which samples a limit explains, and the log-likelihood that it gains there."""
    usual = log_density(error / sigma) - np.log(sigma)
    mean = max(float(np.mean(np.maximum(short[at], 0.0))) if at.any() else 0.0, 3.0 * sigma)
    falls = _exponential(short, mean, sigma)
    gains = np.where(at, np.logaddexp(np.log(_SHARE) + falls, np.log(1.0 - _SHARE) + usual) - usual, 0.0)
    after = np.zeros(len(at), bool)
    before = at
    for _ in range(_AFTER):
        follows = np.concatenate(([False], before[:-1])) & data.whole[:, 0] & ~at & ~after
        last = np.concatenate(([0.0], error[:-1]))
        width = np.hypot(sigma, _LEFT[1] * np.abs(last))
        catching = -0.5 * ((error - _LEFT[0] * last) / width) ** 2 - np.log(width) - 0.5 * np.log(2.0 * np.pi)
        better = np.logaddexp(np.log(_SHARE) + catching, np.log(1.0 - _SHARE) + usual) - usual
        gains = np.where(follows, better, gains)
        after |= follows
        before = follows
    return at | after, float(gains[data.counts].sum())


def _exponential(short: Array, mean: float, sigma: float) -> Array:
    """Log-density of an exponential shortfall with Gaussian noise on it."""
    z = short / sigma - sigma / mean
    return np.asarray(-np.log(mean) - short / mean + 0.5 * (sigma / mean) ** 2 + log_ndtr(z))


def _noise_of_torques(data: CommandData) -> float:
    levels = []
    for r, m in np.unique(np.column_stack([data.recording, data.motor]), axis=0).tolist():
        mine = (data.recording == r) & (data.motor == m) & np.isfinite(data.torque)
        levels.append(noise_of(data.at[mine].mean(axis=1)[:800], data.torque[mine][:800]))
    known = [level for level in levels if np.isfinite(level)]
    return max(float(np.median(known)) if known else 0.02, 2e-3)


def _level(noise: SpeedNoise, error: Array) -> float:
    """Noise of a single error, its colour included, rad/s."""
    return max(noise.sigma, 1.4826 * float(np.median(np.abs(error)))) if np.any(noise.colour) else noise.sigma
