"""Predictions by the paper's model and by the extended one, and what each cause is worth on held-out data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.commands.view import CommandView, view_with
from artibot_sim.diagnose.policy import MINOR, REFUTED
from artibot_sim.diagnose.records import HALF_WIDTH, ChannelBaseline, ChannelGain, ErrorSeries, Options, SlowResidual
from artibot_sim.diagnose.remains import leaves_more_than_noise
from artibot_sim.diagnose.selection.decision import Decision
from artibot_sim.estimation.kernels import Parts, WindowSamples
from artibot_sim.estimation.loss import Loss, channel_levels, merged, thinning
from artibot_sim.estimation.measurements import CHANNEL_UNITS, Stretch, stretches
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.experiment import Experiment
from artibot_sim.identify.result import ChannelFit
from artibot_sim.identify.validation import PredictedRecording, deviations, hold_out
from artibot_sim.model import Robot

# ----------------------------------------------------------------------
# Predictions of recordings by the paper's model and by the extended one, and what the extension is worth there.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

_DRAWS = 500
"""Draws of windows."""
STEPS = 2
"""Of the starts that predictions begin with."""
_BLOCK = 5.0
"""s that are drawn together where there are no windows."""


@dataclass(frozen=True)
class PredictionPair:
    """One recording, predicted by both models over the same windows.

    Attributes
    ----------
    held_out : bool
        Whether it took no part in the fit.
    before, after : PredictedRecording
        By the paper's model with its soil identified, and by the extended one.
    """

    held_out: bool
    before: PredictedRecording
    after: PredictedRecording


def predict(
    experiment: Experiment, held_out: bool, baseline: Robot, extended: Robot, horizon: float, workers: int | None
) -> PredictionPair:
    """A recording by both models; once only where they are the same."""
    seen = stretches(experiment, baseline, HALF_WIDTH)
    before = predicted(experiment, baseline, horizon, workers, seen)
    same = extended.effects == baseline.effects and extended == baseline
    return PredictionPair(held_out, before, before if same else predicted(experiment, extended, horizon, workers, seen))


def predicted(
    experiment: Experiment, robot: Robot, horizon: float, workers: int | None, seen: Sequence[Stretch] = ()
) -> PredictedRecording:
    """A recording by one model; `seen` are its stretches, where they are known already."""
    return hold_out(experiment, robot, horizon, workers, steps=STEPS, half_width=HALF_WIDTH, seen=seen)


def gains(pairs: Sequence[PredictionPair], commanded: Sequence[ErrorSeries], seed: int) -> dict[str, ChannelGain]:
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
    drawn = [squares[rng.integers(0, len(squares), len(squares))] for _ in range(_DRAWS)]
    figures = []
    for of in (_rmse, _median_rmse):
        before, after = of(squares).tolist()
        low, high = np.quantile([-np.diff(of(rows)) for rows in drawn], (0.025, 0.975)).tolist()
        figures += [before, after, (low, high)]
    return ChannelGain(unit, *figures)


def _rmse(squares: Array) -> Array:
    """Before and after, over all samples."""
    total = squares.sum(axis=0)
    return np.sqrt(total[:2] / total[2])


def _median_rmse(squares: Array) -> Array:
    """Before and after, of each window by itself: the median."""
    return np.median(np.sqrt(squares[:, :2] / squares[:, 2:]), axis=0)


def _blocks(series: ErrorSeries) -> list[tuple[float, float, float]]:
    """Sums of squared errors before and after, and how many samples, of every few seconds."""
    rows = []
    for start in np.arange(series.t[0], series.t[-1], _BLOCK).tolist() if len(series.t) else []:
        mine = (series.t >= start) & (series.t < start + _BLOCK)
        before, after = series.before[mine].ravel(), series.after[mine].ravel()
        known = np.isfinite(before) & np.isfinite(after)
        before, after = before[known], after[known]
        rows.append((float(before @ before), float(after @ after), float(len(before))))
    return rows


def _by_window(pair: PredictionPair) -> list[tuple[PredictedRecording, PredictedRecording, int]]:
    return [(pair.before, pair.after, i) for i in range(len(pair.before.windows))]


def _squares(at: tuple[PredictedRecording, PredictedRecording, int], channel: int) -> tuple[float, float, float]:
    """Sums of squared errors before and after (SI), and how many samples, of one window."""
    before, after, i = at
    _, first = deviations(before.windows[i], before.residuals[i], channel)
    _, second = deviations(after.windows[i], after.residuals[i], channel)
    return float(first @ first), float(second @ second), float(len(first))


def baseline_levels(pairs: Sequence[PredictionPair]) -> dict[str, ChannelBaseline]:
    """How wrong the paper's model is over all recordings."""
    found = {}
    for name in CHANNEL_NAMES:
        fits = [pair.before.summary.channels[name] for pair in pairs if name in pair.before.summary.channels]
        if not fits:
            continue
        free = [pair.before.summary.free_run[name] for pair in pairs if name in pair.before.summary.free_run]
        noise = float(np.median([fit.noise for fit in fits]))
        weighted = _weighted([pair.before for pair in pairs], CHANNEL_NAMES.index(name))
        found[name] = ChannelBaseline(fits[0].unit, _pooled(fits), noise, _pooled(free), weighted)
    return found


def _weighted(held: Sequence[PredictedRecording], channel: int) -> float:
    """Root mean square of a channel's errors, each over the noise of its own sample; NaN where there are none."""
    parts = [r[w.channel == channel] for one in held for w, r in zip(one.windows, one.residuals, strict=True)]
    errors = np.concatenate(parts) if parts else np.empty(0)
    errors = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else float("nan")


def _pooled(fits: Sequence[ChannelFit]) -> float:
    """Root mean square over several recordings; NaN where there are none."""
    count = sum(fit.count for fit in fits)
    return float(np.sqrt(sum(fit.count * fit.rmse**2 for fit in fits) / count)) if count else float("nan")


# ----------------------------------------------------------------------
# What each named cause is worth on held-out data: by how much predictions err less once it is in the model.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Worth:
    """What one cause is worth on held-out data, beside those found before it.

    Attributes
    ----------
    before, after : float
        Mean squared error in units of noise, less the noise's share, without and with it.
    nats : float
        By how much the log-likelihood of the predictions grows, with noise as large and as slow as all causes together
        leave it.
    """

    before: float
    after: float
    nats: float

    @property
    def share(self) -> float:
        """Fraction by which the error beyond noise falls; 0 where there is none."""
        return 1.0 - max(self.after, 0.0) / self.before if self.before > 0.0 else 0.0


LAWS = "laws"
"""What forces on no list are called among causes: all of them together."""


def improvements(
    decision: Decision, pairs: Sequence[PredictionPair], extended: Robot, view: CommandView, options: Options
) -> dict[str, Worth]:
    """What each cause is worth on held-out data, in the order in which they were found, and laws after them.

    The soil is fitted each time.

    Parameters
    ----------
    pairs : sequence of PredictionPair
        Of what was held out.
    extended : Robot
        With all causes.
    view : CommandView
        Of the same recordings and others.
    """
    causes = [*(one.effect for one in decision.named), *([LAWS] if decision.laws is not None else [])]
    if not causes:
        return {}
    problem, fit = decision.whole
    levels = merged(channel_levels(problem.windows, fit.point.residuals))
    robots = [*_models(decision)[: len(causes) - 1], extended]
    seen = [pair.before.experiment for pair in pairs]
    held = [
        [
            predicted(one.before.experiment, robot, options.horizon, options.workers, one.before.stretches)
            for one in pairs
        ]
        for robot in robots[:-1]
    ]
    held.append([pair.after for pair in pairs])
    names = [one.name for one in seen]
    neutral = [pair.before for pair in pairs]
    before = excess(neutral, _followed(view, extended, names, "before"), levels)
    likely = _likelihoods([neutral, *held]).sum(axis=-1).tolist()
    stated = view_with(view, seen, decision.neutral_problem.parameters.robot)
    from_commands = [0.0, *map(stated.nats, robots)]
    found = {}
    for k, (cause, robot, one) in enumerate(zip(causes, robots, held, strict=True)):
        after = excess(one, _followed(view, robot, names, "after"), levels)
        found[cause] = Worth(before, after, likely[k + 1] - likely[k] + from_commands[k + 1] - from_commands[k])
        before = after
    return found


def likelihood_interval(
    pairs: Sequence[PredictionPair], gained: Mapping[str, Worth], seed: int
) -> tuple[float, float] | None:
    """95 % interval of the nats by which recordings are likelier with all causes, from windows drawn anew.

    The likelihood weighs errors by their noise and far ones little, so that a few windows in which a localisation was
    lost do not decide it. What commands say has no windows and is taken as it is.

    Parameters
    ----------
    pairs : sequence of PredictionPair
        Of what was held out.
    gained : mapping of str to Worth
        What `improvements` gives.

    Returns
    -------
    (float, float) or None
        None where there are no causes or no windows.
    """
    before, after = _likelihoods([[pair.before for pair in pairs], [pair.after for pair in pairs]])
    if not gained or not len(after):
        return None
    of_windows, rng = after - before, np.random.default_rng(seed)
    drawn = [of_windows[rng.integers(0, len(after), len(after))].sum() for _ in range(_DRAWS)]
    from_commands = sum(one.nats for one in gained.values()) - of_windows.sum()
    low, high = (np.quantile(drawn, (0.025, 0.975)) + from_commands).tolist()
    return low, high


def _likelihoods(models: Sequence[Sequence[PredictedRecording]]) -> Array:
    """Log-likelihoods of the same windows (models, windows), a constant apart; the last model says what noise is."""
    windows = [window for held in models[-1] for window in held.windows]
    if not windows:
        return np.zeros((len(models), 0))
    each = [[residual for held in model for residual in held.residuals] for model in models]
    levels = np.maximum(merged(channel_levels(windows, each[-1])), 1.0)
    samples = WindowSamples.of(windows)
    flat = np.array([np.concatenate(one) / levels[samples.channel] for one in each])
    loss = Loss(1.0, thinning(windows, Parts(flat[-1], samples.begin)), firm=True)
    return np.asarray(-0.5 * loss.totals(samples, flat), float)


def is_refuted(gained: Mapping[str, Worth], gain: Mapping[str, ChannelGain]) -> bool:
    """Whether held-out data are predicted worse with all that was named: in sum by `REFUTED`, surely in one channel.

    Parameters
    ----------
    gained : mapping of str to Worth
        What `improvements` gives.
    gain : mapping of str to ChannelGain
        By channel, with intervals.
    """
    if not gained:
        return False
    before, after = _error(gained)
    grown = after - before > REFUTED * (before if before > 0.0 else 1.0)
    return grown and any(one.ci95[1] < 0.0 for one in gain.values())


def is_minor(gained: Mapping[str, Worth], left: Mapping[str, SlowResidual]) -> bool:
    """Whether all that was named takes little of the held-out error, and more than noise is left of the fitted one.

    The cause of most of it is another one then, of which what was named may be no more than a part or the shadow.

    Parameters
    ----------
    gained : mapping of str to Worth
        What `improvements` gives.
    left : mapping of str to SlowResidual
        What the fit with all causes leaves.
    """
    if not gained or not leaves_more_than_noise(left):
        return False
    before, after = _error(gained)
    return before > 0.0 and after > MINOR * before


def _error(gained: Mapping[str, Worth]) -> tuple[float, float]:
    """Held-out error beyond noise without any cause and with all of them."""
    every = list(gained.values())
    return every[0].before, every[-1].after


def _models(decision: Decision) -> list[Robot]:
    """The model once each of the named effects was added, in their order."""
    robots, fitted, commanded = [], 0, {}
    for named in decision.named:
        if named.found:
            commanded[named.effect] = {name: found.value for name, found in named.found.items()}
        else:
            fitted += 1
        problem, fit = decision.fits[fitted]
        robot = problem.parameters.robot_at(fit.point.coordinates)
        robots.append(replace(robot, effects=dict(robot.effects) | commanded))
    return robots


def _followed(view: CommandView, robot: Robot, names: Sequence[str], which: str) -> list[Array]:
    """Squared errors of the front motors' speeds in the recordings `names`, in units of noise, if commands say any."""
    if not view.followed:
        return []
    _, series = view.for_robot(robot)
    return [((getattr(series[name], which) / series[name].noise) ** 2).ravel() for name in names if name in series]


def excess(held: Sequence[PredictedRecording], commanded: Sequence[Array], levels: Array) -> float:
    """Mean squared error in units of noise, `levels` (channels,) times what sensors show, less the noise's share."""
    parts = [(r / levels[w.channel]) ** 2 for h in held for w, r in zip(h.windows, h.residuals, strict=True)]
    every = np.concatenate([*parts, *commanded]) if parts or commanded else np.ones(1)
    return float(np.mean(every[np.isfinite(every)])) - 1.0
