"""Conditions under which a rover drives, as people would name them: what errors are sorted by."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.samples import Samples
from artibot_sim.identify.printing import number

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TURNING = 0.08
"""rad/s from which a rover turns."""
STANDING = 0.03
"""m/s and rad/s below which it stands."""
_CHANGING = 0.08
"""m/s² from which it speeds up or slows down."""
_QUANTILES = (0.6, 0.75, 0.9)
_SECTOR = np.pi / 4
"""rad to either side of a heading."""
_GRID = 0.7
_RADII = (1.0, 1.6, 2.4)
"""m between centres of discs, and their radii."""


@dataclass(frozen=True)
class Condition:
    """When something is so.

    Attributes
    ----------
    said : str
        Goes on from "most of the error …".
    mask : array of bool, shape (n,)
        The samples that it holds for.
    local : bool
        Whether it is about a place or a time, which other recordings may not have.
    """

    said: str
    mask: Mask
    local: bool = False


def conditions(samples: Samples) -> Iterator[Condition]:
    """All conditions that the recordings allow to look for."""
    yield from _manoeuvres(samples)
    yield from _amounts(samples)
    yield from _headings(samples.at["heading"])
    yield from _times(samples.t)
    yield from _discs(samples.at["x"], samples.at["y"])


def _known(*columns: Array) -> bool:
    return all(np.isfinite(column).any() for column in columns)


def _manoeuvres(samples: Samples) -> Iterator[Condition]:
    speed, rate, change = (samples.at[name] for name in ("speed", "yaw_rate", "acceleration"))
    if not _known(speed, rate):
        return
    stands = (np.abs(speed) < STANDING) & (np.abs(rate) < STANDING)
    yield Condition("while the rover stands", stands)
    yield Condition("on straight stretches", ~stands & (np.abs(rate) < TURNING))
    yield Condition("in turns", np.abs(rate) >= TURNING)
    yield Condition("in left turns", rate >= TURNING)
    yield Condition("in right turns", rate <= -TURNING)
    yield Condition("while it drives backwards", speed < -STANDING)
    yield Condition("while it speeds up", change > _CHANGING)
    yield Condition("while it slows down", change < -_CHANGING)
    yield Condition("while its speed changes", np.abs(change) > _CHANGING)


def _amounts(samples: Samples) -> Iterator[Condition]:
    for name, what, unit in (
        ("speed", "at speeds", "m/s"),
        ("yaw_rate", "at yaw rates", "rad/s"),
        ("articulation_yaw", "with the joint at angles", "rad"),
        ("load", "with motor torques in all", "N·m"),
    ):
        values = np.abs(samples.at[name])
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        for share in _QUANTILES:
            limit = float(np.quantile(known, share))
            yield Condition(f"{what} above {number(limit, 2)} {unit}", values > limit)
        low = float(np.quantile(known, 1 - _QUANTILES[0]))
        yield Condition(f"{what} below {number(low, 2)} {unit}", values < low)
    bend = samples.at["articulation_yaw"]
    if _known(bend):
        limit = float(np.nanquantile(np.abs(bend), 0.5))
        yield Condition(f"with articulation angles above {number(limit, 2)} rad", bend > limit)
        yield Condition(f"with articulation angles below −{number(limit, 2)} rad", bend < -limit)


def _headings(heading: Array) -> Iterator[Condition]:
    if not _known(heading):
        return
    for middle in np.arange(-np.pi, np.pi - 1e-9, _SECTOR):
        away = np.abs(np.angle(np.exp(1j * (heading - middle))))
        named = f"{number(float(middle), 2)} rad ± 45°".replace("-", "−") if middle else "0 rad ± 45°"
        yield Condition(f"while it heads towards {named} in map", away < _SECTOR)


def _times(t: Array) -> Iterator[Condition]:
    last = float(t.max())
    for share in (0.2, 1 / 3, 0.5):
        yield Condition(f"in the first {share * last:.0f} s", t < share * last, True)
        yield Condition(f"after {(1 - share) * last:.0f} s", t > (1 - share) * last, True)


def _discs(x: Array, y: Array) -> Iterator[Condition]:
    if not _known(x, y):
        return
    cells = np.unique(np.round(np.column_stack([x, y])[np.isfinite(x) & np.isfinite(y)] / _GRID), axis=0) * _GRID
    for x_c, y_c in cells.tolist():
        away = np.hypot(x - x_c, y - y_c)
        for radius in _RADII:
            said = f"within {radius:g} m of ({x_c:.1f}, {y_c:.1f}) m".replace("-", "−")
            yield Condition(said, away < radius, True)
