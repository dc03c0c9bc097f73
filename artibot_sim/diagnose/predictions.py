"""Predictions of recordings by the paper's model and by the extended one, and what the extension is worth there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.diagnosis import ChannelBaseline, ChannelGain, Series
from artibot_sim.diagnose.options import HALF_WIDTH
from artibot_sim.experiment import Experiment
from artibot_sim.identify.holdout import Held, hold_out
from artibot_sim.identify.identification import ChannelFit
from artibot_sim.identify.quality import deviations
from artibot_sim.identify.sensing import CHANNEL_UNITS, Stretch, stretches
from artibot_sim.identify.windows import CHANNEL_NAMES
from artibot_sim.model import Robot

Array = NDArray[np.float64]

_DRAWS = 500
_STEPS = 2
"""Of the starts that predictions begin with."""
_BLOCK = 5.0
"""s that are drawn together where there are no windows."""


@dataclass(frozen=True)
class Pair:
    """One recording, predicted by both models over the same windows.

    Attributes
    ----------
    held_out : bool
        Whether it took no part in the fit.
    before, after : Held
        By the paper's model with its soil identified, and by the extended one.
    """

    held_out: bool
    before: Held
    after: Held


def predict(
    experiment: Experiment, held_out: bool, baseline: Robot, extended: Robot, horizon: float, workers: int | None
) -> Pair:
    """A recording by both models; once only where they are the same."""
    seen = stretches(experiment, baseline, HALF_WIDTH)
    before = predicted(experiment, baseline, horizon, workers, seen)
    same = extended.effects == baseline.effects and extended == baseline
    return Pair(held_out, before, before if same else predicted(experiment, extended, horizon, workers, seen))


def predicted(
    experiment: Experiment, robot: Robot, horizon: float, workers: int | None, seen: Sequence[Stretch] = ()
) -> Held:
    """A recording by one model; `seen` are its stretches, where they are known already."""
    return hold_out(experiment, robot, horizon, workers, steps=_STEPS, half_width=HALF_WIDTH, seen=seen)


def gains(pairs: Sequence[Pair], commanded: Sequence[Series], seed: int) -> dict[str, ChannelGain]:
    """What the extension is worth in each channel, with intervals from windows drawn anew."""
    found = {}
    for c, name in enumerate(CHANNEL_NAMES):
        squares = np.array([_squares(at, c) for pair in pairs for at in _by_window(pair)]).reshape(-1, 3)
        gain = _gain(CHANNEL_UNITS[name], squares, seed)
        if gain is not None:
            found[name] = gain
    squares = np.array([row for series in commanded for row in _blocks(series)]).reshape(-1, 3)
    gain = _gain("rad/s", squares, seed)
    return found if gain is None else found | {"front_velocity": gain}


def _gain(unit: str, squares: Array, seed: int) -> ChannelGain | None:
    """From sums of squared errors before and after and numbers of samples, (n, 3); None where there are no samples."""
    squares = squares[squares[:, 2] > 0]
    if not len(squares):
        return None
    rng = np.random.default_rng(seed)
    draws = []
    for _ in range(_DRAWS):
        total = squares[rng.integers(0, len(squares), len(squares))].sum(axis=0)
        draws.append(np.sqrt(total[0] / total[2]) - np.sqrt(total[1] / total[2]))
    total = squares.sum(axis=0)
    low, high = np.quantile(draws, (0.025, 0.975)).tolist()
    before, after = (float(np.sqrt(total[k] / total[2])) for k in (0, 1))
    return ChannelGain(unit, before, after, (low, high))


def _blocks(series: Series) -> list[tuple[float, float, float]]:
    """Sums of squared errors before and after, and how many samples, of every few seconds."""
    rows = []
    for start in np.arange(series.t[0], series.t[-1], _BLOCK).tolist() if len(series.t) else []:
        mine = (series.t >= start) & (series.t < start + _BLOCK)
        before, after = series.before[mine].ravel(), series.after[mine].ravel()
        known = np.isfinite(before) & np.isfinite(after)
        before, after = before[known], after[known]
        rows.append((float(before @ before), float(after @ after), float(len(before))))
    return rows


def _by_window(pair: Pair) -> list[tuple[Held, Held, int]]:
    return [(pair.before, pair.after, i) for i in range(len(pair.before.windows))]


def _squares(at: tuple[Held, Held, int], channel: int) -> tuple[float, float, float]:
    """Sums of squared errors before and after (SI), and how many samples, of one window."""
    before, after, i = at
    _, first = deviations(before.windows[i], before.residuals[i], channel)
    _, second = deviations(after.windows[i], after.residuals[i], channel)
    return float(first @ first), float(second @ second), float(len(first))


def baseline_levels(pairs: Sequence[Pair]) -> dict[str, ChannelBaseline]:
    """How wrong the paper's model is over all recordings."""
    found = {}
    for name in CHANNEL_NAMES:
        fits = [pair.before.summary.channels[name] for pair in pairs if name in pair.before.summary.channels]
        if not fits:
            continue
        free = [pair.before.summary.free_run[name] for pair in pairs if name in pair.before.summary.free_run]
        noise = float(np.median([fit.noise for fit in fits]))
        found[name] = ChannelBaseline(fits[0].unit, _pooled(fits), noise, _pooled(free))
    return found


def _pooled(fits: Sequence[ChannelFit]) -> float:
    """Root mean square over several recordings; NaN where there are none."""
    count = sum(fit.count for fit in fits)
    return float(np.sqrt(sum(fit.count * fit.rmse**2 for fit in fits) / count)) if count else float("nan")
