"""Whether recorded motor speeds have been through a low-pass: held against the angles recorded beside them.

Angles know nothing of such a filter (`velocity_filter`). What a first-order low-pass makes of a speed is y with
y + T dy/dt = the true one, so an angle gains over any time what the recorded speed adds up to and T times by how much
that speed has grown. Speeds that are late by d instead are the true ones d later, and speeds that somebody computed
from one sample's angle to the next hold for the time before them; with straight lines between samples that would be a
low-pass of half a period to the letter. Nothing noisy is differentiated: angles with stamps that scatter would favour
whatever smooths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import minimize_scalar

from artibot_sim.diagnose.commands.data import SPAN, fresh_column
from artibot_sim.diagnose.commands.fit import STAMPS, ViewEvidence
from artibot_sim.diagnose.commands.model import FILTER
from artibot_sim.diagnose.commands.noise import FREEDOM, log_density
from artibot_sim.diagnose.policy import SMALLEST_DELAY, THRESHOLDS, UNFOLLOWED
from artibot_sim.experiment import Experiment
from artibot_sim.model import MOTORS, Robot

Array = NDArray[np.float64]

_OVER = 0.24
"""s over which angles gain and speeds grow."""
_BREAK = 0.15
"""s without a measurement that nothing is added up over."""
_LONGEST = 2.0
"""s of delay, and of a time constant, at most."""
_TRIED = 24
"""Delays from which the best is sought."""
_LEAST_SD = 1e-3
"""s that no recording beats: stamps are not better than that."""
_RESOLUTION = 1e-4
"""Noise of a gain that is taken at least, over the usual gain: how speeds are added up."""


@dataclass(frozen=True)
class _Stretch:
    """A motor while nothing is missing: instants (n,), by how much its angle gains from each, and its speed.

    Speeds are added up (rad) as straight between samples, and as means since the sample before.
    """

    t: Array
    gain: Array
    speed_t: Array
    speed: Array
    rolled: Array
    means: Array

    def by_means(self) -> Array:
        """Gains (n,) by the speed, rad, if each is the mean rate since the sample before."""
        begin, end = (np.interp(at, self.speed_t, self.means) for at in (self.t, self.t + _OVER))
        return np.asarray(end - begin)

    def predicted(self, late: float, smoothed: float) -> Array:
        """Gains (n,) by the speed, rad, if it was recorded `late` and has been through a low-pass, s."""
        begin, end = self.t + late, self.t + late + _OVER
        rolled = np.interp(end, self.speed_t, self.rolled) - np.interp(begin, self.speed_t, self.rolled)
        grown = np.interp(end, self.speed_t, self.speed) - np.interp(begin, self.speed_t, self.speed)
        return np.asarray(rolled + smoothed * grown)


@dataclass(frozen=True)
class _End:
    """A delay and a time constant (s) at their best, or means: log-likelihood (nats), the constant's deviation (s)."""

    value: float
    late: float
    smoothed: float
    sd: float = np.inf
    means: bool = False


class _Comparison:
    """Angles and speeds of all motors, and how likely these are."""

    def __init__(self, stretches: Sequence[_Stretch]) -> None:
        self._stretches = stretches
        self.gain = np.concatenate([one.gain for one in stretches])
        self.size = float(np.sqrt(np.mean(self.gain**2)))
        steps = np.concatenate([np.diff(one.t) for one in stretches])
        self._thinning = max(_OVER / float(np.median(steps)), 1.0)
        self.settle(_End(0.0, 0.0, 0.0))

    def predicted(self, late: float, smoothed: float) -> Array:
        """Gains (n,) of all motors by their speeds, rad."""
        return np.concatenate([one.predicted(late, smoothed) for one in self._stretches])

    def settle(self, best: _End) -> None:
        """Take the noise that the best leaves."""
        by = self.by_means() if best.means else self.predicted(best.late, best.smoothed)
        self.sigma = max(1.4826 * float(np.median(np.abs(self.gain - by))), _RESOLUTION * self.size)

    def value(self, late: float, smoothed: float) -> float:
        """Log-likelihood, nats; gains that overlap count once."""
        return self._likelihood(self.predicted(late, smoothed))

    def _likelihood(self, predicted: Array) -> float:
        return float(log_density((self.gain - predicted) / self.sigma).sum()) / self._thinning

    def by_means(self) -> Array:
        """Gains (n,) of all motors, rad, by speeds that are means since the sample before."""
        return np.concatenate([one.by_means() for one in self._stretches])

    def means(self) -> _End:
        """Speeds that were computed from the angles."""
        return _End(self._likelihood(self.by_means()), 0.0, 0.0, means=True)

    def plain(self) -> _End:
        """Speeds as they are, stamps as they want them."""
        return self._best(lambda late: _End(self.value(late, 0.0), late, 0.0), -STAMPS, STAMPS)

    def late(self) -> _End:
        """Speeds that are late."""
        tried = np.geomspace(0.5 * SMALLEST_DELAY, _LONGEST, _TRIED)
        values = [self.value(late, 0.0) for late in tried.tolist()]
        i = int(np.argmax(values))
        low, high = tried[max(i - 1, 0)], tried[min(i + 1, _TRIED - 1)]
        return self._best(lambda late: _End(self.value(late, 0.0), late, 0.0), float(low), float(high))

    def smoothed(self) -> _End:
        """Speeds through a low-pass, stamps as they want them."""
        return self._best(self._through, -STAMPS, STAMPS)

    def _best(self, at: Callable[[float], _End], low: float, high: float) -> _End:
        found = minimize_scalar(lambda late: -at(late).value, bounds=(low, high), method="bounded")
        return at(float(found.x))

    def _through(self, late: float) -> _End:
        """The best time constant at a delay: reweighted least squares."""
        plain = self.predicted(late, 0.0)
        grown, smoothed, sd = self.predicted(late, 1.0) - plain, 0.0, np.inf
        for _ in range(12):
            error = (self.gain - plain - smoothed * grown) / self.sigma
            weight = (FREEDOM + 1.0) / (FREEDOM + error**2)
            information = float(weight @ grown**2)
            if information <= 0.0:
                break
            smoothed = float(np.clip(weight @ (grown * (self.gain - plain)) / information, 0.0, _LONGEST))
            sd = self.sigma * float(np.sqrt(self._thinning / information))
        return _End(self.value(late, smoothed), late, smoothed, sd)


def encoder_evidence(recordings: Sequence[Experiment], robot: Robot, lost: float) -> ViewEvidence | None:
    """What recorded angles and speeds say of a low-pass; None where no motor has both, or the robot file has one.

    Parameters
    ----------
    recordings : sequence of Experiment
    robot : Robot
    lost : float
        Nats that a time constant has to lose to be excluded.
    """
    stretches = (
        [one for recording in recordings for one in _stretches(recording)] if FILTER not in robot.effects else []
    )
    if not stretches:
        return None
    found = _Comparison(stretches)
    for _ in range(2):  # the noise that the best leaves changes which is best
        found.settle(max(found.plain(), found.means(), found.late(), found.smoothed(), key=lambda end: end.value))
    plain = max(found.plain(), found.means(), key=lambda end: end.value)
    late, smoothed = found.late(), found.smoothed()
    left = found.sigma / found.size
    if left > UNFOLLOWED:
        return ViewEvidence(0.0, {}, {}, f"speeds are not the rates of the angles: {100 * left:.0f} % of them is left")
    values, sd = {"time_constant": smoothed.smoothed}, {"time_constant": max(smoothed.sd, _LEAST_SD)}
    if smoothed.smoothed < SMALLEST_DELAY:
        return ViewEvidence(0.0, values, sd, "", _excluded(found, plain, lost))
    nats = max(smoothed.value - max(plain.value, late.value), 0.0)
    either = nats < THRESHOLDS.tie and smoothed.value - plain.value > THRESHOLDS.tie
    note = f"speeds that are {late.late:.3f} s later than the angles explain as much" if either else ""
    unseen = smoothed.value - plain.value < THRESHOLDS.tie
    return ViewEvidence(nats, values, sd, note, _excluded(found, plain, lost) if unseen else {})


def _excluded(found: _Comparison, plain: _End, lost: float) -> dict[str, float]:
    """From which time constant on a low-pass would have been seen, stamps as it wants them."""
    for size in (SMALLEST_DELAY * 1.5 ** np.arange(16)).tolist():
        if found.value(-STAMPS, size) < plain.value - lost:
            return {"time_constant": size}
    return {}


def _stretches(experiment: Experiment) -> Iterator[_Stretch]:
    """Motors whose angles and speeds are both recorded, while they are."""
    motors = experiment.channels.get("motor_torques")
    for motor in MOTORS if motors is not None else ():
        assert motors is not None
        (t, angle), (speed_t, speed) = (fresh_column(motors, f"{motor}.{what}") for what in ("position", "velocity"))
        if len(t) < 2 or len(speed_t) < 2 or not speed.any():
            continue
        rolled = cumulative_trapezoid(speed, speed_t, initial=0.0)
        every_t, every = motors.series(f"{motor}.velocity")  # of equal ones each holds for its own time
        means = np.interp(speed_t, every_t[1:], np.cumsum(every[1:] * np.diff(every_t)))
        first, last = max(t[0], speed_t[0]), min(t[-1], speed_t[-1]) - _OVER
        at = t[:: max(1, round(SPAN / float(np.median(np.diff(t)))))]
        at = at[(at >= first) & (at <= last)]
        inside = np.zeros(len(at), bool)
        for begin, end in experiment.segments:
            inside |= (at >= begin) & (at + _OVER <= end)
        for own in (t, speed_t):  # no gap between begin and end
            gaps = np.concatenate(([0.0], np.cumsum(np.diff(own) > _BREAK)))
            inside &= np.interp(at + _OVER, own, gaps) == np.interp(at, own, gaps)
        if inside.any():
            at = at[inside]
            gain = np.interp(at + _OVER, t, angle) - np.interp(at, t, angle)
            yield _Stretch(at, gain, speed_t, speed, rolled, means)
