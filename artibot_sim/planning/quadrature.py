"""Running integrals of smooth functions, to rounding."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


class Running:
    """The integral of `f` from ``edges[0]`` to any point, by Gauss-Legendre quadrature within cells.

    Parameters
    ----------
    f : callable
        Takes an array of any shape and returns an array of the same shape with a last axis of `width` components.
    edges : (n + 1,) array
        Increasing; between two of them `f` must be smooth and change little (half a radian of phase, say): then
        the 24th-order rule is exact to rounding.
    """

    def __init__(self, f: Callable[[Array], Array], edges: Array) -> None:
        self._f = f
        self._edges = edges
        cells = self._between(edges[:-1], edges[1:])
        self._sums = np.concatenate([np.zeros((1, cells.shape[-1])), np.cumsum(cells, axis=0)])

    def __call__(self, x: Array) -> Array:
        """Integrals up to `x` (n,), as (n, width)."""
        cell = np.clip(np.searchsorted(self._edges, x, side="right") - 1, 0, len(self._edges) - 2)
        return self._sums[cell] + self._between(self._edges[cell], x)

    def _between(self, a: Array, b: Array) -> Array:
        half = 0.5 * (b - a)
        x = a[:, None] + half[:, None] * (1.0 + _NODES)
        return np.einsum("k,nkw->nw", _WEIGHTS, self._f(x)) * half[:, None]


def cells(kinks: list[float], phase: float) -> Array:
    """Edges between `kinks` (increasing), so that a `phase` in rad spread evenly over them changes by ≤ 0.5 a cell."""
    span = kinks[-1] - kinks[0]
    parts = []
    for a, b in pairwise(kinks):
        if b > a:
            parts.append(np.linspace(a, b, int(np.ceil(phase * (b - a) / span / 0.5)) + 2)[:-1])
    return np.concatenate([*parts, np.array([kinks[-1]])])
