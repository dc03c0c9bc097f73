"""A torque limit as the command view shows it: speeds that fall short of the command while the torque is at its end.

The limit is the same at any speed (`torque_limit`), or falls with it along a line (`battery_sag`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from artibot_sim.diagnose.commands.data import CommandData
from artibot_sim.diagnose.commands.noise import SpeedNoise, log_density
from artibot_sim.experiment.smoothing import noise_of
from artibot_sim.model.effects import Values

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

LIMIT, SAG = "torque_limit", "battery_sag"
"""Effects that limit the front motors' torques, by id."""
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
_UNKNOWN = 0.05
"""Noise of torques relative to them where too few samples tell it."""
_SLOPES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.3, 1.7, 2.3, 3.0, 4.0)
"""Slopes that are tried, over that of a line on which the largest torque is lost at the fastest speed. The last is for
limits reached at high speeds only: four fifths of the torque at rest are lost there. Steeper is a ceiling of speeds."""
_FINER = (0.5, 0.25)
"""Steps of the search around the best of these, over the distance to the next ones."""
_ROUNDS = 12
"""Of reweighted least squares."""
_SURE = 1.96
"""Standard deviations of an interval of 95 %."""


@dataclass(frozen=True)
class Limit:
    """A limit of the front motors' torque.

    Attributes
    ----------
    torque, sd : float
        N m, at rest.
    nats : float
        Gained over errors that are the sensors' alone.
    held : array of bool, shape (n,)
        Samples at the limit, or catching up after.
    slope, slope_sd : float
        N m s/rad by which it falls with the speed of a motor that drives; 0 of one that is the same at any speed.
    correlation : float
        Of torque and slope.
    middle, fastest : float
        Speeds of motors that are at it, rad/s: in the mean, and of those that drive fastest.
    """

    torque: float
    sd: float
    nats: float
    held: Flags
    slope: float = 0.0
    slope_sd: float = 0.0
    correlation: float = 0.0
    middle: float = 0.0
    fastest: float = 0.0

    @property
    def falls(self) -> bool:
        """Whether it surely falls with speed: the slope's interval is above 0."""
        return self.slope > _SURE * self.slope_sd

    @property
    def steepest(self) -> float:
        """The upper end of the slope's interval, N m s/rad."""
        return max(self.slope, 0.0) + _SURE * self.slope_sd

    def at_rest(self, slope: float) -> float:
        """Torque at rest of a line with another slope through the same torques, N m."""
        return self.torque + (slope - self.slope) * self.middle

    def lost(self, slope: float) -> float:
        """Share of the torque at rest that such a line has lost at the fastest speed."""
        return min(slope * self.fastest / max(self.at_rest(slope), 1e-12), 1.0)


def torque_limit(data: CommandData, noise: SpeedNoise, error: Array) -> Limit | None:
    """The limit that explains errors (n,) of predicted speeds (measured − predicted) best; None without torques.

    A motor at the limit falls short of its command, exponentially distributed; elsewhere errors are the sensors'. A
    limit that recorded torques exceed is improbable as Gauss says.
    """
    if not _driven(data):
        return None
    return _scanned(data, noise, _Errors.of(data, noise, error), _spread(data))


def torque_line(data: CommandData, noise: SpeedNoise, error: Array) -> Limit | None:
    """The limit that falls with the speed of a motor that drives, along the line that explains errors (n,) best.

    Errors of predicted speeds and their likelihood as in `torque_limit`, whose limit has a slope of 0. None without
    torques.
    """
    if not _driven(data):
        return None
    spread, fastest = _spread(data), float(_driving(data).max())
    unit, errors = _top(np.abs(np.nan_to_num(data.torque))) / max(fastest, 1e-9), _Errors.of(data, noise, error)
    tried = {slope: _scanned(data, noise, errors, spread, unit * slope) for slope in _SLOPES}
    best = max(tried, key=lambda slope: tried[slope].nats)
    for finer in _FINER:
        i = min(int(np.searchsorted(_SLOPES, best)), len(_SLOPES) - 2)
        step = finer * (_SLOPES[i + 1] - _SLOPES[i])
        for slope in (best - step, best + step):
            if 0.0 <= slope <= _SLOPES[-1]:
                tried[slope] = _scanned(data, noise, errors, spread, unit * slope)
        best = max(tried, key=lambda slope: tried[slope].nats)
    return tried[best]


def limited(effects: Mapping[str, Values], data: CommandData, noise: SpeedNoise, error: Array) -> Limit | None:
    """The limit of the kind that a robot's effects have, where it explains most; None where there is none.

    Its size is not theirs: that of the recordings tells which samples are at it.
    """
    if LIMIT not in effects and SAG not in effects:
        return None
    found = (torque_line if SAG in effects else torque_limit)(data, noise, error)
    return found if found is not None and found.nats > 0.0 else None


def allowed(effects: Mapping[str, Values], data: CommandData) -> Array:
    """The most torque (n,) that a robot's effects leave a front motor at the measured speeds, N m."""
    most = np.full(len(data), float(effects.get(LIMIT, {}).get("front_max", np.inf)))
    if SAG in effects:
        line = effects[SAG]
        stall = float(line["stall"])
        lost = stall / float(line.get("no_load_speed", np.inf)) * _driving(data)
        most = np.minimum(most, float(line.get("supply", 1.0)) * stall - lost)
    return most


def excluded_limit(data: CommandData, noise: SpeedNoise, error: Array, enough: float) -> float:
    """The torque (N m) such that every limit below it loses `enough` nats; 0 where there is none, or no torques.

    Limits are tried down to half of what was reached: below that they lose more.
    """
    if not _driven(data):
        return 0.0
    size, spread, errors = np.abs(np.nan_to_num(data.torque)), _spread(data), _Errors.of(data, noise, error)
    top = _top(size)
    found = 0.0
    for limit in np.linspace(0.5 * top, top, 51):
        if _at(data, noise, errors, size, float(limit), spread)[0] > -enough:
            break
        found = float(limit)
    return found


def _driven(data: CommandData) -> bool:
    """Whether torques are known, and any is not nothing."""
    known = np.isfinite(data.torque)
    return bool(known.any()) and float(np.abs(data.torque[known]).max()) > 0.0


def _driving(data: CommandData) -> Array:
    """Speeds (n,) of motors whose torque drives them, rad/s; 0 of those that brake: they lose nothing with speed."""
    return np.maximum(np.sign(np.nan_to_num(data.torque)) * data.speed, 0.0)


def _top(size: Array) -> float:
    """The largest torque, N m."""
    return float(np.sort(size)[-10:].mean()) if len(size) > 50 else float(size.max())


def _spread(data: CommandData) -> float:
    """How sure a single torque is at its largest, N m."""
    return float(np.hypot(_noise_of_torques(data), _RELATIVE * _top(np.abs(np.nan_to_num(data.torque)))))


@dataclass(frozen=True)
class _Errors:
    """Errors of predicted speeds (n,), and what they say whichever limit is tried.

    Attributes
    ----------
    sigma : float
        Noise of a single one, rad/s.
    short : array, shape (n,)
        Shortfalls: errors against the motor's torque, rad/s; NaN where no torque is recorded.
    usual : array, shape (n,)
        Their log-density where nothing holds the motor.
    caught : array, shape (n,)
        Log-likelihood that each gains where the velocity loop may be catching up.
    """

    sigma: float
    short: Array
    usual: Array
    caught: Array

    @staticmethod
    def of(data: CommandData, noise: SpeedNoise, error: Array) -> _Errors:
        """Of errors (n,), rad/s."""
        sigma = _level(noise, error)
        usual = log_density(error / sigma) - np.log(sigma)
        last = np.concatenate(([0.0], error[:-1]))
        width = np.hypot(sigma, _LEFT[1] * np.abs(last))
        catching = -0.5 * ((error - _LEFT[0] * last) / width) ** 2 - np.log(width) - 0.5 * np.log(2.0 * np.pi)
        return _Errors(sigma, -error * np.sign(data.torque), usual, _either(catching, usual))


def _either(density: Array, usual: Array) -> Array:
    """Log-likelihood gained where errors are as `density` has it with a probability of _SHARE, or else as usual."""
    return np.asarray(np.logaddexp(np.log(_SHARE) + density, np.log(1.0 - _SHARE) + usual) - usual)


def _scanned(data: CommandData, noise: SpeedNoise, errors: _Errors, spread: float, slope: float | None = None) -> Limit:
    """The best limit that falls by `slope`, or is level; what speeds take of it is added to the torques."""
    size = np.abs(np.nan_to_num(data.torque))
    if slope:
        size, spread = size + slope * _driving(data), float(np.hypot(spread, slope * noise.sigma))
    plain = errors.short > 4.0 * errors.sigma
    best = None
    for limit in _top(size) + spread * np.linspace(-7.0, 1.5, 18):
        nats, held, at = _at(data, noise, errors, size, float(limit), spread)
        if best is None or nats > best[0]:
            best = nats, held, at, float(limit)
    assert best is not None
    nats, held, at, limit = best
    if slope is None:
        return Limit(*_refined(size, at, plain, spread, limit), nats, held)
    return _line(data, at & plain, spread, Limit(limit, spread, nats, held, slope))


def _at(
    data: CommandData, noise: SpeedNoise, errors: _Errors, size: Array, limit: float, spread: float
) -> tuple[float, Flags, Flags]:
    """Nats that a limit gains; samples that it explains, and those that are near it."""
    known = np.isfinite(data.torque)
    near = known & (size > limit - _NEAR * spread)
    held, gain = _gain(data, near, errors)
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


def _line(data: CommandData, rows: Flags, spread: float, found: Limit) -> Limit:
    """The line as the torques of motors that plainly fall short (`rows`) have it: least absolute deviations.

    Too few of them, or all at one speed, leave the slope open.
    """
    speed, torque = _driving(data)[rows], np.abs(data.torque[rows])
    if not len(speed):
        return replace(found, slope_sd=np.inf)
    middle, fastest = float(speed.mean()), float(np.quantile(speed, 0.95))
    design, line = np.column_stack([np.ones(len(speed)), -speed]), np.array([found.torque, found.slope])
    open_ = found.torque / max(fastest, 1e-9)  # a slope of which nothing is known
    known = np.diag([0.0, (1.25 * spread / open_) ** 2])
    for _ in range(_ROUNDS):
        weight = spread / np.maximum(np.abs(torque - design @ line), 0.1 * spread)
        line = np.linalg.solve((design.T * weight) @ design + known, (design.T * weight) @ torque)
    rest, slope = line.tolist()
    covariance = (1.25 * spread) ** 2 * np.linalg.inv(design.T @ design + known)
    covariance += np.diag([_RELATIVE * rest, _RELATIVE * rest / max(fastest, 1e-9)]) ** 2
    sd = np.sqrt(np.diag(covariance))
    correlation = float(covariance[0, 1] / sd.prod())
    return Limit(
        rest, float(sd[0]), found.nats, found.held, max(slope, 0.0), float(sd[1]), correlation, middle, fastest
    )


def _gain(data: CommandData, at: Flags, errors: _Errors) -> tuple[Flags, float]:
    """Which samples a limit explains, and the log-likelihood that it gains there."""
    gains, sigma, short = np.zeros(len(at)), errors.sigma, errors.short[at]
    mean = max(float(np.maximum(short, 0.0).mean()) if len(short) else 0.0, 3.0 * sigma)
    gains[at] = _either(_exponential(short, mean, sigma), errors.usual[at])
    after = np.zeros(len(at), bool)
    before = at
    for _ in range(_AFTER):
        before = np.concatenate(([False], before[:-1])) & data.whole[:, 0] & ~at & ~after
        after |= before
    gains[after] = errors.caught[after]
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
    return float(np.median(known)) if known else _UNKNOWN * _top(np.abs(np.nan_to_num(data.torque)))


def _level(noise: SpeedNoise, error: Array) -> float:
    """Noise of a single error, its colour included, rad/s."""
    return max(noise.sigma, 1.4826 * float(np.median(np.abs(error)))) if np.any(noise.colour) else noise.sigma
