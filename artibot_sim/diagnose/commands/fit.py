"""Fits of effects between commands and motors, each alone and several together, kept while they are compared."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from artibot_sim.diagnose.commands.data import CommandData
from artibot_sim.diagnose.commands.limit import LIMIT, SAG, Limit, excluded_limit, limited, torque_limit, torque_line
from artibot_sim.diagnose.commands.loop import (
    LOOP,
    Stretches,
    VelocityLoop,
    best_fit,
    stretches,
    unexplained,
    velocity_loop,
)
from artibot_sim.diagnose.commands.mixing import Mixing, mixing
from artibot_sim.diagnose.commands.model import (
    FILTER,
    PARAMETERS,
    CommandResponse,
    followed,
    predicted_speeds,
    ramped,
    response_of,
)
from artibot_sim.diagnose.commands.noise import SpeedNoise, noise_in, sensor_noise
from artibot_sim.diagnose.commands.series import CommandedLevel, level_of, series_of
from artibot_sim.diagnose.policy import (
    FALSE_ALARM_RATE,
    PRIOR_ODDS,
    SMALLEST_DEADBAND,
    SMALLEST_DELAY,
    SMALLEST_SAG,
    SMALLEST_SCALE,
    THRESHOLDS,
)
from artibot_sim.diagnose.records import ErrorSeries, SlowResidual
from artibot_sim.experiment import Experiment
from artibot_sim.model import Robot

# ----------------------------------------------------------------------
# Effects between commands and motors, each at its best and several at once.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STAMPS = 0.002
"""s to which stamps of commands and measurements agree at best."""
_STEPS = {"lag": 2e-3, "delay": 1e-3, "clock": 1e-3}
"""Changes for finite differences, s."""
_HIGHEST = {"lag": 5.0, "delay": 2.0, "scale": 2.0}
_FIRST = {"lag": (0.03, 0.1, 0.25, 0.6), "delay": (0.02, 0.06, 0.12, 0.25, 0.5)}
"""s from which fits begin."""
_SCANNED = ("rate", "threshold")
"""Fields that are scanned, in the order in which commands meet them: their likelihood has more than one summit."""
_COARSE, _TRIED = 28, 3
"""Sizes tried of each, and how many are refined."""
_LOWEST, _HIGHEST_SHARE = 0.01, 0.98
"""Thresholds tried, over the largest command; and the largest rate, over the fastest change of a command."""
_SLOWEST = 20.0
"""s in which the least rate that is tried reaches the largest command."""
_WIDTH = 0.65
"""First width of a refinement, as a share of the distance to the next size."""
_PART = 0.01
"""Change of a rate for finite differences, as a share of it."""
_LOOPS, _SAME = 4, 0.01
"""Rounds in which a windup limit is found by torques and the clock beside it; the relative change that ends them."""
_LEAST_SD = {"delay": 1e-3, "lag": 1e-3, "scale": 2e-4, "threshold": 0.2, "rate": 0.1}
"""Standard deviations that no recording beats: stamps, encoders and drives are not better than that."""


@dataclass(frozen=True)
class Best:
    """Where some effects are at their best.

    Attributes
    ----------
    effects : tuple of str
    response : CommandResponse
    value : float
        Log-likelihood, nats.
    sd : mapping of str to float
        Of the fields of the response that were fitted.
    """

    effects: tuple[str, ...]
    response: CommandResponse
    value: float
    sd: dict[str, float]


@dataclass(frozen=True)
class Fitter:
    """Fits of responses to what was measured.

    Attributes
    ----------
    data : CommandData
    noise : SpeedNoise
    known : CommandResponse
        What the robot does to its commands as far as is known.
    used : array of bool, shape (n,)
        Samples that count.
    """

    data: CommandData
    noise: SpeedNoise
    known: CommandResponse
    used: Flags

    @property
    def clock(self) -> float:
        """s by which stamps may disagree at most: commands that are sampled are not known better between samples."""
        return STAMPS + 0.25 * self.data.period

    def value(self, response: CommandResponse, speed: Array | None = None) -> float:
        """Log-likelihood of a response, nats; `speed` is what `followed` gives for it."""
        error = self.data.speed - predicted_speeds(self.data, response, speed)
        return self.noise.log_likelihood(self.data, error, self.used) - 0.5 * (response.clock / (0.5 * self.clock)) ** 2

    def with_clock(self, response: CommandResponse) -> CommandResponse:
        """A response with the clock offset that suits it best."""
        return self._climb(response._replace(clock=0.0), ["clock"])[0]

    def at(self, response: CommandResponse) -> float:
        """Log-likelihood of a response, nats, stamps as it wants them."""
        return self._climb(response._replace(clock=0.0), ["clock"])[1]

    def best(self, effects: Collection[str], starts: Iterable[CommandResponse] = ()) -> Best:
        """These effects at their best together, from several starts."""
        fields = [PARAMETERS[e][1] for e in effects if e in PARAMETERS]
        free = [f for f in fields if f not in _SCANNED] + ([] if "delay" in fields else ["clock"])
        begin = [self.known, *starts, *self._alone(fields)]
        tried = [(self.value(response), response) for response in dict.fromkeys(begin)]
        tried.sort(key=lambda pair: -pair[0])
        ends = []
        for base, start in tried[: 2 if len(fields) > 1 else 1]:
            response = start
            for field in _SCANNED:
                response, base = self._scanned(response, base, field) if field in fields else (response, base)
            response, value, _ = self._climb(response, self._smooth(free, fields, response))
            ends.append((value, response))
        value, response = max(ends, key=lambda pair: pair[0])
        sd = self._sd(response, self._smooth(free, fields, response))
        if "threshold" in fields:
            sd["threshold"] = self._threshold_sd(response, value)
        return Best(tuple(effects), response, value, {f: max(sd.get(f, np.inf), _LEAST_SD[f]) for f in fields})

    def _smooth(self, free: Sequence[str], fields: Sequence[str], response: CommandResponse) -> list[str]:
        """The free fields with the rate, where there is a limit: once it is near the best it is climbed as they are."""
        return [*free, *(["rate"] if "rate" in fields and np.isfinite(response.rate) else [])]

    def _alone(self, fields: Sequence[str]) -> list[CommandResponse]:
        """Ways in which one field has one of several sizes."""
        return [self.known._replace(**{f: size}) for f in fields for size in _FIRST.get(f, ())]

    def sizes(self, field: str) -> Array:
        """Sizes of a field that are tried, rising: what is larger or smaller acts on no command, or on all of them."""
        top = float(np.abs(self.data.command).max())
        if field == "threshold":
            return top * np.geomspace(_LOWEST, _HIGHEST_SHARE, _COARSE)
        least, most = top / _SLOWEST, _HIGHEST_SHARE * self.data.steepest
        return np.geomspace(least, most, _COARSE) if least < most else np.empty(0)

    def _scanned(self, response: CommandResponse, value: float, field: str) -> tuple[CommandResponse, float]:
        """The best of all sizes of a field with its likelihood; the response as it was where none is better.

        A size that is a little wrong may cost as much as the effect gains, so the best few are refined first.
        """
        sizes = self.sizes(field)
        if not len(sizes):
            return response, value
        grid = [response._replace(**{field: float(size)}) for size in sizes]
        values = np.array([self.value(other) for other in grid])
        width = _WIDTH * (float(sizes[1] / sizes[0]) - 1.0)
        ends = [self._refined(grid[int(k)], field, width) for k in np.argsort(-values)[:_TRIED]]
        return max([(response, value), *ends], key=lambda end: end[1])

    def _refined(self, response: CommandResponse, field: str, share: float) -> tuple[CommandResponse, float]:
        """A field moved to where the likelihood is largest, by up to this share of it first."""
        width = share * getattr(response, field)
        for _ in range(3):
            around = getattr(response, field) + width * np.linspace(-1.0, 1.0, 9)
            response = max((response._replace(**{field: max(float(x), 0.0)}) for x in around), key=self.value)
            width /= 4.0
        return response, self.value(response)

    def _threshold_sd(self, response: CommandResponse, value: float) -> float:
        """Half the width over which the likelihood falls by a half."""
        width = 0.05 * response.threshold + 1e-9
        grid = response.threshold + width * np.linspace(-1.0, 1.0, 15)
        near = [x for x in grid if self.value(response._replace(threshold=max(float(x), 0.0))) > value - 0.5]
        return float(0.5 * (max(near) - min(near) + width / 7.0)) if near else float(width)

    def _climb(self, response: CommandResponse, free: Sequence[str]) -> tuple[CommandResponse, float, Array]:
        """Gauss–Newton with Levenberg's damping for the smooth fields."""
        value, damping = self.value(response), 1e-3
        information = np.eye(len(free))
        for _ in range(12):
            gradient, information = self._slopes(response, free)
            moved = False
            for _ in range(5):
                damped = information + damping * np.diag(np.diag(information)) + 1e-12 * np.eye(len(free))
                new = self._inside(response, dict(zip(free, np.linalg.solve(damped, gradient).tolist(), strict=True)))
                gained = self.value(new) - value
                if gained > 0.0:
                    response, value, damping, moved = new, value + gained, damping / 5.0, True
                    break
                damping = 10.0 * max(damping, 1e-3)
            if not moved or gained < 0.01:
                break
        return response, value, information

    def _inside(self, response: CommandResponse, moves: dict[str, float]) -> CommandResponse:
        fields = response._asdict()
        for field, move in moves.items():
            low, high = self._bounds(field, fields[field])
            fields[field] = float(np.clip(fields[field] + move, low, high))
        return CommandResponse(**fields)

    def _bounds(self, field: str, now: float) -> tuple[float, float]:
        """Least and largest value of a field that is `now`, after a step."""
        if field == "rate":  # found by scanning: nothing far from there is meant
            return 0.8 * now, 1.25 * now
        low = {"clock": -self.clock, "scale": 0.5}.get(field, 0.0)
        return low, self.clock if field == "clock" else _HIGHEST[field]

    def _slopes(self, response: CommandResponse, free: Sequence[str]) -> tuple[Array, Array]:
        """Gradient and information of the log-likelihood by the free fields."""
        data, speed = self.data, followed(self.data.command, response, self.data.begins)
        predicted = predicted_speeds(data, response, speed)
        scaled, valid = self.noise.whitened(data, data.speed - predicted)
        columns = []
        for field in free:
            if field == "scale":
                change = predicted / response.scale
            else:
                step = _PART * response.rate if field == "rate" else _STEPS[field]
                moved = response._replace(**{field: getattr(response, field) + step})
                change = (predicted_speeds(data, moved, None if field in ("lag", "rate") else speed) - predicted) / step
            columns.append(self.noise.whitened(data, change)[0])
        valid = valid & self.used
        J = np.array([column[valid] for column in columns]).reshape(len(free), -1)
        weight = self.noise.weights(scaled[valid])
        gradient, information = J @ (weight * scaled[valid]), (J * weight) @ J.T
        if "clock" in free:
            i, known = list(free).index("clock"), (0.5 * self.clock) ** -2
            gradient[i] -= known * response.clock
            information[i, i] += known
        return gradient, information

    def _sd(self, response: CommandResponse, free: Sequence[str]) -> dict[str, float]:
        _, information = self._slopes(response, free)
        covariance = np.linalg.pinv(information)
        return {field: float(np.sqrt(max(covariance[i, i], 0.0))) for i, field in enumerate(free)}


# ----------------------------------------------------------------------
# Fits of effects between commands and motors, each alone and several together, kept while they are compared.
# ----------------------------------------------------------------------


SCALE, RATE = "torque_scale", "command_rate_limit"
EFFECTS = (*PARAMETERS, LIMIT, SAG, SCALE, LOOP)
"""What the view knows about, by id; the simpler before what it is a case of."""
_WORTH = 20.0
"""Nats that an effect gains to be taken for part of what happens while the noise is estimated."""
_MOST = 3
"""Effects at most that are taken so."""
BIN, WINDOW = 0.25, 5.0
"""s over which errors are averaged, and of a window whose mean square counts."""
MOST = 200.0
"""Error, in units of noise, beyond which it counts as this."""
_SMALLEST = {"scale": SMALLEST_SCALE, "lag": SMALLEST_DELAY, "delay": SMALLEST_DELAY}
"""Departures (s where they are times) under which an effect is none."""
_UNSEEN = 8.0
"""Nats below which an effect was not seen."""
_OCCAM, _MARGIN = 8.0, 2.0
"""Nats that an effect's freedom costs here, and standard deviations that chance may take from an effect."""
NEEDED = THRESHOLDS.least(PRIOR_ODDS, FALSE_ALARM_RATE)
"""Nats that an effect has to gain to be named, unless something else is asked for."""


def lost(needed: float) -> float:
    """Nats that a size of an effect has to lose to be excluded: had it been there, it would have been named."""
    return 0.5 * (float(np.sqrt(2.0 * (needed + _OCCAM))) + _MARGIN) ** 2


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
    excluded_above: Mapping[str, float] = dataclass_field(default_factory=dict)
    excluded_below: Mapping[str, float] = dataclass_field(default_factory=dict)


@dataclass(frozen=True)
class CommandFit:
    """Some effects at their best together: log-likelihood of all of it, nats, and where that is."""

    value: float
    best: Best
    limit: Limit | None
    torques: Best | None
    loop: VelocityLoop | None = None


@dataclass(frozen=True)
class CommandFits:
    """What the view is made from; fits are kept."""

    recordings: Sequence[Experiment]
    robot: Robot
    data: CommandData
    back_torques: CommandData | None
    noise: SpeedNoise
    needed: float = NEEDED
    _fits: dict[tuple[str, ...], CommandFit] = dataclass_field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_fits", {})

    @cached_property
    def fitter(self) -> Fitter:
        """Of speeds."""
        return Fitter(self.data, self.noise, response_of(self.robot.effects), np.ones(len(self.data), bool))

    @cached_property
    def torque_fitter(self) -> Fitter | None:
        """Of the back motors' torques: their noise is what a scale leaves."""
        if self.back_torques is None:
            return None
        used = np.ones(len(self.back_torques), bool)
        rough = Fitter(self.back_torques, sensor_noise(self.back_torques), CommandResponse(), used)
        best = rough.best(("encoder_scale",))
        left = self.back_torques.speed - predicted_speeds(self.back_torques, best.response)
        known = CommandResponse(scale=float(self.robot.effects.get(SCALE, {}).get("scale", 1.0)))
        return Fitter(self.back_torques, noise_in(self.back_torques, left, used), known, used)

    def fit(self, effects: Collection[str]) -> CommandFit:
        """These effects at their best together."""
        key = tuple(sorted(effects))
        if key not in self._fits:
            self._fits[key] = self._fitted(key)
        return self._fits[key]

    def _fitted(self, effects: tuple[str, ...]) -> CommandFit:
        listed = [e for e in effects if e in PARAMETERS]
        starts = (
            [self.fit([e for e in listed if e != left]).best.response for left in listed] if len(listed) > 1 else []
        )
        if len(listed) > 1:
            starts += [self.fit([one]).best.response for one in listed]
        best = self.fitter.best(listed, starts)
        limit, loop, fitter = None, None, self.fitter
        if LOOP in effects:
            alone = best.value
            best, loop, fitter = self._looped(listed, best)
            # what speeds gain, or torques do: both are about how far motors are behind, and count once
            best = replace(best, value=max(best.value, alone + loop.nats)) if loop else best
        value = best.value
        if LIMIT in effects or SAG in effects:
            best, limit = self._limited(fitter, listed, best, SAG in effects)
            value = best.value + (limit.nats if limit else 0.0)
        torques = None
        if self.torque_fitter is not None:
            torques = self.torque_fitter.best(("encoder_scale",) if SCALE in effects else ())
            value += torques.value
        return CommandFit(value, best, limit, torques, loop)

    def _looped(self, listed: Sequence[str], best: Best) -> tuple[Best, VelocityLoop | None, Fitter]:
        """The response fitted beside a velocity loop, the loop, and fits in which it is known.

        A loop is found by what these effects leave, and they by what it leaves.
        """
        fitter, found = self.fitter, None
        for _ in range(2 if listed else 1):
            loop = self._loop_behind(best.response._replace(droop=0.0))
            if loop is None:
                break
            droop = {"droop": 1.0 / loop.gain, "integral": loop.integral, "windup": loop.windup}
            fitter = replace(self.fitter, known=self.fitter.known._replace(**droop))
            best, found = fitter.best(listed, [best.response._replace(**droop)]), loop
        return best, found, fitter

    def _loop_behind(self, response: CommandResponse) -> VelocityLoop | None:
        """The loop that explains torques beside a response, stamps as torques want them."""

        slow = self.data.slow if response.filter == 0.0 else 0.0  # a low-pass holds speeds back and not angles
        at_rest, most = stretches(self.data), self.fitter.clock

        def parts(clock: float) -> Stretches:
            asked = predicted_speeds(self.data, response._replace(clock=clock))
            return at_rest.behind((asked - self.data.speed - slow) / response.scale)

        cut = math.inf
        for _ in range(_LOOPS):
            best = minimize_scalar(
                lambda clock, cut=cut: unexplained(parts(clock), cut), bounds=(-most, most), method="bounded"
            )
            found = parts(float(best.x))
            fit = best_fit(found)
            before, cut = cut, math.inf if fit is None else fit.cut
            if cut == before or abs(cut - before) < _SAME * cut:
                break
        return None if fit is None else velocity_loop(found, fit)

    def _limited(self, fitter: Fitter, listed: Sequence[str], best: Best, line: bool) -> tuple[Best, Limit | None]:
        """The response fitted without samples that a limit explains, and the limit, or line, that is left with it."""
        find = torque_line if line else torque_limit
        limit = find(self.data, self.noise, self.data.speed - predicted_speeds(self.data, best.response))
        if limit is None or limit.nats <= 0.0 or not listed:
            return best, limit if limit is not None and limit.nats > 0.0 else None
        free = replace(fitter, used=~limit.held).best(listed, [best.response])
        again = find(self.data, self.noise, self.data.speed - predicted_speeds(self.data, free.response))
        value = fitter.value(free.response)
        if again is not None and value + again.nats > best.value + limit.nats:
            return replace(free, value=value), again
        return best, limit

    def _response(self, robot: Robot) -> CommandResponse:
        """The response that a robot's effects make; a low-pass on recorded speeds is known in any case."""
        return response_of({FILTER: self.robot.effects.get(FILTER, {}), **robot.effects})

    def plain(self) -> tuple[str, ...]:
        """Effects added one after the other while each gains plainly."""
        found: tuple[str, ...] = ()
        while len(found) < _MOST:
            gains = {e: self.nats(e, found) for e in EFFECTS if e not in found}
            best = max(gains, key=lambda e: gains[e])
            if gains[best] < _WORTH:
                break
            found = (*found, best)
        return found

    def noise_beside(self, found: Collection[str]) -> SpeedNoise:
        """Noise of speeds that these effects leave."""
        fit = self.fit(found)
        used = np.ones(len(self.data), bool) if fit.limit is None else ~fit.limit.held
        return noise_in(self.data, self.data.speed - predicted_speeds(self.data, fit.best.response), used)

    def left(self, found: Collection[str]) -> float:
        """Share of the motors' speed that these effects leave unexplained: typical error over typical speed."""
        fit = self.fit(found)
        used = self.data.counts if fit.limit is None else self.data.counts & ~fit.limit.held
        error = np.abs(self.data.speed - predicted_speeds(self.data, fit.best.response))[used]
        size = float(np.sqrt(np.mean(self.data.speed**2)))
        return 1.4826 * float(np.median(error)) / size if len(error) and size > 0.0 else 0.0

    def mixing(self, found: Collection[str]) -> Mixing | None:
        """Whether each side follows its own command alone, beside these effects."""
        fit = self.fit(found)
        used = self.data.counts if fit.limit is None else self.data.counts & ~fit.limit.held
        return mixing(self.data, predicted_speeds(self.data, fit.best.response), used)

    def remainder(self, robot: Robot) -> SlowResidual | None:
        """What a robot's effects leave of the front motors' speeds, slowly; None where there are too few samples.

        Means over BIN against the sensors' white noise, window by window, as `remains` has it of other channels.
        """
        response, data = self.fitter.with_clock(self._response(robot)), self.data
        error = data.speed - predicted_speeds(data, response)
        limit = limited(robot.effects, data, self.noise, error)
        used = data.counts if limit is None else data.counts & ~limit.held
        rows = np.column_stack([data.recording, data.motor, data.middle // WINDOW, data.middle // BIN])[used]
        scaled = np.clip(error[used] / sensor_noise(data).sigma, -MOST, MOST)
        bins, where = np.unique(rows, axis=0, return_inverse=True)
        sizes = np.bincount(where.ravel(), scaled) ** 2 / np.bincount(where.ravel())
        _, window = np.unique(bins[:, :3], axis=0, return_inverse=True)
        means = np.bincount(window.ravel(), sizes) / np.bincount(window.ravel())
        return SlowResidual(float(np.median(means)), float(np.quantile(means, 0.9))) if len(means) else None

    def evidence(self, effect: str, given: Collection[str] = ()) -> ViewEvidence:
        """Evidence of one effect on top of others."""
        base, fit = self.fit(given), self.fit((*given, effect))
        values, sd = self.parameters(effect, fit)
        nats = self.nats(effect, given)
        note = self._note(effect, nats)
        if nats >= _UNSEEN or given:
            return ViewEvidence(nats, values, sd, note)
        return ViewEvidence(nats, values, sd, note, self._excluded(effect, fit), self._excluded_limit(effect, base))

    def nats(self, effect: str, given: Collection[str] = ()) -> float:
        """Log-likelihood that one effect gains on top of others.

        A line gains what its slope does only where that is surely there; else it is worth as much as a level limit.
        """
        fit = self.fit((*given, effect))
        if not self._matters(effect, fit):
            return 0.0
        if effect == SAG and fit.limit is not None and not fit.limit.falls:
            fit = self.fit((*given, LIMIT))
        return max(fit.value - self.fit(given).value, 0.0)

    def _matters(self, effect: str, fit: CommandFit) -> bool:
        """Whether an effect is as large as to be told from what stamps and encoders leave open."""
        if effect == SAG:
            return fit.limit is not None and fit.limit.lost(fit.limit.steepest) >= SMALLEST_SAG
        if effect in (LIMIT, SCALE, LOOP):
            return True
        field_, known = PARAMETERS[effect][1], self.fitter.known
        if field_ == "rate":
            return self._trails(fit.best.response.rate)
        return abs(getattr(fit.best.response, field_) - getattr(known, field_)) >= self._smallest(field_)

    def _trails(self, rate: float) -> bool:
        """Whether a limit holds the speeds back by as much as the least delay that counts, unlike the known one."""
        command, begins = self.data.command, self.data.begins
        apart = np.abs(ramped(command, rate, begins) - ramped(command, self.fitter.known.rate, begins))
        return float(apart.max()) >= SMALLEST_DELAY * min(rate, self.data.steepest)

    def _smallest(self, field_: str) -> float:
        """Departure of a response's field under which it is none."""
        return _SMALLEST.get(field_, SMALLEST_DEADBAND * float(np.abs(self.data.command).max()))

    def parameters(self, effect: str, fit: CommandFit) -> tuple[dict[str, float], dict[str, float]]:
        """Values of an effect's parameters at a fit, and their standard deviations; none where nothing tells them."""
        if effect == LIMIT:
            if fit.limit is None:
                return {}, {}
            scale = fit.torques.response.scale if fit.torques else 1.0  # recorded over true torque
            return {"front_max": fit.limit.torque / scale}, {"front_max": fit.limit.sd / scale}
        if effect == SAG:
            return self._line(fit)
        if effect == SCALE:
            torques = fit.torques
            return ({"scale": torques.response.scale}, {"scale": torques.sd["scale"]}) if torques else ({}, {})
        if effect == LOOP:
            loop, scale = fit.loop, fit.torques.response.scale if fit.torques else 1.0
            if loop is None:
                return {}, {}
            found = {"gain": loop.gain / scale, "integral": loop.integral}
            sd = {"gain": loop.gain_sd / scale, "integral": loop.integral_sd}
            if loop.windup < math.inf:
                found["windup"], sd["windup"] = loop.windup / scale, loop.windup_sd / scale
            return found, sd
        name, field_ = PARAMETERS[effect]
        if not np.isfinite(getattr(fit.best.response, field_)):
            return {}, {}
        return {name: float(getattr(fit.best.response, field_))}, {name: fit.best.sd[field_]}

    def _line(self, fit: CommandFit) -> tuple[dict[str, float], dict[str, float]]:
        """Stall torque and no-load speed at the voltage of the recordings, and their standard deviations.

        Of a line that may be level, as steep as it may be; beside that slope its torque is as sure as a level one's.
        """
        limit, scale = fit.limit, fit.torques.response.scale if fit.torques else 1.0
        if limit is None:
            return {}, {}
        slope = limit.slope if limit.falls else limit.steepest
        stall, turning = limit.at_rest(slope), fit.best.response.scale * slope  # recorded over true speed
        found = {"stall": stall / scale, "no_load_speed": stall / turning}
        if not limit.falls:
            level = self.fit((*(e for e in fit.best.effects if e != SAG), LIMIT)).limit
            relative = level.sd / level.torque if level else 1.0
            return found, {"stall": relative * found["stall"], "no_load_speed": np.inf}
        one, other = limit.sd / limit.torque, limit.slope_sd / limit.slope
        both = math.sqrt(one**2 + other**2 - 2.0 * limit.correlation * one * other)
        return found, {"stall": one * found["stall"], "no_load_speed": both * found["no_load_speed"]}

    def _note(self, effect: str, nats: float) -> str:
        if effect == SCALE and self.torque_fitter is None:
            return "no torque of a back motor is commanded and measured"
        if effect in (LIMIT, SAG, LOOP) and not np.isfinite(self.data.torque).any():
            return "no torque of a front motor is recorded"
        if effect == LIMIT and nats == 0.0:
            return "no front motor falls short of its command at a torque that it does not exceed"
        return ""

    @property
    def _lost(self) -> float:
        return lost(self.needed)

    def _excluded(self, effect: str, fit: CommandFit) -> dict[str, float]:
        """From which departure from neutral an effect would have been seen, stamps as it wants them."""
        if effect in (LIMIT, SAG, RATE, LOOP) or (effect == SCALE and self.torque_fitter is None):
            return {}
        fitter, name, field_ = self.fitter, *PARAMETERS.get(effect, ("scale", "scale"))
        if effect == SCALE and self.torque_fitter is not None:
            fitter = self.torque_fitter
        best = fit.torques if effect == SCALE and fit.torques is not None else fit.best
        neutral = getattr(fitter.known, field_)
        for size in self._smallest(field_) * 1.5 ** np.arange(22):
            moved = [best.response._replace(**{field_: neutral + sign * float(size)}) for sign in (1.0, -1.0)]
            tried = moved if field_ == "scale" else moved[:1]
            if all(fitter.at(response) < best.value - self._lost for response in tried):
                return {name: float(size)}
        return {}

    def _excluded_limit(self, effect: str, base: CommandFit) -> dict[str, float]:
        """Below which torque a limit that is not there would have been seen."""
        if effect == RATE:
            return self._excluded_rate(base)
        if effect != LIMIT:
            return {}
        error = self.data.speed - predicted_speeds(self.data, base.best.response)
        limit = excluded_limit(self.data, self.noise, error, self._lost)
        return {"front_max": limit} if limit > 0.0 else {}

    def _excluded_rate(self, base: CommandFit) -> dict[str, float]:
        """Below which rate of commands a limit that is not there would have been seen, stamps as it wants them."""
        found: dict[str, float] = {}
        for rate in self.fitter.sizes("rate"):
            if self.fitter.at(base.best.response._replace(rate=float(rate))) > base.best.value - self._lost:
                break
            found = {PARAMETERS[RATE][0]: float(rate)}
        return found

    def gained(self, robot: Robot) -> float:
        """Log-likelihood that a robot's effects gain as they are."""
        response = self._response(robot)
        value = self.fitter.at(response)
        limit = limited(robot.effects, self.data, self.noise, self.data.speed - predicted_speeds(self.data, response))
        value += limit.nats if limit else 0.0
        if self.torque_fitter is not None:
            value += self.torque_fitter.at(CommandResponse(scale=float(robot.effects.get(SCALE, {}).get("scale", 1.0))))
        return value - self.fit(()).value

    def shown_by(self, robot: Robot) -> tuple[dict[str, CommandedLevel], dict[str, ErrorSeries]]:
        """Levels and series: as commanded, and with a robot's effects."""
        response = self._response(robot)
        return self.shown(
            response,
            limited(robot.effects, self.data, self.noise, self.data.speed - predicted_speeds(self.data, response)),
        )

    def shown(
        self, response: CommandResponse, limit: Limit | None
    ) -> tuple[dict[str, CommandedLevel], dict[str, ErrorSeries]]:
        """Levels and series: as commanded, and with a response."""
        series = series_of(self.recordings, response_of(self.robot.effects), response, self.data, limit)
        return {"front_velocity": level_of(series)}, series
