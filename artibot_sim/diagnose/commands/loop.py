"""A motor's velocity loop as recorded torques show it: they follow from the speed by which the motor falls short.

A loop that knows nothing of its load asks for gain · (e + integral · ∫ e dt), e being that speed, and keeps its second
part within a windup limit (`velocity_loop`). Torques are held against it and not speeds against torques: how far a
motor is behind is known from angles better than any torque, and what is known badly may not stand on the side of what
explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from artibot_sim.diagnose.commands.data import CommandData
from artibot_sim.diagnose.policy import LEFT_OF_TORQUES
from artibot_sim.model.kernels.compilation import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LOOP = "velocity_loop"
"""Effect that has motors fall short of their commands by their torques, by id."""
_BIN = 0.5
"""s over which torques and speeds are averaged."""
_FREE = 0.93
"""Share of the largest torque from which on a limit may hold it, and it says nothing of a loop."""
_LEAST = 12
"""Bins, below which nothing is fitted."""
_RELATIVE = 0.01
"""Standard deviation of a gain at least, over the gain, and of an integral, over itself or 1/s: torques are not known
better."""


_FREEDOM = 8.0
"""Nats that a windup limit has to gain: what its freedom costs."""
_CUT = (3e-4, 1.0)
"""Angles behind at which a windup limit is tried to cut, over the largest one that is reached without."""
_COARSE = 48
"""How many of them, before the best one is refined."""
_AGAIN = 3
"""Rounds in which how far a part was behind when it began is corrected."""
_FINE = 1e-3
"""Relative change of that angle for finite differences, and how near the best one is looked for."""


@dataclass(frozen=True)
class VelocityLoop:
    """Gain (recorded N m s/rad) and integral (1/s) of the front motors' loops, and their standard deviations.

    `windup` is the limit of the integral part (recorded N m), infinite where none is seen, and `cut` the angle at which
    it cuts, rad. nats is the log-likelihood that torques gain by it: without a loop they are as large as loads are.
    """

    gain: float
    integral: float
    gain_sd: float
    integral_sd: float
    nats: float
    windup: float = math.inf
    windup_sd: float = math.inf
    cut: float = math.inf


def velocity_loop(data: CommandData, short: Array) -> VelocityLoop | None:
    """The loop that explains recorded torques by the speeds (n,) by which motors fall short, rad/s.

    None where too few torques are recorded, or more is left of them than of a loop's: a motor that is told what its
    load needs is not behind by more than its sensors' noise, and then nearly all of the torque is left.
    """
    parts = _parts(data, short)
    fit = _best(parts)
    if fit is None:
        return None
    count, square = len(fit.torque), float(fit.torque @ fit.torque)
    used = 3 if fit.cut < math.inf else 2 if fit.solved[1] > 0.0 else 1
    if fit.solved[0] <= 0.0 or fit.remains > LEFT_OF_TORQUES**2 * square:
        return None
    columns = fit.behind
    if used == 3:
        more, less = (parts.angles(fit.cut * (1.0 + way * _FINE), fit.began) for way in (1.0, -1.0))
        change = parts.centred(more - less) / (2.0 * _FINE * fit.cut)
        columns = np.column_stack([columns, fit.solved[1] * change])
    variance = fit.remains / max(count - used - 1, 1)
    covariance = np.zeros((3, 3))
    covariance[:used, :used] = variance * np.linalg.pinv(columns[:, :used].T @ columns[:, :used])
    gain, integral = float(fit.solved[0]), float(fit.solved[1] / fit.solved[0])
    windup = float(fit.solved[1]) * fit.cut if used == 3 else math.inf
    slope = np.array([-integral, 1.0, 0.0]) / gain  # of the integral by what was solved for
    return VelocityLoop(
        gain, integral, max(float(np.sqrt(covariance[0, 0])), _RELATIVE * gain),
        max(float(np.sqrt(slope @ covariance @ slope)), _RELATIVE * max(integral, 1.0)),
        0.5 * count * float(np.log(square / max(fit.remains, 1e-300))), windup,
        _sd_of_windup(fit, covariance) if used == 3 else math.inf, fit.cut,
    )  # fmt: skip


def _sd_of_windup(fit: _Fit, covariance: Array) -> float:
    """Of gain · integral · cut."""
    slope = np.array([0.0, fit.cut, fit.solved[1]])
    return max(float(np.sqrt(slope @ covariance @ slope)), _RELATIVE * float(fit.solved[1]) * fit.cut)


def cutting(data: CommandData, short: Array) -> float:
    """Angle behind (rad) at which the windup limit of the loop that explains torques best cuts; infinite of none."""
    fit = _best(_parts(data, short))
    return math.inf if fit is None else fit.cut


def unexplained(data: CommandData, short: Array, cut: float = math.inf) -> float:
    """Share of the square of recorded torques that the best loop leaves of them; 1 where nothing is recorded.

    `cut` is the angle behind at which its windup limit cuts, rad.
    """
    fit = _fit(_parts(data, short), cut)
    return 1.0 if fit is None else fit.remains / float(fit.torque @ fit.torque)


@dataclass(frozen=True)
class _Parts:
    """Stretches of motors without a gap, one after the other: n samples of p stretches, in m bins that count.

    Attributes
    ----------
    t, e : array, shape (n,)
        Times (s), and speeds behind (rad/s).
    first : array of int, shape (p + 1,)
        Where each stretch begins, and n.
    each : array of int, shape (n,)
        The bin that a sample is in; −1 of those that do not count.
    share : array, shape (m,)
        What one sample has of the mean of its bin.
    of : array of int, shape (m,)
        The stretch that a bin is of.
    torque, speed : array, shape (m,)
        Means of the bins, N m and rad/s.
    """

    t: Array
    e: Array
    first: Indices
    each: Indices
    share: Array
    of: Indices
    torque: Array
    speed: Array

    @cached_property
    def begins(self) -> Indices:
        """The first bin of each stretch, shape (p,)."""
        return np.searchsorted(self.of, np.arange(len(self.first) - 1))

    def centred(self, values: Array) -> Array:
        """Of the bins, each stretch's less their mean: that is what its loop had taken up."""
        return np.asarray(values - (np.bincount(self.of, values) / np.bincount(self.of))[self.of])

    @cached_property
    def moving(self) -> Array:
        """Speeds less their means, rad/s."""
        return self.centred(self.speed)

    def angles(self, cut: float, began: Array) -> Array:
        """Mean angles behind of the bins (m,), rad, which the windup limit keeps within ±`cut`."""
        angles = np.zeros(len(self.share))
        _wind(self.e, self.t, self.first, self.each, cut, began, angles)
        return angles * self.share

    def beginning(self, gain: float, rising: float, cut: float, began: Array, angles: Array) -> Array:
        """How far behind they began (p,), rad, so that each one's first bin has the torque that is recorded there."""
        k = self.begins
        missing = self.torque[k] - gain * self.speed[k] - rising * angles[k]
        return np.asarray(np.clip(began + missing / rising, -cut, cut))


@kernel
def _wind(e: Array, t: Array, first: Indices, each: Indices, cut: float, began: Array, angles: Array) -> None:
    """Sums over bins of the integrals of `e` over `t` within ±`cut`, of stretches from `began` on."""
    for p in range(len(first) - 1):
        angle = min(max(began[p], -cut), cut)
        for k in range(first[p], first[p + 1]):
            if k > first[p]:
                angle = min(max(angle + 0.5 * (e[k] + e[k - 1]) * (t[k] - t[k - 1]), -cut), cut)
            if each[k] >= 0:
                angles[each[k]] += angle


@dataclass(frozen=True)
class _Fit:
    """Torques (m,), and speeds and angles (m, 2) behind, of each part less their means; gain and gain · integral.

    `remains` is the square that these leave of the torques, `cut` where the windup limit cuts (rad), `began` how far
    each stretch was behind when it began, rad.
    """

    torque: Array
    behind: Array
    solved: Array
    remains: float
    cut: float
    began: Array


def _best(parts: _Parts) -> _Fit | None:
    """The loop that leaves least, with a windup limit where that gains what its freedom costs."""
    plain = _fit(parts, math.inf)
    if plain is None or plain.remains <= 0.0:
        return plain
    angles, begins = parts.angles(math.inf, plain.began), parts.begins
    reached = float((np.maximum.reduceat(angles, begins) - np.minimum.reduceat(angles, begins)).max())
    if reached <= 0.0:
        return plain
    tried = reached * np.geomspace(*_CUT, _COARSE)

    def left(cut: float) -> float:
        fit = _fit(parts, cut)
        return math.inf if fit is None else fit.remains

    k = int(np.argmin([left(float(cut)) for cut in tried]))
    ends = np.log([tried[max(k - 1, 0)], tried[min(k + 1, _COARSE - 1)]])
    found = minimize_scalar(lambda log: left(math.exp(log)), bounds=ends, method="bounded", options={"xatol": _FINE})
    fit = _fit(parts, math.exp(float(found.x)))
    if fit is None or fit.solved[1] <= 0.0:
        return plain
    gains = 0.5 * len(plain.torque) * math.log(plain.remains / max(fit.remains, 1e-300))
    return fit if gains > _FREEDOM else plain


def _fit(parts: _Parts, cut: float) -> _Fit | None:
    """Gain and gain · integral by least squares with a windup limit that cuts at `cut` (rad); None of too few torques.

    How far a part was behind when it began follows from its first torque; without a windup limit it does not matter.
    """
    began = np.zeros(len(parts.first) - 1)
    if len(parts.torque) < _LEAST:
        return None
    torque = parts.centred(parts.torque)
    if not torque.any():
        return None
    rounds = 1 + (_AGAIN if cut < math.inf else 0)
    for k in range(rounds):
        angles = parts.angles(cut, began)
        behind = np.column_stack([parts.moving, parts.centred(angles)])
        solved, left = _solved(torque, behind)
        gain, rising = solved.tolist()
        if k == rounds - 1 or gain <= 0.0 or rising <= 0.0:
            break
        began = parts.beginning(gain, rising, cut, began, angles)
    return _Fit(torque, behind, solved, float(left @ left), cut, began)


def _solved(torque: Array, behind: Array) -> tuple[Array, Array]:
    """Gain and gain · integral by least squares, no loop giving back what it has taken up, and what they leave."""
    solved: Array = np.linalg.lstsq(behind, torque, rcond=None)[0].astype(np.float64)
    if solved[1] <= 0.0:
        speed = behind[:, 0]
        solved = np.array([float(speed @ torque) / max(float(speed @ speed), 1e-300), 0.0])
    return np.asarray(solved, float), np.asarray(torque - behind @ solved, float)


def _parts(data: CommandData, short: Array) -> _Parts:
    """Each stretch of a motor without a gap, its torques and speeds in bins that no limit may hold."""
    known = np.isfinite(data.torque)
    top = float(np.sort(np.abs(data.torque[known]))[-10:].mean()) if known.any() else 0.0
    edges = np.flatnonzero(np.concatenate(([True], ~data.whole[1:, 0], [True])))
    kept: list[tuple[Array, Array, Indices, Array, Array, Array]] = []
    bins = 0
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        t, e, torque = data.middle[begin:end], short[begin:end], data.torque[begin:end]
        if end - begin < 2:
            continue
        each = ((t - t[0]) // _BIN).astype(np.int64)
        count = np.bincount(each)
        with np.errstate(invalid="ignore"):
            mean = np.array([np.bincount(each, column) / count for column in (torque, e)])
            free = np.bincount(each, ~(np.abs(torque) < _FREE * top)) == 0
        used = free & (count >= 0.5 * count.max())
        if np.count_nonzero(used) > 1:
            number = np.where(used, bins + np.cumsum(used) - 1, -1)
            kept.append((t, e, number[each], 1.0 / count[used], mean[0, used], mean[1, used]))
            bins += np.count_nonzero(used)
    none = (np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))
    t, e, each, share, torque, speed = (np.concatenate(of) for of in zip(none, *kept, strict=True))
    first = np.cumsum([0, *(len(one[0]) for one in kept)])
    of = np.repeat(np.arange(len(kept)), [len(one[3]) for one in kept])
    return _Parts(t, e, first, each, share, of, torque, speed)
