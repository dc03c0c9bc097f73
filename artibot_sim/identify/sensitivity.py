"""How residuals of windows change with parameters and starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify import kernels
from artibot_sim.identify.layout import Samples
from artibot_sim.identify.windows import CHANNEL_NAMES

Array = NDArray[np.float64]

_SHARE = 0.99


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the residuals of all windows.

    Attributes
    ----------
    parameters : array, shape (p, n)
        By the coordinates of the parameters, for all samples.
    starts : array, shape (8 or 6, n)
        By the start of the window that a sample is of.
    """

    parameters: Array
    starts: Array


def clip(of: Samples, table: Array) -> None:
    """Limit sensitivities (c, n) in place, channel by channel, to three times what 99 of 100 have.

    A finite difference across a switch of eq. 16 is as large as its step is small; a thousandth of all rows would
    hold most of the information, and none of it is true.
    """
    largest = np.full((len(CHANNEL_NAMES), len(table)), np.inf)
    for c, rows in enumerate(of.some()):
        if len(rows):
            largest[c] = 3.0 * _high(np.abs(table[:, rows]))
    kernels.limit(of, table, largest)


def moved_along(of: Samples, table: Array, starts: Array, moves: Array) -> None:
    """Sensitivities (p, n), taken with starts that moved along by `moves` (p, windows, 8 or 6), as if these had stayed.

    `starts` (8 or 6, n) are the sensitivities to them, limited already: so a step that takes the starts along cancels
    them exactly. Differences with starts that stay would be limited themselves where a start's forces die away.
    """
    for row, move in zip(table, moves, strict=True):
        if move.any():
            row -= np.einsum("nk,kn->n", of.of_window(move), starts)


def _high(values: Array) -> Array:
    """What _SHARE of each row (c, n) is below, (c,)."""
    place = _SHARE * (values.shape[1] - 1)
    low = int(place)
    high = min(low + 1, values.shape[1] - 1)
    values.partition((low, high), axis=1)
    return np.asarray(values[:, low] + (place - low) * (values[:, high] - values[:, low]), float)


def rigid(of: Samples, predicted: Array, starts: Array) -> Array:
    """How samples (n,) move with x, y and yaw of their windows' starts (windows, 8 or 6), shape (3, n).

    As on ground that is the same everywhere and in all directions, where only positions and headings notice.
    """
    found, at = np.zeros((3, len(predicted))), of.of_window(starts[:, :2])
    found[0, of.x], found[1, of.y], found[2, of.yaw] = 1.0, 1.0, 1.0
    found[2, of.x] = at[of.y, 1] - predicted[of.y]
    found[2, of.y] = predicted[of.x] - at[of.x, 0]
    found /= of.sigma
    return np.nan_to_num(found, copy=False)
