"""Errors of one channel over all recordings, each sample with what the rover did at that instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.diagnosis import Look, Series

Array = NDArray[np.float64]

COVARIATES = ("speed", "yaw_rate", "heading", "articulation_yaw", "x", "y", "load", "acceleration")
"""What is known of every sample: those of `Look.covariates`, and the speed's change, m/s²."""
_SMOOTH = 0.3
"""s over which a speed's change is taken."""


@dataclass(frozen=True)
class Samples:
    """Errors of a channel.

    Attributes
    ----------
    channel : str
    t : array, shape (n,)
        s since the recording's start.
    look : array of int, shape (n,)
        Which recording.
    before, after : array, shape (n, k)
        Predicted − measured, SI; k is 2 for positions, else 1: each motor has samples of its own.
    noise : float
        Standard deviation of one coordinate.
    at : mapping of str to array, shape (n,)
        COVARIATES at those instants; NaN where they are not known.
    """

    channel: str
    t: Array
    look: NDArray[np.int64]
    before: Array
    after: Array
    noise: float
    at: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.t)

    @property
    def size(self) -> Array:
        """Absolute errors (n,) of the paper's model; of positions the distance."""
        return sizes(self.before)

    @property
    def level(self) -> float:
        """The noise of `size`."""
        return self.noise * float(np.sqrt(self.before.shape[1]))


def sizes(errors: Array) -> Array:
    """Absolute errors (n,) of errors (n,) or (n, k)."""
    return np.abs(errors) if errors.ndim == 1 else np.asarray(np.linalg.norm(errors, axis=1))


def gather(looks: Sequence[Look], channel: str) -> Samples | None:
    """The errors of a channel in all recordings, None where none has any; lost predictions are left out."""
    parts = []
    for index, look in enumerate(looks):
        series = look.channels.get(channel)
        if series is not None and len(series.t):
            parts.append(_part(index, channel, look, series))
    if not parts:
        return None
    which, t, before, after = (np.concatenate(column) for column in zip(*(part[:4] for part in parts), strict=True))
    at = {name: np.concatenate([part[4][name] for part in parts]) for name in COVARIATES}
    noise = float(np.sqrt(np.mean([look.channels[channel].noise ** 2 for look in looks if channel in look.channels])))
    return Samples(channel, t, which, before, after, noise, at)


def _part(
    number: int, channel: str, look: Look, series: Series
) -> tuple[NDArray[np.int64], Array, Array, Array, dict[str, Array]]:
    before, after, t = series.before, series.after, series.t
    if channel != "position":
        t = np.repeat(t, before.size // max(len(before), 1))
        before, after = before.reshape(-1, 1), after.reshape(-1, 1)
    kept = np.isfinite(before).all(axis=1)
    t = t[kept]
    return np.full(len(t), number), t, before[kept], after[kept], covariates_at(look, t)


def covariates_at(look: Look, t: Array) -> dict[str, Array]:
    """What the rover did at times (n,) of a recording; NaN where it is not known."""
    grid = look.covariates.get("t")
    nothing = np.full(len(t), np.nan)
    if grid is None or len(grid) < 2:
        return dict.fromkeys(COVARIATES, nothing)
    table = dict(look.covariates)
    if "speed" in table:
        table["acceleration"] = _slope(grid, table["speed"])
    found = {}
    for name in COVARIATES:
        values = table.get(name, nothing)
        if name == "heading" and name in table:  # angles wrap
            found[name] = np.arctan2(np.interp(t, grid, np.sin(values)), np.interp(t, grid, np.cos(values)))
        else:
            found[name] = np.interp(t, grid, values) if name in table else nothing
    return found


def _slope(t: Array, values: Array) -> Array:
    """Change a second of values (n,), smoothed."""
    size = max(1, round(_SMOOTH / max(float(np.median(np.diff(t))), 1e-3)))
    if len(t) <= 2 * size:
        return np.gradient(values, t)
    kernel = np.ones(size) / size
    smooth = np.convolve(np.pad(values, size, mode="edge"), kernel, "same")[size:-size]
    return np.gradient(smooth, t)
