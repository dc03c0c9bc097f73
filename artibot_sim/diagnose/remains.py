"""Whether a fit leaves more than noise: residuals slow enough to be forces, against what fits of clean data leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.gauss_newton import Point
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.robust import Loss
from artibot_sim.identify.windows import CHANNEL_NAMES, Window

Array = NDArray[np.float64]

BIN = 0.25
"""s over which residuals are averaged: noise averages out, what forces do stays."""
LIMITS: dict[str, tuple[float, float]] = {
    "position": (2.6, 6.0), "yaw": (2.0, 5.0), "yaw_rate": (2.0, 5.0), "articulation_yaw": (2.0, 5.0),
    "torque_front": (3.0, 5.0), "torque_back": (3.0, 5.0),
}  # fmt: skip
"""By channel: mean square of averaged residuals, 1 being the sensor's white noise, above which windows in the middle,
and the tenth that is worst, are more than fits of recordings with nothing hidden leave."""


@dataclass(frozen=True)
class Level:
    """What is left in one channel.

    Attributes
    ----------
    typical, worst : float
        Mean squares of averaged residuals over those of white noise: of the window in the middle, and the one that a
        tenth of all windows exceed.
    limits : (float, float)
        What fits of clean data leave at most.
    """

    typical: float
    worst: float
    limits: tuple[float, float]

    @property
    def significant(self) -> bool:
        """Whether something remains."""
        return self.typical > self.limits[0] or self.worst > self.limits[1]


@dataclass(frozen=True)
class Remains:
    """What is left in all channels."""

    channels: Mapping[str, Level]

    @property
    def significant(self) -> bool:
        """Whether something remains in any channel."""
        return any(level.significant for level in self.channels.values())

    @property
    def where(self) -> tuple[str, ...]:
        """Channels in which something remains, the worst first."""
        over = {name: max(v / limit for v, limit in zip((level.typical, level.worst), level.limits, strict=True))
                for name, level in self.channels.items() if level.significant}  # fmt: skip
        return tuple(sorted(over, key=lambda name: -over[name]))


def remains(problem: Problem, point: Point, loss: Loss | None = None) -> Remains:
    """What the residuals of a fit leave, channel by channel.

    In units of the sensors' own noise, as neighbouring samples show it: levels that a fit has widened to its residuals
    would hide what is left. `loss` is not needed.
    """
    found: dict[str, list[float]] = {}
    for window, residual in zip(problem.windows, point.residuals, strict=True):
        for name, size in _sizes(problem, window, residual).items():
            found.setdefault(name, []).append(size)
    return Remains(
        {
            name: Level(float(np.median(sizes)), float(np.quantile(sizes, 0.9)), LIMITS[name])
            for name, sizes in found.items()
        }
    )


def _sizes(problem: Problem, window: Window, residual: Array) -> dict[str, float]:
    """Mean squares of one window's averaged residuals over those of the sensors' white noise."""
    found = {}
    for name, scale in problem.widening(window).items():
        mine = window.channel == CHANNEL_NAMES.index(name)
        place = window.plan.kind[mine] * 100_000 + (window.plan.t[mine] / BIN).astype(np.int64)
        order = np.argsort(place, kind="stable")
        firsts = np.flatnonzero(np.diff(place[order], prepend=-1))
        clipped = np.clip(residual[mine][order], -_MOST, _MOST)
        total, count = np.add.reduceat(clipped, firsts), np.add.reduceat(np.ones(len(order)), firsts)
        found[name] = float(np.mean(total**2 / count)) * scale**2
    return found


_MOST = 50.0
"""Residual, in units of noise, beyond which it counts as this."""
