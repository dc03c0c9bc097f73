"""Where and when a model is wrong: errors with what the rover did meanwhile, and sentences computed from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.records import ChannelBaseline, Comparison, ErrorLocation, ErrorSeries
from artibot_sim.diagnose.words import amount, is_wrong
from artibot_sim.identify.result import number

# ----------------------------------------------------------------------
# Errors of one channel over all recordings, each sample with what the rover did at that instant.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

COVARIATES = ("speed", "yaw_rate", "heading", "articulation_yaw", "x", "y", "load", "acceleration")
"""What is known of every sample: those of `Comparison.covariates`, and the speed's change, m/s²."""
_SMOOTH = 0.3
"""s over which a speed's change is taken."""


@dataclass(frozen=True)
class ErrorSamples:
    """Errors of a channel.

    Attributes
    ----------
    channel : str
    t : array, shape (n,)
        s since the recording's start.
    comparison : array of int, shape (n,)
        Which recording.
    before, after : array, shape (n, k)
        Predicted − measured, SI; k is 2 for positions, else 1: each motor has samples of its own.
    noise : float
        Standard deviation of one coordinate.
    at : mapping of str to array, shape (n,)
        COVARIATES at those instants; NaN where they are not known.
    """

    channel: str
    t: Array
    comparison: NDArray[np.int64]
    before: Array
    after: Array
    noise: float
    at: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.t)

    @property
    def size(self) -> Array:
        """Absolute errors (n,) of the paper's model; of positions the distance."""
        return sizes(self.before)

    @property
    def level(self) -> float:
        """The noise of `size`."""
        return self.noise * float(np.sqrt(self.before.shape[1]))


def sizes(errors: Array) -> Array:
    """Absolute errors (n,) of errors (n,) or (n, k)."""
    return np.abs(errors) if errors.ndim == 1 else np.asarray(np.linalg.norm(errors, axis=1))


def gather(comparisons: Sequence[Comparison], channel: str) -> ErrorSamples | None:
    """The errors of a channel in all recordings, None where none has any; lost predictions are left out."""
    parts = []
    for index, comparison in enumerate(comparisons):
        series = comparison.channels.get(channel)
        if series is not None and len(series.t):
            parts.append(_part(index, channel, comparison, series))
    if not parts:
        return None
    which, t, before, after = (np.concatenate(column) for column in zip(*(part[:4] for part in parts), strict=True))
    at = {name: np.concatenate([part[4][name] for part in parts]) for name in COVARIATES}
    noise = float(
        np.sqrt(
            np.mean(
                [
                    comparison.channels[channel].noise ** 2
                    for comparison in comparisons
                    if channel in comparison.channels
                ]
            )
        )
    )
    return ErrorSamples(channel, t, which, before, after, noise, at)


def _part(
    number: int, channel: str, comparison: Comparison, series: ErrorSeries
) -> tuple[NDArray[np.int64], Array, Array, Array, dict[str, Array]]:
    before, after, t = series.before, series.after, series.t
    if channel != "position":
        t = np.repeat(t, before.size // max(len(before), 1))
        before, after = before.reshape(-1, 1), after.reshape(-1, 1)
    kept = np.isfinite(before).all(axis=1)
    t = t[kept]
    return np.full(len(t), number), t, before[kept], after[kept], covariates_at(comparison, t)


def covariates_at(comparison: Comparison, t: Array) -> dict[str, Array]:
    """What the rover did at times (n,) of a recording; NaN where it is not known."""
    grid = comparison.covariates.get("t")
    nothing = np.full(len(t), np.nan)
    if grid is None or len(grid) < 2:
        return dict.fromkeys(COVARIATES, nothing)
    table = dict(comparison.covariates)
    if "speed" in table:
        table["acceleration"] = _slope(grid, table["speed"])
    found = {}
    for name in COVARIATES:
        values = table.get(name, nothing)
        if name == "heading" and name in table:  # angles wrap
            found[name] = np.arctan2(np.interp(t, grid, np.sin(values)), np.interp(t, grid, np.cos(values)))
        else:
            found[name] = np.interp(t, grid, values) if name in table else nothing
    return found


def _slope(t: Array, values: Array) -> Array:
    """Change a second of values (n,), smoothed."""
    size = max(1, round(_SMOOTH / max(float(np.median(np.diff(t))), 1e-3)))
    if len(t) <= 2 * size:
        return np.gradient(values, t)
    kernel = np.ones(size) / size
    smooth = np.convolve(np.pad(values, size, mode="edge"), kernel, "same")[size:-size]
    return np.gradient(smooth, t)


# ----------------------------------------------------------------------
# Conditions under which a rover drives, as people would name them: what errors are sorted by.
# ----------------------------------------------------------------------


Mask = NDArray[np.bool_]

TURNING = 0.08
"""rad/s from which a rover turns."""
STANDING = 0.03
"""m/s and rad/s below which it stands."""
_CHANGING = 0.08
"""m/s² from which it speeds up or slows down."""
_QUANTILES = (0.6, 0.75, 0.9)
_SECTOR = np.pi / 4
"""rad to either side of a heading."""
_GRID = 0.7
_RADII = (1.0, 1.6, 2.4)
"""m between centres of discs, and their radii."""


@dataclass(frozen=True)
class Condition:
    """When something is so.

    Attributes
    ----------
    said : str
        Goes on from "most of the error …".
    mask : array of bool, shape (n,)
        The samples that it holds for.
    local : bool
        Whether it is about a place or a time, which other recordings may not have.
    """

    said: str
    mask: Mask
    local: bool = False


def conditions(samples: ErrorSamples) -> Iterator[Condition]:
    """All conditions that the recordings allow to look for."""
    yield from _manoeuvres(samples)
    yield from _amounts(samples)
    yield from _headings(samples.at["heading"])
    yield from _times(samples.t)
    yield from _discs(samples.at["x"], samples.at["y"])


def _known(*columns: Array) -> bool:
    return all(np.isfinite(column).any() for column in columns)


def _manoeuvres(samples: ErrorSamples) -> Iterator[Condition]:
    speed, rate, change = (samples.at[name] for name in ("speed", "yaw_rate", "acceleration"))
    if not _known(speed, rate):
        return
    stands = (np.abs(speed) < STANDING) & (np.abs(rate) < STANDING)
    yield Condition("while the rover stands", stands)
    yield Condition("on straight stretches", ~stands & (np.abs(rate) < TURNING))
    yield Condition("in turns", np.abs(rate) >= TURNING)
    yield Condition("in left turns", rate >= TURNING)
    yield Condition("in right turns", rate <= -TURNING)
    yield Condition("while it drives backwards", speed < -STANDING)
    yield Condition("while it speeds up", change > _CHANGING)
    yield Condition("while it slows down", change < -_CHANGING)
    yield Condition("while its speed changes", np.abs(change) > _CHANGING)


def _amounts(samples: ErrorSamples) -> Iterator[Condition]:
    for name, what, unit in (
        ("speed", "at speeds", "m/s"),
        ("yaw_rate", "at yaw rates", "rad/s"),
        ("articulation_yaw", "with the joint at angles", "rad"),
        ("load", "with motor torques in all", "N·m"),
    ):
        values = np.abs(samples.at[name])
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        for share in _QUANTILES:
            limit = float(np.quantile(known, share))
            yield Condition(f"{what} above {number(limit, 2)} {unit}", values > limit)
        low = float(np.quantile(known, 1 - _QUANTILES[0]))
        yield Condition(f"{what} below {number(low, 2)} {unit}", values < low)
    bend = samples.at["articulation_yaw"]
    if _known(bend):
        limit = float(np.nanquantile(np.abs(bend), 0.5))
        yield Condition(f"with articulation angles above {number(limit, 2)} rad", bend > limit)
        yield Condition(f"with articulation angles below −{number(limit, 2)} rad", bend < -limit)


def _headings(heading: Array) -> Iterator[Condition]:
    if not _known(heading):
        return
    for middle in np.arange(-np.pi, np.pi - 1e-9, _SECTOR):
        away = np.abs(np.angle(np.exp(1j * (heading - middle))))
        named = f"{number(float(middle), 2)} rad ± 45°".replace("-", "−") if middle else "0 rad ± 45°"
        yield Condition(f"while it heads towards {named} in map", away < _SECTOR)


def _times(t: Array) -> Iterator[Condition]:
    last = float(t.max())
    for share in (0.2, 1 / 3, 0.5):
        yield Condition(f"in the first {share * last:.0f} s", t < share * last, True)
        yield Condition(f"after {(1 - share) * last:.0f} s", t > (1 - share) * last, True)


def _discs(x: Array, y: Array) -> Iterator[Condition]:
    if not _known(x, y):
        return
    cells = np.unique(np.round(np.column_stack([x, y])[np.isfinite(x) & np.isfinite(y)] / _GRID), axis=0) * _GRID
    for x_c, y_c in cells.tolist():
        away = np.hypot(x - x_c, y - y_c)
        for radius in _RADII:
            said = f"within {radius:g} m of ({x_c:.1f}, {y_c:.1f}) m".replace("-", "−")
            yield Condition(said, away < radius, True)


# ----------------------------------------------------------------------
# Where and when a model is wrong: sentences computed from its errors and from what the rover did meanwhile.
# ----------------------------------------------------------------------


_LEAST_SHARE = 0.45
"""Share of the squared error that a condition must hold to be named."""
_LEAST_LIFT = 1.5
"""Share of the squared error over share of the time, from which a condition is named."""
_RARE = 0.02
"""Share of the time that a condition must last at least."""
_RARE_PLACE = 0.004
"""Share of the time that a condition on place or time must last at least: a rover passes them once."""
_MANY = 0.6
"""How much the surprise of a place or a time counts: there are hundreds to choose from, so some fit by chance."""
_COMMON = 0.85
"""Share of the time that a condition may last at most: what is always so tells nothing."""
_CAP = 0.95
"""Quantile at which squared errors are cut, so that no single moment speaks for a manoeuvre."""
_AGREE = 0.6
"""Share of the recordings in which a condition must hold more than its share of the error."""
_ONE_WAY = 0.6
"""Errors of positions whose mean is so much of their mean size point one way."""
_FOLLOWS = 0.5
"""Share of the squared error that following a quantity must explain to be said."""
_BLOCK = 5.0
"""s of the moment that is reported as the worst."""
_FAR = 6.0
"""Error over the noise from which it is far out."""
_MOMENT = 0.1
"""s to either side of a far error that belong to its moment."""
_MOMENTS_TIME = 0.1
"""Share of the time that moments last at most for an error to be theirs."""
_MOMENTS_SHARE = 0.9
"""Share of the squared error that moments hold at least for an error to be theirs."""
_MOMENTS_REST = 2.0
"""Error over the noise elsewhere, at most, for an error to be that of moments."""


def places(comparisons: Sequence[Comparison], baseline: Mapping[str, ChannelBaseline]) -> tuple[ErrorLocation, ...]:
    """Sentences on each channel that is wrong, the worst channel first: how much, when, in which manoeuvre, which way.

    Parameters
    ----------
    comparisons : sequence of Comparison
    baseline : mapping of str to ChannelBaseline
        The channels to look at, with their errors and noise.
    """
    ratios = {name: base.over_noise for name, base in baseline.items() if is_wrong(name, base)}
    found: list[ErrorLocation] = []
    for channel in sorted(ratios, key=lambda name: -ratios[name]):
        samples = gather(comparisons, channel)
        if samples is not None and len(samples) > 1:
            found += [ErrorLocation(channel, said) for said in _sentences(samples, comparisons, baseline[channel])]
    return tuple(found)


def _sentences(samples: ErrorSamples, comparisons: Sequence[Comparison], base: ChannelBaseline) -> Iterator[str]:
    own = "each sample's own noise" if np.isfinite(base.weighted_rmse) else "the noise"
    head = f"off by {amount(base.rmse, base.unit)} (RMSE), {number(base.over_noise, 2)} times {own}"
    where = moments(samples)
    if not where:
        found = concentration(samples)
        where = found.said if found else "spread over all that was driven"
    yield f"{head}; {where}"
    yield worst_moment(samples, comparisons, base.unit)
    way = direction(samples) if samples.before.shape[1] == 2 else followed(samples, base.unit)
    if way:
        yield way


def moments(samples: ErrorSamples) -> str:
    """Where the error is that of a few moments and small elsewhere: how many, how long; else empty.

    A motor that jumps to another speed does so between two samples. Which torque it took is in none of them.
    """
    far = samples.size > _FAR * samples.level
    near, count = np.zeros(len(samples), bool), 0
    for number_ in np.unique(samples.comparison[far]):
        mine = samples.comparison == number_
        t = np.unique(samples.t[mine & far])
        after = np.searchsorted(t, samples.t[mine])
        around = np.append(np.insert(t, 0, -np.inf), np.inf)
        away = np.minimum(samples.t[mine] - around[after], around[after + 1] - samples.t[mine])
        near[mine] = away <= _MOMENT
        count += 1 + int((np.diff(t) > 2 * _MOMENT).sum())
    squares = np.maximum(samples.size**2 - samples.level**2, 0.0)
    if not near.any() or near.mean() > _MOMENTS_TIME or squares[near].sum() < _MOMENTS_SHARE * squares.sum():
        return ""
    rest = float(np.sqrt(np.mean(samples.size[~near] ** 2))) / samples.level
    if rest > _MOMENTS_REST:
        return ""
    return (
        f"{100 * squares[near].sum() / squares.sum():.0f} % of it (squared) in {count} moment{'s' * (count > 1)}, "
        f"{100 * near.mean():.1f} % of the time, as where a motor's speed jumps between two samples; elsewhere "
        f"{number(rest, 2)} times the noise"
    )


@dataclass(frozen=True)
class Concentration:
    """A condition that holds more of the error than of the time.

    Attributes
    ----------
    condition : Condition
    error, time : float
        Its shares of the squared error (beyond noise) and of the samples.
    """

    condition: Condition
    error: float
    time: float

    @property
    def said(self) -> str:
        """A sentence's part."""
        return f"{100 * self.error:.0f} % of it (squared) {self.condition.said}, {100 * self.time:.0f} % of the time"


def concentration(samples: ErrorSamples) -> Concentration | None:
    """The condition under which the error sits, None where it sits nowhere in particular.

    Of all conditions that hold most of the error, it is the one whose share of the error is most surprising given its
    share of the time (relative entropy of the two shares).
    """
    squares = np.maximum(samples.size**2 - samples.level**2, 0.0)
    capped = np.minimum(squares, np.quantile(squares, _CAP))
    best, most = None, 0.0
    for condition in conditions(samples):
        counted = squares if condition.local else capped
        if counted.sum() <= 0:
            continue
        e, p = float(counted[condition.mask].sum() / counted.sum()), float(condition.mask.mean())
        rare = _RARE_PLACE if condition.local else _RARE
        if not (rare < p < _COMMON and e > _LEAST_SHARE and e > _LEAST_LIFT * p):
            continue
        if not _agree(samples, counted, condition.mask):
            continue
        surprise = _entropy(e, p) * (_MANY if condition.local else 1.0)
        if surprise > most:
            best, most = Concentration(condition, e, p), surprise
    return best


def _entropy(e: float, p: float) -> float:
    """Relative entropy of shares e and p, nats."""
    rest = (1.0 - e) * np.log((1.0 - e) / (1.0 - p)) if e < 1.0 else 0.0
    return float(e * np.log(e / p) + rest)


def _agree(samples: ErrorSamples, squares: Array, mask: NDArray[np.bool_]) -> bool:
    """Whether most recordings in which a condition occurs show it."""
    votes = []
    for number_ in np.unique(samples.comparison):
        mine = samples.comparison == number_
        p, total = mask[mine].mean(), squares[mine].sum()
        if _RARE < p < 1.0 and total > 0:
            votes.append(squares[mine & mask].sum() / total > p)
    return not votes or float(np.mean(votes)) >= _AGREE


def worst_moment(samples: ErrorSamples, comparisons: Sequence[Comparison], unit: str) -> str:
    """When it is worst, and what the rover did then."""
    block = np.floor(samples.t / _BLOCK).astype(np.int64)
    names, rows = np.unique(np.column_stack([samples.comparison, block]), axis=0, return_inverse=True)
    rows = rows.reshape(-1)
    count = np.bincount(rows)
    mean = np.bincount(rows, samples.size**2) / count
    mean[count < 0.2 * np.median(count)] = 0.0
    worst = int(np.argmax(mean))
    mine = rows == worst
    comparison, t = comparisons[int(names[worst, 0])], samples.t[mine]
    doing = _doing({name: values[mine] for name, values in samples.at.items()})
    return (
        f"worst in {comparison.name} from {t.min():.0f} to {t.max():.0f} s, {amount(float(np.sqrt(mean[worst])), unit)}"
        f"{': ' if doing else ''}{doing}"
    )


def _doing(at: Mapping[str, Array]) -> str:
    """What a rover does over some samples: manoeuvre, speed, heading, joint, place, load."""
    mean = {name: float(np.mean(values)) for name, values in at.items()}
    said = []
    if np.isfinite(mean["yaw_rate"]) and np.isfinite(mean["speed"]):
        rate, speed = mean["yaw_rate"], mean["speed"]
        if abs(speed) < 0.03 and abs(rate) < 0.03:
            said.append("standing")
        else:
            turn = "turning left" if rate > 0.08 else "turning right" if rate < -0.08 else "going straight"
            said.append(f"{turn} at {amount(speed, 'm/s')}")
    if np.isfinite(at["heading"]).all():
        heading = float(np.angle(np.mean(np.exp(1j * at["heading"]))))
        said.append(f"heading {number(heading, 2)} rad")
    if np.isfinite(mean["articulation_yaw"]):
        said.append(f"joint at {number(mean['articulation_yaw'], 2)} rad")
    if np.isfinite(mean["x"]) and np.isfinite(mean["y"]):
        x, y = (round(mean[name], 1) + 0.0 for name in ("x", "y"))  # there is no place −0.0
        said.append(f"near ({x:.1f}, {y:.1f}) m")
    if np.isfinite(mean["load"]):
        said.append(f"motor torques {amount(mean['load'], 'N m')} in all")
    return ", ".join(said).replace("-", "−")


def direction(samples: ErrorSamples) -> str:
    """Which way the rover is off its predictions, in `map` or in its own frame; empty where all ways are alike."""
    off = -samples.before
    heading = samples.at["heading"]
    mean_size = float(np.mean(samples.size))
    if mean_size <= 0:
        return ""
    best, said = _ONE_WAY, ""
    in_map = off.mean(axis=0) if np.isfinite(samples.at["x"]).any() else np.zeros(2)
    if (share := float(np.hypot(*in_map)) / mean_size) > best:
        towards = float(np.arctan2(in_map[1], in_map[0]))
        best = share
        said = (
            f"the rover is found to one side of its predictions, towards {number(towards, 2)} rad "
            f"({np.degrees(towards):.0f}°) in map, by {amount(float(np.hypot(*in_map)), 'm')} on average"
        )
    if np.isfinite(heading).all():
        c, s = np.cos(heading), np.sin(heading)
        own = np.array([np.mean(c * off[:, 0] + s * off[:, 1]), np.mean(c * off[:, 1] - s * off[:, 0])])
        if float(np.hypot(*own)) / mean_size > best:
            axis = int(np.argmax(np.abs(own)))
            name = (("ahead of", "behind"), ("to the left of", "to the right of"))[axis][int(own[axis] < 0)]
            said = f"the rover is found {name} its predictions, by {amount(float(abs(own[axis])), 'm')} on average"
    return said.replace("-", "−")


_YAW_RATE = ("yaw_rate", "yaw rate", "rad/s")
_SPEED = ("speed", "speed", "m/s")
_LOAD = ("load", "load", "N·m")
_FOLLOWED = {
    "yaw_rate": (_YAW_RATE,),
    "articulation_yaw": (("articulation_yaw", "articulation angle", "rad"), _YAW_RATE),
    "yaw": (_YAW_RATE,),
    "front_velocity": (("acceleration", "acceleration", "m/s²"), _SPEED),
    "torque_front": (_LOAD, _SPEED),
    "torque_back": (_LOAD, _SPEED),
}
"""Channel → what its error may follow: column, words and unit of each."""


def followed(samples: ErrorSamples, unit: str) -> str:
    """What the error of a scalar channel follows, or its mean where it is always the same; empty where neither is."""
    error = samples.before[:, 0]
    total = float(np.sum(error**2))
    if total <= 0:
        return ""
    mean = float(error.mean())
    best, said = _FOLLOWS, ""
    if (share := len(error) * mean**2 / total) > best:
        best = share
        said = f"the model is too {'high' if mean > 0 else 'low'} by {amount(abs(mean), unit)} on average"
    for name, words, per in _FOLLOWED.get(samples.channel, ()):
        x = samples.at[name]
        if not np.isfinite(x).all() or not np.any(x):
            continue
        slope = float(x @ error / (x @ x))
        if slope**2 * float(x @ x) / total > best:
            best = slope**2 * float(x @ x) / total
            said = f"the error follows the {words}: {amount(slope, unit)} for each {per}"
            if name == samples.channel:
                many = "much" if slope > 0 else "little"
                said = f"the error follows the {words} itself: the model gives {100 * abs(slope):.0f} % too {many}"
    return said
