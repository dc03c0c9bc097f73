"""Where the squared error of held-out predictions comes from: sensors, stamps, ground that varies, and the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.policy import TIE, TIE_SHARE, VARIES_NATS, VARIES_SHARE
from artibot_sim.diagnose.records import ChannelGain, ErrorBudget, Explainable, Varies
from artibot_sim.estimation.checks.common_map import in_common_map
from artibot_sim.estimation.loss import Loss
from artibot_sim.estimation.parameters import MU_D, MU_S
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit, restarted_windows
from artibot_sim.estimation.solver import evaluate, step
from artibot_sim.estimation.variation import (
    Distances,
    ParameterSpread,
    Windows,
    correlation_of,
    joined,
    spread_of,
    windows_of,
)
from artibot_sim.estimation.windows import CHANNEL_NAMES
from artibot_sim.identify.validation import PredictedRecording

Array = NDArray[np.float64]

CHANNELS = ("position", "yaw")
"""What has a budget."""
OF_SOIL = ("contact.k_l", "contact.k_t", MU_S, MU_D)
"""Soil that may be another one in the next window."""
OF_GROUND = (
    "bulldozing", "friction_anisotropy", "motion_resistance", "rolling_resistance_speed", "soil_softening",
    "wheel_resistance",
)  # fmt: skip
"""Effects whose size the ground sets. What is the robot's own, its sensors' or bound to a place stays what it is."""
_STEPS = 2
"""Of the starts that the likelihood of held-out windows is taken at."""
_DRAWS = 500
_FEWEST = 12
"""Windows, fitted and held out, without which nothing is said of what varies."""


class Variation:
    """A spread of one parameter from window to window, found in fitted windows and judged on held-out ones."""

    def __init__(self, problem: Problem, fit: Fit, held: Sequence[PredictedRecording]) -> None:
        self._fit, self._parameters = fit, problem.parameters
        self.held = list(held)
        self.problems = [as_fitted(problem, one, levels_of(problem)) for one in held]
        self._problem = problem

    def found(self, seed: int) -> tuple[Varies, dict[str, float]] | None:
        """The likeliest spread, and the mean squared errors that it gives (`squares`); None where none holds."""
        which = candidates(self._problem)
        if not which or min(len(self._problem), sum(map(len, self.problems))) < _FEWEST:
            return None
        point, thinning = self._fit.point, self._fit.loss.thinning
        fitted = windows_of(self._problem, point.coordinates, point.starts, thinning, which)
        spreads = [spread_of(one) for one in fitted]
        best = max(range(len(which)), key=lambda k: spreads[k].nats)
        if spreads[best].nats < VARIES_NATS:
            return None
        windows = held_windows(self.problems, point.coordinates, thinning, which[best])
        gained = np.concatenate([spreads[best].gained(one) for one in windows])
        interval = sum_interval(gained, seed)
        if not interval[0] > 0.0:
            return None
        least = spreads[best].nats - max(TIE, TIE_SHARE * spreads[best].nats)
        ties = [which[k] for k, one in enumerate(spreads) if k != best and one.nats > least]
        varies = self._said(which[best], spreads[best], float(gained.sum()), interval, ties)
        over, length = self._alike(fitted[best], windows, spreads[best], seed)
        return replace(varies, over=over, length=length), self.squares(which[best], spreads[best].spread)

    def _alike(self, fitted: Windows, held: Sequence[Windows], spread: ParameterSpread, seed: int) -> tuple[str, float]:
        """What values are alike in that are near each other, and over how many s or m; each window by itself, if not.

        As sure in held-out windows as the spread itself.
        """
        fitted_ones = {str(one.experiment.path): one.experiment for one in self._problem.stretches}
        mapped = in_common_map([*fitted_ones.values(), *(one.experiment for one in self.held)])
        found = correlation_of(fitted, distances_of([self._problem], mapped), spread)
        if found is None or found.nats < VARIES_NATS:
            return "window", 0.0
        gained = found.gained(joined(held), distances_of(self.problems, mapped), spread)
        if not sum_interval(gained, seed)[0] > 0.0:
            return "window", 0.0
        return found.over, found.length if np.isfinite(found.length) else 0.0

    def _said(
        self, number: int, spread: ParameterSpread, nats: float, interval: tuple[float, float], ties: Sequence[int]
    ) -> Varies:
        """A spread in the parameter's own terms."""
        parameters, middle = self._parameters, self._fit.point.coordinates.copy()
        middle[number] += spread.shift
        ends = []
        for side in (-1.0, 0.0, 1.0):
            moved = middle.copy()
            moved[number] += side * spread.spread
            ends.append(float(parameters.robot_at(parameters.inside(moved)).as_vector([parameters.keys[number]])[0]))
        low, value, high = ends
        relative = 0.5 * abs(high - low) / abs(value) if value else float("inf")
        effect, name = _named(parameters.keys[number])
        others = tuple(".".join(filter(None, _named(parameters.keys[i]))) for i in ties)
        return Varies(effect, name, relative, (min(low, high), max(low, high)), nats, interval, others)

    def squares(self, number: int, spread: float) -> dict[str, float]:
        """Mean squared errors (SI) that a spread gives held-out predictions, by channel."""
        totals = {name: np.zeros(2) for name in CHANNELS}
        for one, problem in zip(self.held, self.problems, strict=True):
            _, sensitivity = problem.linearised(self._fit.point.coordinates, one.starts, [number])
            moved = spread * sensitivity.parameters[0] * problem.samples.sigma
            for name in CHANNELS:
                totals[name] += _sums(problem, moved, name)
        return {name: float(total / count) for name, (total, count) in totals.items() if count}

    def sensors(self) -> dict[str, tuple[float, float]]:
        """Mean squares (SI) of what sensors do to held-out predictions by channel: by noise, and by stamps that jitter.

        Noise counts twice: in the samples, and in the starts of predictions.
        """
        totals = {name: np.zeros(3) for name in CHANNELS}
        for one, problem in zip(self.held, self.problems, strict=True):
            started = self._started(one, problem)
            own = Problem(self._parameters, one.stretches, one.windows)
            constant = {CHANNEL_NAMES.index(s.channel): s.sigma for stretch in one.stretches for s in stretch.series}
            whole = np.concatenate([window.sensor for window in one.windows])
            still = np.array([constant.get(c, 0.0) for c in range(len(CHANNEL_NAMES))])[own.samples.channel]
            for name in CHANNELS:
                total, count = _sums(own, whole, name)
                begun = _sums(own, started, name)[0]
                totals[name] += total + begun, _sums(own, np.minimum(still, whole), name)[0] + begun, count
        return {
            name: (float(still / count), float((whole - still) / count))
            for name, (whole, still, count) in totals.items()
            if count
        }

    def _started(self, held: PredictedRecording, problem: Problem) -> Array:
        """Standard deviations (n,) of held-out predictions for what their starts are off by, SI.

        What of a start is not the measured one comes of the window before, whose samples say as much of it as the
        window's own do.
        """
        _, sensitivity = problem.linearised(self._fit.point.coordinates, held.starts, ())
        edges, found = problem.samples.begin.tolist(), np.empty(len(problem.samples.sigma))
        worth = 1.0 / self._fit.loss.thinning[problem.samples.channel]
        for k, (a, b) in enumerate(zip(edges, edges[1:], strict=False)):
            rows = sensitivity.starts[:, a:b]
            known = problem.start_information[k]
            carried = held.starts[k] != problem.starts[k]
            known = known + np.outer(carried, carried) * ((rows * worth[a:b]) @ rows.T)
            found[a:b] = np.sqrt(np.einsum("kn,kn->n", rows, np.linalg.solve(known, rows)))
        return found * problem.samples.sigma


def _named(key: str) -> tuple[str, str]:
    """Effect (empty for soil) and name of the parameter that a key of a robot file stands for."""
    room, _, name = key.rpartition(".")
    return room.removeprefix("effects.") if room.startswith("effects.") else "", name


def candidates(problem: Problem) -> list[int]:
    """Numbers of the parameters that may differ from window to window."""
    keys = problem.parameters.keys
    return [
        i for i, key in enumerate(keys) if key in OF_SOIL or any(key.startswith(f"effects.{e}.") for e in OF_GROUND)
    ]


def distances_of(problems: Sequence[Problem], mapped: bool) -> Distances:
    """How far the windows of problems are from each other; in place only where all are in one map."""
    recordings = [(k, *one) for k, problem in enumerate(problems) for one in zip(problem.recordings[1], strict=True)]
    numbers = np.unique(np.array(recordings), axis=0, return_inverse=True)[1].ravel()
    t = np.array([window.t for problem in problems for window in problem.windows])
    place = np.concatenate([problem.starts[:, :2] for problem in problems]) if mapped else None
    return Distances.of(numbers, t, place)


def held_windows(problems: Sequence[Problem], coordinates: Array, thinning: Array, number: int) -> list[Windows]:
    """What held-out windows say of the parameter with this number, each from its best start."""
    loss, found = Loss(1.0, thinning), []
    for problem in problems:
        point = evaluate(problem, loss, [coordinates], problem.starts)[0]
        for _ in range(_STEPS):
            point = restarted_windows(problem, loss, point)
            point, _, _ = step(problem, loss, point, ())
        found += windows_of(problem, coordinates, point.starts, thinning, [number])
    return found


def levels_of(problem: Problem) -> Array:
    """Noise that a fit has over what sensors show, shape (channels,)."""
    levels = np.ones(len(CHANNEL_NAMES))
    for window in problem.windows:
        levels[window.channel] = window.sigma / window.sensor
    return levels


def as_fitted(problem: Problem, held: PredictedRecording, levels: Array) -> Problem:
    """The held-out windows with a problem's parameters and noise of these levels (channels,)."""
    return Problem(problem.parameters, held.stretches, held.windows, problem.workers).rescaled(levels)


def _sums(problem: Problem, errors: Array, name: str) -> Array:
    """Sum of squared errors (n,) of a channel and how many; a position is two samples that count as one distance."""
    mine = errors[problem.samples.channel == CHANNEL_NAMES.index(name)]
    mine = mine[np.isfinite(mine)]
    return np.array([float(mine @ mine), len(mine) * (0.5 if name == "position" else 1.0)])


def sum_interval(values: Array, seed: int, outside: float = 0.05) -> tuple[float, float]:
    """Interval of a sum from windows drawn anew, so much probability being outside."""
    rng, count = np.random.default_rng(seed), round(_DRAWS * max(1.0, 0.05 / outside))
    draws = [float(values[rng.integers(0, len(values), len(values))].sum()) for _ in range(count)]
    low, high = np.quantile(draws, (0.5 * outside, 1.0 - 0.5 * outside)).tolist()
    return low, high


def error_budget(
    problem: Problem,
    fit: Fit,
    held: Sequence[PredictedRecording],
    gain: Mapping[str, ChannelGain],
    explainable: Mapping[str, Explainable],
    seed: int,
) -> tuple[dict[str, ErrorBudget], Varies | None]:
    """Shares of the squared error of held-out predictions by channel, and the parameter that varies, if one does.

    Parameters
    ----------
    problem, fit : Problem, Fit
        The final model's.
    held : sequence of PredictedRecording
        Held-out recordings as the final model predicts them.
    gain : mapping of str to ChannelGain
    explainable : mapping of str to Explainable
    seed : int
    """
    if not held:
        return {}, None
    variation = Variation(problem, fit, held)
    varies, varying = variation.found(seed) or (None, dict[str, float]())
    budgets, worth_saying = {}, False
    for name, (still, timing) in variation.sensors().items():
        after = np.zeros(2)
        for one, windows in zip(held, variation.problems, strict=True):
            after += _sums(windows, np.concatenate(one.residuals) * _sigma(one), name)
        left = float(after[0] / after[1]) if after[1] else 0.0
        before = max(gain[name].before ** 2, left) if name in gain else left
        if before > 0.0:
            learned = explainable.get(name)
            share = 1.0 - (learned.learned / learned.model) ** 2 if learned is not None and learned.better else 0.0
            budgets[name] = shares(before, left, still, timing, share * left, varying.get(name, 0.0))
            worth_saying = worth_saying or budgets[name].ground_varies * before > VARIES_SHARE * left
    if varies is None or worth_saying:
        return budgets, varies
    return {name: _unvaried(one) for name, one in budgets.items()}, None


def _sigma(held: PredictedRecording) -> Array:
    return np.concatenate([window.sigma for window in held.windows])


def _unvaried(one: ErrorBudget) -> ErrorBudget:
    return replace(one, ground_varies=0.0, unknown=one.unknown + one.ground_varies)


def shares(before: float, after: float, still: float, timing: float, learnable: float, varying: float) -> ErrorBudget:
    """A budget from mean squares; parts that are more together than what is left are all taken to be less."""
    parts = np.maximum([still, timing, varying, learnable], 0.0)
    parts *= min(1.0, after / max(float(parts.sum()), 1e-300)) / before
    sensors, late, varied, learned = parts.tolist()
    unknown = max(after / before - float(parts.sum()), 0.0)
    return ErrorBudget((before - after) / before, sensors, late, varied, learned, unknown)
