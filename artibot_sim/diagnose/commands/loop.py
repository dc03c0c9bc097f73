"""A motor's velocity loop as recorded torques show it: they follow from the speed by which the motor falls short.

A loop that knows nothing of its load asks for gain · (e + integral · ∫ e dt), e being that speed, and keeps its second
part within a windup limit (`velocity_loop`). Torques are held against it and not speeds against torques: how far a
motor is behind is known from angles better than any torque, and what is known badly may not stand on the side of what
explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

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
_NONE = 1e-300
"""Square below which there is none."""
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


def velocity_loop(parts: Stretches, fit: LoopFit) -> VelocityLoop | None:
    """The loop that a fit found, with its standard deviations.

    None where more is left of the torques than of a loop's: a motor that is told what its load needs is not behind by
    more than its sensors' noise, and then nearly all of the torque is left.
    """
    count, square = len(fit.torque), float(fit.torque @ fit.torque)
    used = 3 if fit.cut < math.inf else 2 if fit.solved[1] > 0.0 else 1
    if fit.solved[0] <= 0.0 or fit.remains > LEFT_OF_TORQUES**2 * square:
        return None
    rows = fit.behind
    if used == 3:
        more, less = (parts.angles(fit.cut * (1.0 + way * _FINE), fit.began) for way in (1.0, -1.0))
        rows = np.vstack([rows, fit.solved[1] * (more - less) / (2.0 * _FINE * fit.cut)])
    variance = fit.remains / max(count - used - 1, 1)
    covariance = np.zeros((3, 3))
    covariance[:used, :used] = variance * np.linalg.pinv(rows[:used] @ rows[:used].T)
    gain, integral = float(fit.solved[0]), float(fit.solved[1] / fit.solved[0])
    windup = float(fit.solved[1]) * fit.cut if used == 3 else math.inf
    slope = np.array([-integral, 1.0, 0.0]) / gain  # of the integral by what was solved for
    return VelocityLoop(
        gain, integral, max(float(np.sqrt(covariance[0, 0])), _RELATIVE * gain),
        max(float(np.sqrt(slope @ covariance @ slope)), _RELATIVE * max(integral, 1.0)),
        0.5 * count * float(np.log(square / max(fit.remains, 1e-300))), windup,
        _sd_of_windup(fit, covariance) if used == 3 else math.inf, fit.cut,
    )  # fmt: skip


def _sd_of_windup(fit: LoopFit, covariance: Array) -> float:
    """Of gain · integral · cut."""
    slope = np.array([0.0, fit.cut, fit.solved[1]])
    return max(float(np.sqrt(slope @ covariance @ slope)), _RELATIVE * float(fit.solved[1]) * fit.cut)


def unexplained(parts: Stretches, cut: float = math.inf) -> float:
    """Share of the square of recorded torques that the best loop leaves of them; 1 where nothing is recorded.

    `cut` is the angle behind at which its windup limit cuts, rad.
    """
    fit = _fit(parts, cut)
    return 1.0 if fit is None else fit.remains / float(fit.torque @ fit.torque)


class Stretches(NamedTuple):
    """Stretches of motors without a gap, one after the other: n samples of p stretches, in m bins that count.

    Attributes
    ----------
    rows : array of int, shape (n,)
        Which samples of the recordings these are.
    t, e : array, shape (n,)
        Times (s), and speeds behind (rad/s).
    first : array of int, shape (p + 1,)
        Where each stretch begins, and n.
    each : array of int, shape (n,)
        The bin that a sample is in; −1 of those that do not count.
    begins : array of int, shape (p + 1,)
        The first bin of each stretch, and m.
    share : array, shape (m,)
        What one sample has of the mean of its bin.
    torque, speed : array, shape (m,)
        Means of the bins, N m and rad/s.
    """

    rows: Indices
    t: Array
    e: Array
    first: Indices
    each: Indices
    begins: Indices
    share: Array
    torque: Array
    speed: Array

    def behind(self, short: Array) -> Stretches:
        """These stretches where motors fall short by `short`, rad/s: a speed for each sample of the recordings."""
        e, inside = short[self.rows], self.each >= 0
        return self._replace(e=e, speed=self.share * np.bincount(self.each[inside], e[inside], len(self.share)))

    def angles(self, cut: float, began: Array) -> Array:
        """Mean angles behind of the bins (m,), rad, which the windup limit keeps within ±`cut`; each less its mean."""
        angles, centred = np.empty_like(self.share), np.empty_like(self.share)
        _wind(self, cut, began, angles)
        _centre(angles, self.begins, centred)
        return centred


@kernel
def _wind(parts: Stretches, cut: float, began: Array, angles: Array) -> None:
    """Means over bins of the integrals of `e` over `t` within ±`cut`, of stretches from `began` on."""
    t, e, first, each = parts.t, parts.e, parts.first, parts.each
    angles[:] = 0.0
    for p in range(len(first) - 1):
        angle = min(max(began[p], -cut), cut)
        for k in range(first[p], first[p + 1]):
            if k > first[p]:
                angle = min(max(angle + 0.5 * (e[k] + e[k - 1]) * (t[k] - t[k - 1]), -cut), cut)
            if each[k] >= 0:
                angles[each[k]] += parts.share[each[k]] * angle


@kernel
def _centre(values: Array, begins: Indices, out: Array) -> None:
    """Of the bins, each stretch's less their mean: that is what its loop had taken up."""
    for p in range(len(begins) - 1):
        mean = values[begins[p] : begins[p + 1]].mean()
        for i in range(begins[p], begins[p + 1]):
            out[i] = values[i] - mean


@kernel
def _regress(torque: Array, behind: Array, solved: Array) -> None:
    """Gain and gain · integral by least squares; no loop gives back what it has taken up.

    What the angles have beside the speeds is what tells their share.
    """
    speed, angle = behind[0], behind[1]
    square = max(_product(speed, speed), _NONE)
    along = _product(speed, angle) / square
    beside = torque_beside = 0.0
    for i in range(len(torque)):
        own = angle[i] - along * speed[i]
        beside += own * own
        torque_beside += own * torque[i]
    solved[1] = max(torque_beside / max(beside, _NONE), 0.0)
    solved[0] = _product(speed, torque) / square - solved[1] * along


@kernel
def _product(one: Array, other: Array) -> float:
    total = 0.0
    for i in range(len(one)):
        total += one[i] * other[i]
    return total


@kernel
def _solve(
    parts: Stretches, cut: float, rounds: int, began: Array, angles: Array, torque: Array, behind: Array, solved: Array
) -> None:
    """Gain and gain · integral, and what they are solved from, with a windup limit that cuts at `cut` (see `LoopFit`).

    After each round but the last, stretches have begun so far behind that each one's first bin has the torque that is
    recorded there.
    """
    _centre(parts.torque, parts.begins, torque)
    _centre(parts.speed, parts.begins, behind[0])
    for k in range(rounds):
        _wind(parts, cut, began, angles)
        _centre(angles, parts.begins, behind[1])
        _regress(torque, behind, solved)
        if k == rounds - 1 or solved[0] <= 0.0 or solved[1] <= 0.0:
            break
        for p in range(len(began)):
            i = parts.begins[p]
            missing = parts.torque[i] - solved[0] * parts.speed[i] - solved[1] * angles[i]
            began[p] = min(max(began[p] + missing / solved[1], -cut), cut)


@dataclass(frozen=True)
class LoopFit:
    """Torques (m,), and speeds and angles (2, m) behind, of each part less their means; gain and gain · integral.

    `remains` is the square that these leave of the torques, `cut` where the windup limit cuts (rad), `began` how far
    each stretch was behind when it began, rad.
    """

    torque: Array
    behind: Array
    solved: Array
    remains: float
    cut: float
    began: Array


def best_fit(parts: Stretches) -> LoopFit | None:
    """The loop that leaves least, with a windup limit where that gains what its freedom costs; None of too few torques.

    It explains torques by the speeds by which motors fall short.
    """
    plain = _fit(parts, math.inf)
    if plain is None or plain.remains <= 0.0:
        return plain
    angles, begins = plain.behind[1], parts.begins[:-1]
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


def _fit(parts: Stretches, cut: float) -> LoopFit | None:
    """Gain and gain · integral by least squares with a windup limit that cuts at `cut` (rad); None of too few torques.

    How far a part was behind when it began follows from its first torque; without a windup limit it does not matter.
    """
    count = len(parts.torque)
    if count < _LEAST:
        return None
    began, solved, behind = np.zeros(len(parts.first) - 1), np.empty(2), np.empty((2, count))
    angles, torque = np.empty(count), np.empty(count)
    _solve(parts, cut, 1 + (_AGAIN if cut < math.inf else 0), began, angles, torque, behind, solved)
    if not torque.any():
        return None
    left = torque - solved @ behind
    return LoopFit(torque, behind, solved, float(left @ left), cut, began)


def stretches(data: CommandData) -> Stretches:
    """Each stretch of a motor without a gap, its torques in bins that no limit may hold; it falls short of nothing."""
    known = np.isfinite(data.torque)
    top = float(np.sort(np.abs(data.torque[known]))[-10:].mean()) if known.any() else 0.0
    edges = np.flatnonzero(np.concatenate(([True], ~data.whole[1:, 0], [True])))
    kept: list[tuple[Indices, Indices, Array, Array]] = []
    bins = 0
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        t, torque = data.middle[begin:end], data.torque[begin:end]
        if end - begin < 2:
            continue
        each = ((t - t[0]) // _BIN).astype(np.int64)
        count = np.bincount(each)
        with np.errstate(invalid="ignore"):
            mean = np.bincount(each, torque) / count
            free = np.bincount(each, ~(np.abs(torque) < _FREE * top)) == 0
        used = free & (count >= 0.5 * count.max())
        if np.count_nonzero(used) > 1:
            number = np.where(used, bins + np.cumsum(used) - 1, -1)
            kept.append((np.arange(begin, end), number[each], 1.0 / count[used], mean[used]))
            bins += np.count_nonzero(used)
    none = (np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0))
    rows, each, share, torque = (np.concatenate(of) for of in zip(none, *kept, strict=True))
    first, begins = (np.cumsum([0, *(len(one[i]) for one in kept)]) for i in (0, 2))
    t = data.middle[rows]
    return Stretches(rows, t, np.zeros_like(t), first, each, begins, share, torque, np.zeros_like(torque))
