"""Whether a fit leaves more than noise: residuals slow enough to be forces, against what fits of clean data leave."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.diagnosis import Left
from artibot_sim.identify.gauss_newton import Point
from artibot_sim.identify.problem import Problem
from artibot_sim.identify.windows import CHANNEL_NAMES, Window

Array = NDArray[np.float64]

BIN = 0.25
"""s over which residuals are averaged: noise averages out, what forces do stays."""
LIMITS = {"yaw": 2.0, "yaw_rate": 2.0, "articulation_yaw": 2.0, "torque_front": 3.0, "torque_back": 3.0}
"""By channel: mean square of averaged residuals, 1 being the sensor's white noise, above which the window in the middle
is more than fits of recordings with nothing hidden leave.

Positions have no limit, for how slow a total station's own errors are is not known: with nothing hidden they leave up
to three times what white noise would.
"""

_FAR = 2.0
"""Times its limit from which a channel is far beyond noise. Effects that were named rightly in campaigns left 1.2 times
their limit at most, those that stood for something on no list more than two and a half times."""


def remains(problem: Problem, point: Point) -> dict[str, Left]:
    """What the residuals of a fit leave, by channel.

    In units of the sensors' own noise, as neighbouring samples show it: levels that a fit has widened to its residuals
    would hide what is left.
    """
    found: dict[str, list[float]] = {}
    for window, residual in zip(problem.windows, point.residuals, strict=True):
        for name, size in _sizes(problem, window, residual).items():
            found.setdefault(name, []).append(size)
    return {name: Left(float(np.median(sizes)), float(np.quantile(sizes, 0.9))) for name, sizes in found.items()}


def beyond_noise(left: Mapping[str, Left], times: float = 1.0) -> tuple[str, ...]:
    """Channels in which a force may be at work that the fit does not know: so many times beyond their limit.

    The window in the middle decides: single ones that began on another branch are no force.
    """
    return tuple(name for name, one in left.items() if one.typical > times * LIMITS.get(name, np.inf))


def far_beyond_noise(left: Mapping[str, Left]) -> tuple[str, ...]:
    """Channels that leave no doubt of it."""
    return beyond_noise(left, _FAR)


def leaves_more_than_noise(left: Mapping[str, Left]) -> bool:
    """Whether any channel is `beyond_noise`."""
    return bool(beyond_noise(left))


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
