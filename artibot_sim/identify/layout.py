"""All samples of all windows one after the other, as compiled loops take them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.windows import CHANNEL_NAMES, Window

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SOME = 2000
"""Rows of a channel, evenly, that a quantile is taken from."""


class Samples(NamedTuple):
    """What was measured in w windows, n samples in all.

    Attributes
    ----------
    begin : array of int, shape (w + 1,)
        Where each window's samples begin, and the last one's end.
    value, sigma : array, shape (n,)
        Measured, and the noise's standard deviation.
    channel : array of int, shape (n,)
        Places in CHANNEL_NAMES.
    turns : array of bool, shape (n,)
        Which are angles in `map`.
    x, y, yaw : array of int
        Which samples are places, x and y in pairs, and angles in `map`.
    places, angles : array of int, shape (w + 1,)
        Where each window's begin among those.
    counts : array, shape (w, channels)
        Samples of each channel.
    """

    begin: Indices
    value: Array
    sigma: Array
    channel: Indices
    turns: NDArray[np.bool_]
    x: Indices
    y: Indices
    yaw: Indices
    places: Indices
    angles: Indices
    counts: Array

    @classmethod
    def of(cls, windows: Sequence[Window]) -> Samples:
        """Of windows."""
        begin = _ends(windows)
        found = [[part + first for part in w.places] for w, first in zip(windows, begin.tolist(), strict=False)]
        x, y, yaw = (_joined([parts[k] for parts in found]) for k in range(3))
        turns = np.zeros(begin[-1], bool)
        turns[yaw] = True
        return cls(
            begin, _joined([w.value for w in windows]), _joined([w.sigma for w in windows]),
            _joined([w.channel for w in windows]), turns, x, y, yaw, _ends([parts[0] for parts in found]),
            _ends([parts[2] for parts in found]), np.array([w.counts for w in windows]),
        )  # fmt: skip

    @property
    def windows(self) -> int:
        """How many."""
        return len(self.begin) - 1

    def of_window(self, values: Array) -> Array:
        """One value a window, (w, …), as one a sample, (n, …)."""
        return np.repeat(values, np.diff(self.begin), axis=0)

    def some(self) -> list[Indices]:
        """Of each channel so many samples as a quantile needs, evenly."""
        rows = [np.flatnonzero(self.channel == c) for c in range(len(CHANNEL_NAMES))]
        return [mine[:: max(1, len(mine) // _SOME)] for mine in rows]


class Parts(Sequence[Array]):
    """Values of all samples, (n,), seen window by window."""

    def __init__(self, flat: Array, begin: Indices) -> None:
        self.flat, self._begin = flat, begin

    def __len__(self) -> int:
        return len(self._begin) - 1

    @overload
    def __getitem__(self, place: int) -> Array: ...

    @overload
    def __getitem__(self, place: slice) -> list[Array]: ...

    def __getitem__(self, place: int | slice) -> Array | list[Array]:
        if isinstance(place, slice):
            return [self[i] for i in range(len(self))[place]]
        i = range(len(self))[place]
        return self.flat[self._begin[i] : self._begin[i + 1]]

    def __iter__(self) -> Iterator[Array]:
        ends = self._begin.tolist()
        return (self.flat[a:b] for a, b in zip(ends, ends[1:], strict=False))


def _ends(parts: Sequence[Window] | Sequence[Indices]) -> Indices:
    return np.cumsum([0, *(len(part) for part in parts)]).astype(np.int64)


def _joined(parts: Sequence[NDArray]) -> NDArray:
    return np.ascontiguousarray(np.concatenate(parts)) if parts else np.empty(0)
