"""Whether each side follows its own command alone: no motor knows what the other side was told.

A recorder that turns a twist into wheel speeds takes a track for that, and the robot's own controller may take another
one. Then both sides' speeds are mixtures of both sides' commands, and by such commands no motor can be judged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.commands.data import CommandData
from artibot_sim.diagnose.policy import MIXED

Array = NDArray[np.float64]
Places = NDArray[np.int64]

_BLOCK = 5.0
"""s that are drawn together."""
_PIECES = 24
"""Of the range of commands, over which speeds are averaged."""
_LEAST = 20 * _PIECES
"""Samples without which nothing is said."""
_DRAWS = 400
"""Draws of blocks."""


class Mixing(NamedTuple):
    """How the sides turn against each other, over how they were told to, if they go forward as told.

    Attributes
    ----------
    turning : float
        Gain of half the sides' difference over that of their mean: 1 where each side follows its own command.
    interval : (float, float)
        95 %.
    """

    turning: float
    interval: tuple[float, float]

    @property
    def mixed(self) -> bool:
        """Whether the commands are surely none of these motors'."""
        low, high = self.interval
        return low > 1.0 + MIXED or high < 1.0 - MIXED


def unlike(found: Mixing) -> str:
    """That commands are not those of the motors, in words."""
    low, high = found.interval
    return (
        f"the recorded commands are not what these motors were given: beside going forward the robot turns "
        f"{found.turning:.2f} times as fast as they ask for ({low:.2f}–{high:.2f}), and no motor knows the other "
        "side's command; they were computed from a twist with another track, or are not what the drives got"
    )


def mixing(data: CommandData, predicted: Array, used: NDArray[np.bool_]) -> Mixing | None:
    """What sides make of both sides' commands; None where one of them has none.

    Parameters
    ----------
    data : CommandData
    predicted : array, shape (n,)
        Speeds by the motors' own commands, rad/s.
    used : array of bool, shape (n,)
        Samples that count.

    Notes
    -----
    A speed is taken to be any function of the own side's command, so that a drive at its limit mixes nothing, and a
    share of the other side's (a partially linear model; what both sides' commands have in common is taken off first).
    """
    found = [_pairs(data, used, int(number)) for number in np.unique(data.recording)]
    one, two, middle = (np.concatenate(columns) for columns in zip(*found, strict=True))
    _, block = np.unique(np.column_stack([data.recording[one], middle]), axis=0, return_inverse=True)
    if len(one) < _LEAST or not block.any():
        return None
    rows, others, blocks = np.concatenate([one, two]), np.concatenate([two, one]), np.tile(block.ravel(), 2)
    own, other, speed = predicted[rows], predicted[others], data.speed[rows]
    apart, moved = other - _by_own(own, other), speed - _by_own(own, speed)
    sums = np.array([np.bincount(blocks, row) for row in (apart * moved, apart**2, own * speed, own * other, own**2)])
    rng = np.random.default_rng(0)  # no choice of resampled blocks is better than another
    draws = [sums[:, rng.integers(0, sums.shape[1], sums.shape[1])] for _ in range(_DRAWS)]
    whole, *drawn = (_turning(*each.sum(axis=1).tolist()) for each in (sums, *draws))
    if not np.isfinite(whole):
        return None
    low, high = np.nanquantile(drawn, (0.025, 0.975)).tolist()
    return Mixing(whole, (low, high))


def _turning(crossed: float, apart: float, moved: float, common: float, square: float) -> float:
    """Gain of turning over that of going forward, from sums of products; NaN where commands do not tell."""
    if not (apart > 0.0 and square > 0.0):
        return float("nan")
    share = crossed / apart
    gain = (moved - share * common) / square
    return (gain - share) / (gain + share) if gain + share > 0.0 else float("nan")


def _by_own(own: Array, values: Array) -> Array:
    """Values as a function of the own side's command: means over pieces of its range."""
    order = np.argsort(own, kind="stable")
    at, means = ([piece.mean() for piece in np.array_split(each[order], _PIECES)] for each in (own, values))
    return np.interp(own, at, means)


def _pairs(data: CommandData, used: NDArray[np.bool_], number: int) -> tuple[Places, Places, Places]:
    """Samples of both sides of a recording at the same time, and which few seconds of it they belong to."""
    rows = [np.flatnonzero((data.recording == number) & (data.motor == motor) & used) for motor in (0, 1)]
    if min(map(len, rows)) < 2:
        return (np.empty(0, np.int64),) * 3
    t, after = data.middle[rows[0]], data.middle[rows[1]]
    near = np.clip(np.searchsorted(after, t), 1, len(after) - 1)
    near -= (t - after[near - 1] < after[near] - t).astype(int)
    both = np.abs(after[near] - t) < 0.5 * float(np.median(np.diff(t)))
    first, second = rows[0][both], rows[1][near][both]
    return first, second, (data.middle[first] // _BLOCK).astype(np.int64)
