"""How residuals of windows change with parameters and starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.windows import CHANNEL_NAMES, Window

Array = NDArray[np.float64]

_SOME = 2000
"""Rows, evenly, that a quantile is taken from."""


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of one window's residuals.

    Attributes
    ----------
    parameters : array, shape (n, p)
        By the coordinates of the parameters.
    start : array, shape (n, 8 or 6)
        By the start.
    """

    parameters: Array
    start: Array


def clip(windows: Sequence[Window], columns: Sequence[Array]) -> None:
    """Limit sensitivities (n, c) of windows in place, channel by channel, to three times what 99 of 100 have.

    A finite difference across a switch of eq. 16 is as large as its step is small; a thousandth of all rows would
    hold most of the information, and none of it is true.
    """
    channel = np.concatenate([window.channel for window in windows])
    table = np.concatenate(columns)
    for c in range(len(CHANNEL_NAMES)):
        rows = np.flatnonzero(channel == c)
        if not len(rows):
            continue
        limit = 3.0 * np.quantile(np.abs(table[rows[:: max(1, len(rows) // _SOME)]]), 0.99, axis=0)
        table[rows] = np.clip(table[rows], -limit, limit)
    ends = np.cumsum([len(window) for window in windows])[:-1]
    for part, new in zip(columns, np.split(table, ends), strict=True):
        part[:] = new


def rigid(predicted: Array, start: Array, count: int, angles: int) -> Array:
    """How `count` places' x, as many y, and `angles` move with x, y and yaw of a start, shape (2 count + angles, 3)."""
    J = np.zeros((2 * count + angles, 3))
    J[:count, 0], J[count : 2 * count, 1], J[2 * count :, 2] = 1.0, 1.0, 1.0
    J[:count, 2] = start[1] - predicted[count : 2 * count]
    J[count : 2 * count, 2] = predicted[:count] - start[0]
    return J
