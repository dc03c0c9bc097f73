"""Fits of effects on the way of a command, each alone and several together, kept while they are compared."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from artibot_sim.diagnose.command_view.data import Told
from artibot_sim.diagnose.command_view.fit import Best, Fitter
from artibot_sim.diagnose.command_view.limit import Limit, excluded_limit, torque_limit
from artibot_sim.diagnose.command_view.model import PARAMETERS, Way, known_way, seen, way_of
from artibot_sim.diagnose.command_view.noise import Noise, noise_in, sensor_noise
from artibot_sim.diagnose.command_view.series import Level, level_of, series_of
from artibot_sim.diagnose.diagnosis import Series
from artibot_sim.diagnose.options import FALSE_ALARM_RATE, PRIOR_ODDS
from artibot_sim.diagnose.thresholds import THRESHOLDS
from artibot_sim.experiment import Experiment
from artibot_sim.model import Robot

LIMIT, SCALE = "torque_limit", "torque_scale"
EFFECTS = (*PARAMETERS, LIMIT, SCALE)
"""What the view knows about, by id."""
_WORTH = 20.0
"""Nats that an effect gains to be taken for part of what happens while the noise is estimated."""
_MOST = 3
"""Effects at most that are taken so."""
_SMALLEST = {"scale": 1e-3, "lag": 4e-3, "delay": 4e-3}
"""Departures (s where they are times) under which an effect is none: nothing in a recording is as exact as that."""
_SLOWEST = 0.01
"""The same of a dead band, over the largest speed commanded."""
_UNSEEN = 8.0
"""Nats below which an effect was not seen."""
_OCCAM, _MARGIN = 8.0, 2.0
"""Nats that an effect's freedom costs here, and standard deviations that chance may take from an effect."""
NEEDED = THRESHOLDS.least(PRIOR_ODDS, FALSE_ALARM_RATE)
"""Nats that an effect has to gain to be named, unless something else is asked for."""


@dataclass(frozen=True)
class ViewEvidence:
    """What the commands say about one effect.

    Attributes
    ----------
    nats : float
        Log-likelihood gained over the commands followed exactly, at the effect's best; nothing is taken off for its
        parameters.
    values, sd : mapping of str to float
        Where it is best, and standard deviations, by parameter.
    note : str
        Why it gives no evidence, where it cannot.
    excluded_above : mapping of str to float
        For an effect that gains nothing: departure from neutral from which the commands exclude it.
    excluded_below : mapping of str to float
        The same of limits: values below which the commands exclude them.
    """

    nats: float
    values: Mapping[str, float]
    sd: Mapping[str, float]
    note: str = ""
    excluded_above: Mapping[str, float] = field(default_factory=dict)
    excluded_below: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Fit:
    """Some effects at their best together: log-likelihood of all of it, nats, and where that is."""

    value: float
    best: Best
    limit: Limit | None
    pulled: Best | None


@dataclass(frozen=True)
class Work:
    """What the view is made from; fits are kept."""

    recordings: Sequence[Experiment]
    robot: Robot
    data: Told
    pulls: Told | None
    noise: Noise
    needed: float = NEEDED
    _fits: dict[tuple[str, ...], Fit] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_fits", {})

    @cached_property
    def fitter(self) -> Fitter:
        """Of speeds."""
        return Fitter(self.data, self.noise, known_way(self.robot), np.ones(len(self.data), bool))

    @cached_property
    def puller(self) -> Fitter | None:
        """Of the back motors' torques: their noise is what a scale leaves."""
        if self.pulls is None:
            return None
        used = np.ones(len(self.pulls), bool)
        rough = Fitter(self.pulls, sensor_noise(self.pulls), Way(), used)
        best = rough.best(("encoder_scale",))
        left = self.pulls.speed - seen(self.pulls, best.way)
        known = Way(scale=float(self.robot.effects.get(SCALE, {}).get("scale", 1.0)))
        return Fitter(self.pulls, noise_in(self.pulls, left, used), known, used)

    def fit(self, effects: Collection[str]) -> Fit:
        """These effects at their best together."""
        key = tuple(sorted(effects))
        if key not in self._fits:
            self._fits[key] = self._fitted(key)
        return self._fits[key]

    def _fitted(self, effects: tuple[str, ...]) -> Fit:
        ways = [e for e in effects if e in PARAMETERS]
        starts = [self.fit([e for e in ways if e != left]).best.way for left in ways] if len(ways) > 1 else []
        if len(ways) > 1:
            starts += [self.fit([one]).best.way for one in ways]
        best = self.fitter.best(ways, starts)
        limit, value = None, best.value
        if LIMIT in effects:
            best, limit = self._limited(ways, best)
            value = best.value + (limit.nats if limit else 0.0)
        pulled = None
        if self.puller is not None:
            pulled = self.puller.best(("encoder_scale",) if SCALE in effects else ())
            value += pulled.value
        return Fit(value, best, limit, pulled)

    def _limited(self, ways: Sequence[str], best: Best) -> tuple[Best, Limit | None]:
        """The way fitted without the samples that a limit explains, and the limit that is left with it."""
        limit = torque_limit(self.data, self.noise, self.data.speed - seen(self.data, best.way))
        if limit is None or limit.nats <= 0.0 or not ways:
            return best, limit if limit is not None and limit.nats > 0.0 else None
        free = replace(self.fitter, used=~limit.held).best(ways, [best.way])
        again = torque_limit(self.data, self.noise, self.data.speed - seen(self.data, free.way))
        value = self.fitter.value(free.way)
        if again is not None and value + again.nats > best.value + limit.nats:
            return replace(free, value=value), again
        return best, limit

    def plain(self) -> tuple[str, ...]:
        """Effects added one after the other while each gains plainly."""
        found: tuple[str, ...] = ()
        while len(found) < _MOST:
            gains = {e: self.evidence(e, found).nats for e in EFFECTS if e not in found}
            best = max(gains, key=lambda e: gains[e])
            if gains[best] < _WORTH:
                break
            found = (*found, best)
        return found

    def noise_beside(self, found: Collection[str]) -> Noise:
        """Noise of speeds that these effects leave."""
        fit = self.fit(found)
        used = np.ones(len(self.data), bool) if fit.limit is None else ~fit.limit.held
        return noise_in(self.data, self.data.speed - seen(self.data, fit.best.way), used)

    def left(self, found: Collection[str]) -> float:
        """Share of the motors' speed that these effects leave unexplained: typical error over typical speed."""
        fit = self.fit(found)
        used = self.data.counts if fit.limit is None else self.data.counts & ~fit.limit.held
        error = np.abs(self.data.speed - seen(self.data, fit.best.way))[used]
        size = float(np.sqrt(np.mean(self.data.speed**2)))
        return 1.4826 * float(np.median(error)) / size if len(error) and size > 0.0 else 0.0

    def evidence(self, effect: str, given: Collection[str] = ()) -> ViewEvidence:
        """Evidence of one effect on top of others."""
        base, fit = self.fit(given), self.fit((*given, effect))
        values, sd = self.parameters(effect, fit)
        nats = max(fit.value - base.value, 0.0) if self._matters(effect, fit) else 0.0
        note = self._note(effect, nats)
        if nats >= _UNSEEN or given:
            return ViewEvidence(nats, values, sd, note)
        return ViewEvidence(nats, values, sd, note, self._excluded(effect, fit), self._excluded_limit(effect, base))

    def _matters(self, effect: str, fit: Fit) -> bool:
        """Whether an effect is as large as to be told from what stamps and encoders leave open."""
        if effect in (LIMIT, SCALE):
            return True
        field_ = PARAMETERS[effect][1]
        return abs(getattr(fit.best.way, field_) - getattr(self.fitter.known, field_)) >= self._smallest(field_)

    def _smallest(self, field_: str) -> float:
        """Departure of a way's field under which it is none."""
        return _SMALLEST.get(field_, _SLOWEST * float(np.abs(self.data.command).max()))

    def parameters(self, effect: str, fit: Fit) -> tuple[dict[str, float], dict[str, float]]:
        """Values of an effect's parameters at a fit, and their standard deviations; none where nothing tells them."""
        if effect == LIMIT:
            if fit.limit is None:
                return {}, {}
            scale = fit.pulled.way.scale if fit.pulled else 1.0  # recorded over true torque
            return {"front_max": fit.limit.torque / scale}, {"front_max": fit.limit.sd / scale}
        if effect == SCALE:
            pulled = fit.pulled
            return ({"scale": pulled.way.scale}, {"scale": pulled.sd["scale"]}) if pulled else ({}, {})
        name, field_ = PARAMETERS[effect]
        return {name: float(getattr(fit.best.way, field_))}, {name: fit.best.sd[field_]}

    def _note(self, effect: str, nats: float) -> str:
        if effect == SCALE and self.puller is None:
            return "no torque of a back motor is commanded and measured"
        if effect == LIMIT and not np.isfinite(self.data.torque).any():
            return "no torque of a front motor is recorded"
        if effect == LIMIT and nats == 0.0:
            return "no front motor falls short of its command at a torque that it does not exceed"
        return ""

    @property
    def _lost(self) -> float:
        """Nats that a size of an effect has to lose to be excluded: had it been there, it would have been named."""
        return 0.5 * (float(np.sqrt(2.0 * (self.needed + _OCCAM))) + _MARGIN) ** 2

    def _excluded(self, effect: str, fit: Fit) -> dict[str, float]:
        """From which departure from neutral an effect would have been seen, stamps as it wants them."""
        if effect == LIMIT or (effect == SCALE and self.puller is None):
            return {}
        fitter, name, field_ = self.fitter, *PARAMETERS.get(effect, ("scale", "scale"))
        if effect == SCALE and self.puller is not None:
            fitter = self.puller
        best = fit.pulled if effect == SCALE and fit.pulled is not None else fit.best
        neutral = getattr(fitter.known, field_)
        for size in self._smallest(field_) * 1.5 ** np.arange(22):
            ways = [best.way._replace(**{field_: neutral + sign * float(size)}) for sign in (1.0, -1.0)]
            tried = ways if field_ == "scale" else ways[:1]
            if all(fitter.at(way) < best.value - self._lost for way in tried):
                return {name: float(size)}
        return {}

    def _excluded_limit(self, effect: str, base: Fit) -> dict[str, float]:
        """Below which torque a limit that is not there would have been seen."""
        if effect != LIMIT:
            return {}
        error = self.data.speed - seen(self.data, base.best.way)
        limit = excluded_limit(self.data, self.noise, error, self._lost)
        return {"front_max": limit} if limit > 0.0 else {}

    def gained(self, robot: Robot) -> float:
        """Log-likelihood that a robot's effects gain as they are."""
        way = way_of(robot.effects)
        value = self.fitter.at(way)
        if LIMIT in robot.effects:
            limit = torque_limit(self.data, self.noise, self.data.speed - seen(self.data, way))
            value += max(limit.nats, 0.0) if limit else 0.0
        if self.puller is not None:
            value += self.puller.at(Way(scale=float(robot.effects.get(SCALE, {}).get("scale", 1.0))))
        return value - self.fit(()).value

    def shown_by(self, robot: Robot) -> tuple[dict[str, Level], dict[str, Series]]:
        """Levels and series: as commanded, and with a robot's effects."""
        way = way_of(robot.effects)
        limited = LIMIT in robot.effects
        limit = torque_limit(self.data, self.noise, self.data.speed - seen(self.data, way)) if limited else None
        return self.shown(way, limit if limit is not None and limit.nats > 0.0 else None)

    def shown(self, way: Way, limit: Limit | None) -> tuple[dict[str, Level], dict[str, Series]]:
        """Levels and series: as commanded, and with a way."""
        series = series_of(self.recordings, known_way(self.robot), way, self.data, limit)
        return {"front_velocity": level_of(series)}, series
