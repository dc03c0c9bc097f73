"""How far predictions are from measurements, channel by channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from artibot_sim.experiment.local_fit import fresh
from artibot_sim.identify.identification import ChannelFit
from artibot_sim.identify.printing import spaced
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


_WORST = 0.05
"""Share of windows that are named."""
_LEAP = 2.0
"""m/s from one measured position to the next, faster than any rover here drives."""
_FEWEST = 20


def end_errors(windows: Sequence[Window], residuals: Sequence[Array], name: str) -> Array:
    """Absolute errors of a channel at the windows' ends, shape (windows,), SI; NaN where it was not measured."""
    ends = [deviations(w, r, CHANNEL_NAMES.index(name))[1][-1:] for w, r in zip(windows, residuals, strict=True)]
    return np.array([end[0] if len(end) else np.nan for end in ends])


def worst_of(error: Array) -> NDArray[np.int64]:
    """Which windows are named as the worst, the worst first."""
    return np.argsort(-error)[: round(_WORST * len(error))]


def outliers(windows: Sequence[Window], residuals: Sequence[Array]) -> tuple[str, ...]:
    """Sentences that name the windows with the largest errors at their ends, and whether their positions leap."""
    if len(windows) < _FEWEST:
        return ()
    said = []
    for name in ("position", "yaw"):
        error = end_errors(windows, residuals, name)
        if not np.isfinite(error).all():
            continue
        worst = worst_of(error).tolist()
        share = float((error[worst] ** 2).sum() / max(float((error**2).sum()), 1e-300))
        listed = ", ".join(f"{error[i]:.2f} at {windows[i].t:.0f} s{'*' if _leaps(windows[i]) else ''}" for i in worst)
        said.append(
            f"the worst {len(worst)} of {len(windows)} windows hold {100 * share:.0f} % of the squared error of {name} "
            f"at the ends: {listed} ({spaced(CHANNEL_UNITS[name])})"
        )
    if any("*" in sentence for sentence in said):
        said.append(f"*: measured positions leap there, by more than {_LEAP:g} m/s from one to the next")
    return tuple(said)


def _leaps(window: Window) -> bool:
    """Whether measured positions are further apart than a rover gets; held ones are left out."""
    x, y, _ = window.places
    points, t = np.column_stack([window.value[x], window.value[y]]), window.plan.t[x]
    new = fresh(points)
    away = np.hypot(*np.diff(points[new], axis=0).T)
    return bool((away > _LEAP * np.maximum(np.diff(t[new]), 1e-3)).any())
