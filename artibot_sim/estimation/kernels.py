"""Compiled loops over all samples of all windows, and how the samples are laid out for them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.windows import CHANNEL_NAMES, Window
from artibot_sim.model.kernels.compilation import inlined, kernel

# ----------------------------------------------------------------------
# All samples of all windows one after the other, as compiled loops take them.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SOME = 2000
"""Rows of a channel, evenly, that a quantile is taken from."""


class WindowSamples(NamedTuple):
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
    def of(cls, windows: Sequence[Window]) -> WindowSamples:
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


# ----------------------------------------------------------------------
# Compiled loops over all samples of all windows: what a fit does between two simulations.
#
# Windows stand one after the other (`WindowSamples`), and so do their residuals; a fit looks at several sets of
# them at once. All loops write into what they are given.
# ----------------------------------------------------------------------


_TURN = 2.0 * math.pi


@inlined
def shortest(angle):
    """An angle (rad) brought between −π and π."""
    return angle - _TURN * math.floor(angle / _TURN + 0.5) if abs(angle) > math.pi else angle


@kernel
def compare(of, predicted, lost):
    """Predictions (sets, n) become residuals in units of noise, `lost` where there is none."""
    for s in range(predicted.shape[0]):
        for j in range(predicted.shape[1]):
            away = predicted[s, j] - of.value[j]
            if of.turns[j]:
                away = shortest(away)
            away /= of.sigma[j]
            predicted[s, j] = away if math.isfinite(away) else lost


@kernel
def block_sums(of, residuals, inflation, bend, out):
    """Huber's losses of residuals (sets, n), added up by window and channel, into `out` (sets, windows, channels).

    Samples of one channel mostly stand together: their sum is kept at hand, not in memory.
    """
    for w in range(out.shape[1]):
        for s in range(out.shape[0]):
            for c in range(out.shape[2]):
                out[s, w, c] = 0.0
        j, end = of.begin[w], of.begin[w + 1]
        while j < end:
            c, last = of.channel[j], j + 1
            while last < end and of.channel[last] == c:
                last += 1
            for s in range(out.shape[0]):
                total = out[s, w, c]
                for k in range(j, last):
                    size = abs(residuals[s, k]) / inflation
                    near = min(size, bend)  # near² within the bend, and linear beyond it
                    total += near * (2.0 * size - near)
                out[s, w, c] = total
            j = last


@kernel
def sample_weights(of, residuals, inflation, bend, factor, out):
    """Weights (n,) of the squares of residuals (n,), by factors (windows, channels) and Huber's function."""
    for w in range(factor.shape[0]):
        for j in range(of.begin[w], of.begin[w + 1]):
            size = abs(residuals[j]) / inflation
            out[j] = factor[w, of.channel[j]] * (bend / size if size > bend else 1.0)


@kernel
def limit(of, table, largest):
    """Columns (columns, n) within ± `largest` (channels, columns), in place."""
    for c in range(table.shape[0]):
        for j in range(table.shape[1]):
            most = largest[of.channel[j], c]
            table[c, j] = min(max(table[c, j], -most), most)


@inlined
def gradient_and_weight(of, residuals, s, j, calm_from):
    """A residual by its weight in an alignment, and the weight, both over its noise."""
    size = residuals[s, j]
    share = 1.0 / max(1.0, abs(size) / calm_from) / of.sigma[j]
    return share * size, share / of.sigma[j]


@inlined
def add_position(of, residuals, s, x, y, start_x, start_y, calm_from, H, g):
    """One place's part of an alignment's normal equations: H (3, 3), lower half, and g (3,)."""
    r_x, w_x = gradient_and_weight(of, residuals, s, x, calm_from)
    r_y, w_y = gradient_and_weight(of, residuals, s, y, calm_from)
    arm_x = start_y - (residuals[s, y] * of.sigma[y] + of.value[y])
    arm_y = residuals[s, x] * of.sigma[x] + of.value[x] - start_x
    g[0] += r_x
    g[1] += r_y
    g[2] += r_x * arm_x + r_y * arm_y
    H[0, 0] += w_x
    H[1, 1] += w_y
    H[2, 0] += w_x * arm_x
    H[2, 1] += w_y * arm_y
    H[2, 2] += w_x * arm_x * arm_x + w_y * arm_y * arm_y


@inlined
def solve_3(H, g):
    """H⁻¹ g of a symmetric matrix whose lower half is given, by its factors; three numbers."""
    l10, l20 = H[1, 0] / H[0, 0], H[2, 0] / H[0, 0]
    d1 = H[1, 1] - l10 * H[1, 0]
    l21 = (H[2, 1] - l20 * H[1, 0]) / d1
    d2 = H[2, 2] - l20 * H[2, 0] - l21 * l21 * d1
    y1 = g[1] - l10 * g[0]
    z = (g[2] - l20 * g[0] - l21 * y1) / d2
    y = y1 / d1 - l21 * z
    return g[0] / H[0, 0] - l10 * y - l20 * z, y, z


@inlined
def prior_of_start(known, mean, starts, s, w, H, g):
    """The prior's part of an alignment's normal equations."""
    for a in range(3):
        g[a] = 0.0
        for b in range(starts.shape[2]):
            g[a] += known[w, a, b] * (starts[s, w, b] - mean[w, b])
        for b in range(a + 1):
            H[a, b] = known[w, a, b]


@inlined
def move_window(of, residuals, s, w, start_x, start_y, moved):
    """Residuals of positions and headings after a start moved and turned by `moved`, about where it was."""
    dx, dy, turn = moved
    c, si = math.cos(turn), math.sin(turn)
    for k in range(of.places[w], of.places[w + 1]):
        x, y = of.x[k], of.y[k]
        away_x = residuals[s, x] * of.sigma[x] + of.value[x] - start_x
        away_y = residuals[s, y] * of.sigma[y] + of.value[y] - start_y
        residuals[s, x] = (start_x + dx + c * away_x - si * away_y - of.value[x]) / of.sigma[x]
        residuals[s, y] = (start_y + dy + si * away_x + c * away_y - of.value[y]) / of.sigma[y]
    for k in range(of.angles[w], of.angles[w + 1]):
        j = of.yaw[k]
        residuals[s, j] = shortest(residuals[s, j] * of.sigma[j] + turn) / of.sigma[j]


@kernel
def align(of, residuals, starts, mean, known, calm_from, H, g):
    """Move and turn every start of `starts` (sets, windows, 8 or 6) so that its path fits best; residuals follow.

    `mean` and `known` are the measured starts and their information; `H` (3, 3) and `g` (3,) are scratch.
    """
    for s in range(residuals.shape[0]):
        for w in range(starts.shape[1]):
            if of.places[w] == of.places[w + 1]:
                continue
            prior_of_start(known, mean, starts, s, w, H, g)
            x, y = starts[s, w, 0], starts[s, w, 1]
            for k in range(of.places[w], of.places[w + 1]):
                add_position(of, residuals, s, of.x[k], of.y[k], x, y, calm_from, H, g)
            for k in range(of.angles[w], of.angles[w + 1]):
                gradient, weight = gradient_and_weight(of, residuals, s, of.yaw[k], calm_from)
                g[2] += gradient
                H[2, 2] += weight
            dx, dy, turn = solve_3(H, g)
            move_window(of, residuals, s, w, x, y, (-dx, -dy, -turn))
            starts[s, w, 0] -= dx
            starts[s, w, 1] -= dy
            starts[s, w, 2] -= turn
