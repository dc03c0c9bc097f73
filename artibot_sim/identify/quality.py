"""How far predictions are from measurements, channel by channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.identification import ChannelFit
from artibot_sim.identify.sensing import CHANNEL_UNITS
from artibot_sim.identify.windows import CHANNEL_NAMES, Window

Array = NDArray[np.float64]


def deviations(window: Window, residual: Array, channel: int) -> tuple[Array, Array]:
    """Times (m,) after the window's start and absolute errors (m,) in SI units; of positions the distance."""
    mine = window.channel == channel
    t, error, kind = window.plan.t[mine], (residual * window.sigma)[mine], window.plan.kind[mine]
    if CHANNEL_NAMES[channel] != "position":
        return t, np.abs(error)
    x, y = kind == 0, kind == 1
    return t[x], np.hypot(error[x], error[y])


def channel_fits(
    windows: Sequence[Window], residuals: Sequence[Array], noise: Mapping[str, float], last: bool = False
) -> dict[str, ChannelFit]:
    """Sizes of all errors (or, with `last`, of each window's last one) by channel; `noise` is of one coordinate."""
    found = {}
    for c, name in enumerate(CHANNEL_NAMES):
        parts = [deviations(w, r, c)[1] for w, r in zip(windows, residuals, strict=True)]
        parts = [part[-1:] if last else part for part in parts if len(part)]
        if not parts:
            continue
        error = np.concatenate(parts)
        level = noise[name] * (np.sqrt(2.0) if name == "position" else 1.0)
        means = [float(np.sqrt(np.mean(part**2))) for part in parts]
        found[name] = ChannelFit(
            CHANNEL_UNITS[name], float(level), float(np.sqrt(np.mean(error**2))), float(np.median(error)),
            float(np.quantile(error, 0.9)), len(error), float(np.median(means) / level),
        )  # fmt: skip
    return found
