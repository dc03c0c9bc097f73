"""Effects on the way of a command, each at its best and several at once."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.command_view.data import Told
from artibot_sim.diagnose.command_view.model import PARAMETERS, Way, followed, seen
from artibot_sim.diagnose.command_view.noise import Noise

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STAMPS = 0.002
"""s to which stamps of commands and measurements agree at best."""
_STEPS = {"lag": 2e-3, "delay": 1e-3, "clock": 1e-3}
"""Changes for finite differences, s."""
_HIGHEST = {"lag": 5.0, "delay": 2.0, "scale": 2.0}
_FIRST = {"lag": (0.03, 0.1, 0.25, 0.6), "delay": (0.02, 0.06, 0.12, 0.25, 0.5)}
"""s from which fits begin."""
_COARSE, _LOWEST, _WIDTH, _TRIED = 28, 0.01, 0.12, 3
"""Thresholds tried, the least over the largest command, half the distance between them, and how many are refined."""
_LEAST_SD = {"delay": 1e-3, "lag": 1e-3, "scale": 2e-4, "threshold": 0.2}
"""Standard deviations that no recording beats: stamps, encoders and drives are not better than that."""


@dataclass(frozen=True)
class Best:
    """Where some effects are at their best.

    Attributes
    ----------
    effects : tuple of str
    way : Way
    value : float
        Log-likelihood, nats.
    sd : mapping of str to float
        Of the fields of the way that were fitted.
    """

    effects: tuple[str, ...]
    way: Way
    value: float
    sd: dict[str, float]


@dataclass(frozen=True)
class Fitter:
    """Fits of ways to what was measured.

    Attributes
    ----------
    data : Told
    noise : Noise
    known : Way
        What the robot does to its commands as far as is known.
    used : array of bool, shape (n,)
        Samples that count.
    """

    data: Told
    noise: Noise
    known: Way
    used: Flags

    @property
    def clock(self) -> float:
        """s by which stamps may disagree at most: commands that are sampled are not known better between samples."""
        return STAMPS + 0.25 * self.data.period

    def value(self, way: Way, speed: Array | None = None) -> float:
        """Log-likelihood of a way, nats; `speed` is what `followed` gives for it."""
        error = self.data.speed - seen(self.data, way, speed)
        return self.noise.log_likelihood(self.data, error, self.used) - 0.5 * (way.clock / (0.5 * self.clock)) ** 2

    def at(self, way: Way) -> float:
        """Log-likelihood of a way, nats, stamps as it wants them."""
        return self._climb(way._replace(clock=0.0), ["clock"])[1]

    def best(self, effects: Collection[str], starts: Iterable[Way] = ()) -> Best:
        """These effects at their best together, from several starts."""
        fields = [PARAMETERS[e][1] for e in effects if e in PARAMETERS]
        free = [f for f in fields if f != "threshold"] + ([] if "delay" in fields else ["clock"])
        begin = [self.known, *starts, *self._alone(fields)]
        tried = [(self.value(way), way) for way in dict.fromkeys(begin)]
        tried.sort(key=lambda pair: -pair[0])
        ends = []
        for base, start in tried[: 2 if len(fields) > 1 else 1]:
            way = self._scanned(start, base) if "threshold" in fields else start
            way, value, _ = self._climb(way, free)
            ends.append((value, way))
        value, way = max(ends, key=lambda pair: pair[0])
        sd = self._sd(way, free)
        if "threshold" in fields:
            sd["threshold"] = self._threshold_sd(way, value)
        return Best(tuple(effects), way, value, {f: max(sd[f], _LEAST_SD[f]) for f in fields})

    def _alone(self, fields: Sequence[str]) -> list[Way]:
        """Ways in which one field has one of several sizes."""
        return [self.known._replace(**{f: size}) for f in fields for size in _FIRST.get(f, ())]

    def _scanned(self, way: Way, value: float) -> Way:
        """The best threshold up to the largest command; as it was where none is better.

        A threshold that is a little wrong may cost as much as the dead band gains, so the best few are refined first.
        """
        top = float(np.abs(self.data.command).max())
        grid = [way._replace(threshold=float(x)) for x in top * np.geomspace(_LOWEST, 0.98, _COARSE)]
        values = np.array([self.value(other) for other in grid])
        ends = [self._refined(grid[int(k)]) for k in np.argsort(-values)[:_TRIED]]
        best, found = max(ends, key=lambda end: end[1])
        return best if found > value else way

    def _refined(self, way: Way) -> tuple[Way, float]:
        """The threshold moved to where the likelihood, which is a staircase of it, is largest."""
        width = _WIDTH * way.threshold
        for _ in range(3):
            around = way.threshold + width * np.linspace(-1.0, 1.0, 9)
            way = max((way._replace(threshold=max(float(x), 0.0)) for x in around), key=self.value)
            width /= 4.0
        return way, self.value(way)

    def _threshold_sd(self, way: Way, value: float) -> float:
        """Half the width over which the likelihood falls by a half."""
        width = 0.05 * way.threshold + 1e-9
        grid = way.threshold + width * np.linspace(-1.0, 1.0, 15)
        near = [x for x in grid if self.value(way._replace(threshold=max(float(x), 0.0))) > value - 0.5]
        return float(0.5 * (max(near) - min(near) + width / 7.0)) if near else float(width)

    def _climb(self, way: Way, free: Sequence[str]) -> tuple[Way, float, Array]:
        """Gauss–Newton with Levenberg's damping for the smooth fields."""
        value, damping = self.value(way), 1e-3
        information = np.eye(len(free))
        for _ in range(12):
            gradient, information = self._slopes(way, free)
            moved = False
            for _ in range(5):
                damped = information + damping * np.diag(np.diag(information)) + 1e-12 * np.eye(len(free))
                new = self._inside(way, dict(zip(free, np.linalg.solve(damped, gradient).tolist(), strict=True)))
                gained = self.value(new) - value
                if gained > 0.0:
                    way, value, damping, moved = new, value + gained, damping / 5.0, True
                    break
                damping = 10.0 * max(damping, 1e-3)
            if not moved or gained < 0.01:
                break
        return way, value, information

    def _inside(self, way: Way, moves: dict[str, float]) -> Way:
        fields = way._asdict()
        for field, move in moves.items():
            low = {"clock": -self.clock, "scale": 0.5}.get(field, 0.0)
            high = self.clock if field == "clock" else _HIGHEST[field]
            fields[field] = float(np.clip(fields[field] + move, low, high))
        return Way(**fields)

    def _slopes(self, way: Way, free: Sequence[str]) -> tuple[Array, Array]:
        """Gradient and information of the log-likelihood by the free fields."""
        data, speed = self.data, followed(self.data.command, way)
        predicted = seen(data, way, speed)
        scaled, valid = self.noise.whitened(data, data.speed - predicted)
        columns = []
        for field in free:
            if field == "scale":
                change = predicted / way.scale
            else:
                step = _STEPS[field]
                moved = way._replace(**{field: getattr(way, field) + step})
                change = (seen(data, moved, None if field == "lag" else speed) - predicted) / step
            columns.append(self.noise.whitened(data, change)[0])
        valid = valid & self.used
        J = np.array([column[valid] for column in columns]).reshape(len(free), -1)
        weight = self.noise.weights(scaled[valid])
        gradient, information = J @ (weight * scaled[valid]), (J * weight) @ J.T
        if "clock" in free:
            i, known = list(free).index("clock"), (0.5 * self.clock) ** -2
            gradient[i] -= known * way.clock
            information[i, i] += known
        return gradient, information

    def _sd(self, way: Way, free: Sequence[str]) -> dict[str, float]:
        _, information = self._slopes(way, free)
        covariance = np.linalg.pinv(information)
        return {field: float(np.sqrt(max(covariance[i, i], 0.0))) for i, field in enumerate(free)}
