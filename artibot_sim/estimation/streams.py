"""Streams of a recording against each other: what each says of the rover's motion, and how late each is.

Nothing here knows a soil. The wheels' angles, the measured pose and the gyroscope each give forward motion or turning;
they are compared over spans of about a second, with all scales free.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.smoothing import fresh
from artibot_sim.model import MOTORS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LONGEST = 1.0
"""s to either side of which a delay is looked for."""
SPAN = 1.0
"""s over which motion is compared."""
BLOCK = 8.0
"""s that count as one independent piece of a recording."""
LEAST_BLOCKS = 6
"""Independent pieces of a recording, without which nothing is known of how a delay scatters."""
_COARSE, _FINE = 0.02, 0.004
"""s between delays that are tried, first and last."""
_MOST_ROWS = 3000
"""Rows of a comparison, at most: of more, rows are taken evenly."""
_FEWEST = 60
"""Rows of a comparison without which no delay is said."""
_NEAR = 0.12
"""s around the best delay in which the fine ones are."""
_SKEW_SHARE = 0.05
"""Share of a drift by which parabolas through each block's rest are wrong."""
_GRID = 0.01
"""s between samples of a first-order lag."""
LAGS = (0.0, 0.03, 0.06, 0.1)
"""s of first-order lag with which a rover may answer its wheels."""
_DRAWS = 200
"""Draws of blocks, by which delays and drifts scatter."""
_SHIFTS = 100
"""Shifts to other times, by which agreement by chance is known."""
_FLOOR = 0.004
"""s: no standard deviation of a delay is claimed to be less."""
_STEADY = 3.0
"""s for which equal values are held at most; what stays for longer is a value that stays."""


# ----------------------------------------------------------------------
# Held samples: a logger that is faster than a sensor repeats its values.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Holding:
    """How often a channel's columns change while they change at all.

    Attributes
    ----------
    share : float
        Of the samples that repeat the one before, while the quantity changes.
    period, stamped : float
        s between changes, and between samples.
    """

    share: float
    period: float
    stamped: float


def holding(channel: Channel, names: Sequence[str]) -> Holding | None:
    """How a channel's columns are held; None for fewer than 50 samples, or values that never change."""
    present = [name for name in names if name in channel]
    if not present:
        return None
    values = np.column_stack([channel[name] for name in present])
    used = np.isfinite(values).all(axis=1)
    t, values = channel.t[used], values[used]
    if len(t) < 50:
        return None
    differs = (values[1:] != values[:-1]).any(axis=1)
    places = np.flatnonzero(differs) + 1
    if len(places) < 20:
        return None
    step, rows = np.diff(t[places]), np.diff(places)
    moving = step < _STEADY
    if moving.sum() < 10:
        return None
    period = float(step[moving].mean())
    steps = np.abs(np.diff(values, axis=0))[differs]
    if all(len(np.unique(np.round(column[column > 0] / column[column > 0].min(), 3))) <= 3
           for column in steps.T if (column > 0).any()):  # fmt: skip
        return None  # counts of something slow, not repetitions
    return Holding(1.0 - moving.sum() / float(rows[moving].sum()), period, float(np.median(np.diff(t))))


# ----------------------------------------------------------------------
# What each stream says of the motion, summed from the start of a segment on.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class RunningSums:
    """Quantities summed since a segment's start: angles, ways. Values between samples are linear.

    Attributes
    ----------
    t : array, shape (n,)
    values : array, shape (n, k)
    """

    t: Array
    values: Array

    def at(self, t: Array) -> Array:
        """Values (…, k) at times (…)."""
        return np.stack([np.interp(t, self.t, column) for column in self.values.T], axis=-1)

    def earlier(self, by: float) -> RunningSums:
        """These sums with stamps that are `by` s earlier."""
        return RunningSums(self.t - by, self.values)

    def beside(self, other: RunningSums) -> RunningSums:
        """These sums with the columns of another one behind them, while both are known."""
        t = self.t[(self.t >= other.t[0]) & (self.t <= other.t[-1])]
        return RunningSums(t, np.hstack([self.at(t), other.at(t)]))

    def lagged(self, lag: float) -> RunningSums:
        """These sums behind a first-order low-pass with time constant `lag`, s."""
        if lag <= 0.0:
            return self
        grid = np.arange(self.t[0], self.t[-1] + _GRID, _GRID)
        table, keep = self.at(grid), float(np.exp(-_GRID / lag))
        start = table[:1] * keep
        out, _ = lfilter([1.0 - keep], [1.0, -keep], table, axis=0, zi=start)
        return RunningSums(grid, out)


def new_values(channel: Channel | None, names: Sequence[str], first: float, last: float) -> tuple[Array, Array]:
    """Times (n,), s, and values (n, k) of what is new within a segment, and of what was known last there."""
    if channel is None or not set(names) <= set(channel.columns):
        return np.empty(0), np.empty((0, len(names)))
    values = np.column_stack([channel[name] for name in names])
    finite = np.isfinite(values).all(axis=1)
    t, values = channel.t[finite], values[finite]
    inside = (t >= first - 1e-6) & (t <= last + 1e-6)
    t, values, new = t[inside], values[inside], fresh(values)[inside]
    new[-1:] = True  # it holds to the end
    return t[new], values[new]


def _integral(t: Array, rate: Array) -> Array:
    steps = 0.5 * np.diff(t)[:, None] * (rate[1:] + rate[:-1])
    return np.vstack([np.zeros((1, rate.shape[1])), np.cumsum(steps, axis=0)])


@dataclass(frozen=True)
class StreamSegment:
    """One piece of a recording without a gap, and what its streams say."""

    experiment: Experiment
    first: float
    last: float

    @cached_property
    def wheels(self) -> RunningSums | None:
        """Angles of the right and the left motor, rad, by positions where they are recorded, else by speeds."""
        return self._motors("motor_torques")

    @cached_property
    def command(self) -> RunningSums | None:
        """Sums of the wheels' speeds as they were commanded; None without commands."""
        return self._motors("motor_command")

    @cached_property
    def back_wheels(self) -> RunningSums | None:
        """Angles of the back module's motors, as `wheels`; None where they were not recorded."""
        return self._motors("motor_torques", MOTORS[2:4])

    @cached_property
    def articulation(self) -> RunningSums | None:
        """Measured angle of the first joint, rad, continuous."""
        t, angle = new_values(
            self.experiment.channels.get("joint_states"), ["articulation_yaw.position"], self.first, self.last
        )
        return RunningSums(t, np.unwrap(angle, axis=0)) if len(t) > 3 else None

    @cached_property
    def front_turning(self) -> tuple[str, RunningSums] | None:
        """How the front module turns, as the stream of that name says best: gyroscope, heading, or else its wheels."""
        if self.gyro is not None and "yaw_rate" in self.gyro_axes:
            return "imu", RunningSums(self.gyro.t, self.gyro.values[:, -1:])
        if self.heading is not None:
            return "ground_truth_odom", self.heading
        return ("motor_torques", self.wheels) if self.wheels is not None else None

    def _motors(self, key: str, motors: Sequence[str] = MOTORS[:2]) -> RunningSums | None:
        channel = self.experiment.channels.get(key)
        for quantity in ("position", "velocity"):
            t, values = new_values(channel, [f"{motor}.{quantity}" for motor in motors], self.first, self.last)
            if len(t) > 3:
                return RunningSums(t, values - values[0] if quantity == "position" else _integral(t, values))
        return None

    @cached_property
    def heading(self) -> RunningSums | None:
        """Measured heading, rad, continuous."""
        t, yaw = new_values(self.experiment.channels.get("ground_truth_odom"), ["yaw"], self.first, self.last)
        return RunningSums(t, np.unwrap(yaw, axis=0)) if len(t) > 3 else None

    @cached_property
    def points(self) -> RunningSums | None:
        """Measured positions, m."""
        for key in ("ground_truth_odom", "total_station"):
            t, place = new_values(self.experiment.channels.get(key), ["x", "y"], self.first, self.last)
            if len(t) > 3:
                return RunningSums(t, place)
        return None

    @cached_property
    def gyro(self) -> RunningSums | None:
        """Rates about the sensor's axes summed, rad; axes that are not recorded are left out, z is the last."""
        channel = self.experiment.channels.get("imu")
        if channel is None or not self.gyro_axes:
            return None
        t, rate = new_values(channel, self.gyro_axes, self.first, self.last)
        return RunningSums(t, _integral(t, rate)) if len(t) > 3 else None

    @cached_property
    def gyro_axes(self) -> tuple[str, ...]:
        """Which rates the IMU has."""
        channel = self.experiment.channels.get("imu")
        if channel is None:
            return ()
        return tuple(
            name for name in ("roll_rate", "pitch_rate", "yaw_rate")
            if name in channel and np.isfinite(channel[name]).mean() > 0.5
        )  # fmt: skip


def segments_of(experiment: Experiment) -> list[StreamSegment]:
    """The segments of a recording that last for a second at least."""
    return [StreamSegment(experiment, a, b) for a, b in experiment.segments if b - a >= 1.0]


# ----------------------------------------------------------------------
# Rows: how a measured quantity changed over a span, beside what explains it, for any delay.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class ComparisonRows:
    """A segment's rows of one comparison.

    Attributes
    ----------
    end, begin : array, shape (n,)
        The times between which the explained quantity changed, s.
    y : array, shape (n,)
        By how much.
    x : RunningSums
        What explains it.
    """

    end: Array
    begin: Array
    y: Array
    x: RunningSums


def reach(segments: Sequence[StreamSegment]) -> tuple[float, float]:
    """Span of motion, and largest delay, that segments of this length allow, s."""
    lengths = np.array([s.last - s.first for s in segments])
    usual = float(np.sum(lengths**2) / np.sum(lengths)) if len(lengths) else 0.0
    return min(SPAN, 0.25 * usual), min(LONGEST, 0.25 * usual)


def spans(t: Array, span: float, first: float, last: float) -> tuple[Indices, Indices]:
    """Places of samples and of those `span` s before them, both within two times."""
    before = np.searchsorted(t, t - span + 1e-9, side="right") - 1
    rows = np.flatnonzero((before >= 0) & (t <= last))
    rows = rows[(t[before[rows]] >= first) & (t[rows] - t[before[rows]] < 2.0 * span + 0.2)]
    return rows, before[rows]


def turning(segments: Sequence[StreamSegment], what: str, by: str) -> Iterator[ComparisonRows]:
    """Rows of turning: a heading (or the gyro's) explained by wheels or gyro."""
    span, most = reach(segments)
    for segment in segments:
        y, x = getattr(segment, what), getattr(segment, by)
        if y is None or x is None:
            continue
        rows, before = spans(y.t, span, x.t[0] + most, x.t[-1] - most)
        if len(rows):
            change = y.values[rows, -1] - y.values[before, -1]
            yield ComparisonRows(
                y.t[rows], y.t[before], change, x if by != "gyro" else RunningSums(x.t, x.values[:, -1:])
            )


def advancing(segments: Sequence[StreamSegment]) -> Iterator[ComparisonRows]:
    """Rows of forward motion: along the measured heading, or else unsigned, explained by both wheels."""
    span, most = reach(segments)
    for segment in segments:
        place, x = segment.points, segment.wheels
        if place is None or x is None:
            continue
        rows, before = spans(place.t, span, x.t[0] + most, x.t[-1] - most)
        if not len(rows):
            continue
        step = place.values[rows] - place.values[before]
        middle = 0.5 * (place.t[rows] + place.t[before])
        if segment.heading is not None:
            yaw = segment.heading.at(middle)[:, 0]
            yield ComparisonRows(place.t[rows], place.t[before], np.cos(yaw) * step[:, 0] + np.sin(yaw) * step[:, 1], x)
        else:
            turned = x.at(place.t[rows]) - x.at(place.t[before])
            sign = np.sign(turned.sum(axis=1))
            yield ComparisonRows(place.t[rows], place.t[before], sign * np.hypot(*step.T), x)


def bending(segments: Sequence[StreamSegment], late: Mapping[str, float]) -> Iterator[ComparisonRows]:
    """Rows of a joint's angle: by how both modules turn, the back one as its wheels say.

    Parameters
    ----------
    segments : sequence of StreamSegment
    late : mapping of str to float
        Stream → s by which it is stamped late.
    """
    span, most = reach(segments)
    for segment in segments:
        y, back, front = segment.articulation, segment.back_wheels, segment.front_turning
        if y is None or back is None or front is None:
            continue
        key, turned = front
        x = back.earlier(late.get("motor_torques", 0.0)).beside(turned.earlier(late.get(key, 0.0)))
        if len(x.t) < 2:
            continue
        rows, before = spans(y.t, span, x.t[0] + most, x.t[-1] - most)
        if len(rows):
            yield ComparisonRows(y.t[rows], y.t[before], y.values[rows, 0] - y.values[before, 0], x)


# ----------------------------------------------------------------------
# Delays.
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Delay:
    """By how much one stream is later than another.

    Attributes
    ----------
    value : float
        s; negative where it is earlier.
    interval : (float, float)
        95 %; infinite where the delay lies at the end of what can be looked at, or stands on too few blocks.
    agreement : float
        Share of the variance that the other explains then.
    coefficients : array
        Of the other's columns.
    spread : array
        Their standard deviations.
    skew : float
        Drift of the delay, s per s.
    skew_interval : (float, float)
    blocks : int
        Independent pieces that it stands on.
    """

    value: float
    interval: tuple[float, float]
    agreement: float
    coefficients: Array
    spread: Array
    skew: float
    skew_interval: tuple[float, float]
    blocks: int


class _Rows:
    """Rows of all pieces, and what explains them on one axis of time: a delay never leaves a row's segment."""

    def __init__(self, pieces: Sequence[ComparisonRows], trend: bool) -> None:
        every = -(-sum(len(p.y) for p in pieces) // _MOST_ROWS)
        self.pieces = [p for p in pieces if len(p.y[::every])]
        self.end, self.begin, self.y = (
            np.concatenate([getattr(p, name)[::every] for p in self.pieces]) for name in ("end", "begin", "y")
        )
        self.trend = trend
        self.weights = np.ones(len(self.y))
        _, block = np.unique(np.floor(self.end / BLOCK).astype(np.int64), return_inverse=True)
        self.block: Indices = np.asarray(block, np.int64).ravel()
        self._sums: dict[float, RunningSums] = {}

    def without_drift(self, skew: float) -> _Rows:
        """These rows, none of less weight, with what a delay grows by, s per s, taken off; in the middle times stay."""
        straight, middle = copy(self), float(self.end.mean())
        straight.begin, straight.end = (t - skew * (t - middle) for t in (self.begin, self.end))
        straight.weights = np.ones(len(self.y))
        return straight

    def sums(self, lag: float) -> RunningSums:
        """What explains, behind a low-pass, of all segments."""
        if lag not in self._sums:
            lagged = [p.x.lagged(lag) for p in self.pieces]
            self._sums[lag] = RunningSums(
                np.concatenate([x.t for x in lagged]), np.concatenate([x.values for x in lagged])
            )
        return self._sums[lag]

    def x(self, delay: float, lag: float) -> Array:
        """What explains the rows, (n, k), where the explained stream is so late."""
        return self.columns(self.begin - delay, self.end - delay, lag).T

    def columns(self, begin: Array, end: Array, lag: float) -> Array:
        """What explains rows from `begin` to `end`, column by column, (k, n)."""
        sums = self.sums(lag)
        change = [np.interp(end, sums.t, one) - np.interp(begin, sums.t, one) for one in sums.values.T]
        return np.stack([*change, end - begin] if self.trend else change)


class _Normal:
    """Normal equations of all blocks (b) for many delays (d): products of x (k columns), y and both.

    Attributes
    ----------
    xx : array, shape (b, d, k, k)
    xy : array, shape (b, d, k)
    yy : array, shape (b,)
    """

    def __init__(self, rows: _Rows, delays: Array, lag: float) -> None:
        self.rows, self.delays, self.lag = rows, delays, lag
        order = np.argsort(rows.block, kind="stable")
        w, y, begin, end, block = (a[order] for a in (rows.weights, rows.y, rows.begin, rows.end, rows.block))
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        self.yy = np.add.reduceat(w * y * y, starts)
        xx, xy = [], []
        for delay in delays.tolist():
            x = rows.columns(begin - delay, end - delay, lag)
            pairs, weighed = np.empty((len(x), len(x), len(starts))), w * x
            for i, one in enumerate(weighed):
                pairs[i, i:] = pairs[i:, i] = np.add.reduceat(one * x[i:], starts, axis=1)
            xx.append(pairs.T)
            xy.append(np.add.reduceat(weighed * y, starts, axis=1).T)
        self.xx, self.xy = np.stack(xx, axis=1), np.stack(xy, axis=1)

    def costs(self, chosen: Array | None = None) -> tuple[Array, Array]:
        """Squared rests (m, d) and coefficients (m, d, k) at every delay.

        Blocks are counted as often as each of the m rows of `chosen` (m, b) says; once without, and m is 1.
        """
        c = np.ones((1, len(self.yy))) if chosen is None else chosen
        xx, xy = ((c @ one.reshape(len(one), -1)).reshape(len(c), *one.shape[1:]) for one in (self.xx, self.xy))
        size = xx.shape[-1]
        ridge = 1e-9 * np.trace(xx, axis1=-2, axis2=-1) / size + 1e-300
        beta = np.linalg.solve(xx + ridge[..., None, None] * np.eye(size), xy[..., None])[..., 0]
        return (c @ self.yy)[:, None] - (xy * beta).sum(axis=-1), beta

    def rest(self, beta: Array) -> Array:
        """Squared rest of each block at each delay with these coefficients, shape (delays, blocks)."""
        return np.asarray(self.yy - 2.0 * (self.xy @ beta).T + (self.xx @ beta @ beta).T)


def delay_of(
    pieces: Sequence[ComparisonRows],
    most: float,
    rng: np.random.Generator,
    *,
    lags: Sequence[float] = (0.0,),
    trend: bool = False,
) -> Delay | None:
    """By how much the explained stream is later than what explains it.

    Parameters
    ----------
    pieces : sequence of ComparisonRows
    most : float
        Largest delay, s.
    rng : numpy.random.Generator
        Draws the blocks anew that intervals come from.
    lags : sequence of float
        Time constants of a first-order low-pass that may lie between both, s; the value is for the first of them, the
        interval for all.
    trend : bool
        Whether the explained stream may also drift at a constant rate, as a gyroscope's bias makes it.

    Returns
    -------
    Delay or None
        None where there is too little to compare.
    """
    if sum(len(p.y) for p in pieces) < _FEWEST:
        return None
    rows = _Rows(pieces, trend)
    found = _steady_delay(rows, most, rng, lags)
    low, high = found.skew_interval
    if not low * high > 0.0:
        return found
    drift = found.skew  # rows far from the middle had little weight: once more with the drift taken off
    found = _steady_delay(rows.without_drift(drift), most, rng, lags)
    low, high = found.skew_interval
    return replace(found, skew=drift + found.skew, skew_interval=(drift + low, drift + high))


def _steady_delay(rows: _Rows, most: float, rng: np.random.Generator, lags: Sequence[float]) -> Delay:
    """The delay that rows have in common, and how it drifts about that."""
    coarse = np.arange(-most, most + 1e-9, _COARSE)
    _reweigh(rows, _Normal(rows, coarse, 0.0))
    around = float(coarse[int(np.argmin(_Normal(rows, coarse, lags[0]).costs()[0][0]))])
    fine = np.arange(max(around - _NEAR, -most), min(around + _NEAR, most) + 1e-9, _FINE)
    near = [_Normal(rows, fine, one) for one in lags]
    table = near[0]
    (value,), (best,), (beta,) = _lowest(near[:1], None)
    count = len(table.yy)
    drawn = rng.multinomial(count, np.full(count, 1.0 / count), _DRAWS).astype(float)
    again = _lowest(near[:1], drawn)
    places = [(float(value), again.delay)]
    if len(near) > 1:  # a lag in between, or none: the interval holds both
        places.append((float(_lowest(near, None).delay[0]), _lowest(near, drawn).delay))
    factor = 2.0 if count >= LEAST_BLOCKS else np.inf  # fewer, drawn anew, do not show how far they differ
    wide = [(v, factor * max(float(np.std(values)), _FLOOR)) for v, values in places]
    low = -np.inf if value < -most + 2 * _FINE else min(v - w for v, w in wide)
    high = np.inf if value > most - 2 * _FINE else max(v + w for v, w in wide)
    skew, skew_sd = _skew(table, float(value), beta, rng)
    unsure = 2.6 * skew_sd + _SKEW_SHARE * abs(skew)
    return Delay(
        float(value), (low, high), 1.0 - float(best) / max(float(table.yy.sum()), 1e-300), beta,
        np.std(again.coefficients, axis=0), skew, (skew - unsure, skew + unsure), count,
    )  # fmt: skip


def agreement_beside_chance(
    pieces: Sequence[ComparisonRows], most: float, rng: np.random.Generator
) -> tuple[float, Array]:
    """Share of the variance that the best delay explains, and what it explains of motion at other times.

    Parameters
    ----------
    pieces : sequence of ComparisonRows
    most : float
        Largest delay, s.
    rng : numpy.random.Generator
        Draws by how much the explained motion is shifted.

    Returns
    -------
    agreement : float
    chance : array, shape (100,)
        The same with the explained motion shifted round the recording, by a tenth of it at least: streams that have
        nothing to do with each other agree as well as that.
    """
    rows = _Rows(pieces, trend=False)
    x = np.array([rows.x(delay, 0.0) for delay in np.arange(-most, most + 1e-9, _COARSE).tolist()])
    n = len(rows.y)
    shifts = rng.integers(n // 10, n - n // 10, _SHIFTS) if n >= 10 else np.zeros(_SHIFTS, np.int64)
    y = np.stack([np.roll(rows.y, shift) for shift in (0, *shifts.tolist())])
    basis, _ = np.linalg.qr(x)
    share = ((y @ basis) ** 2).sum(axis=2).max(axis=0) / max(float(rows.y @ rows.y), 1e-300)
    return float(share[0]), share[1:]


def _reweigh(rows: _Rows, table: _Normal) -> None:
    """Weigh rows by what the best delay leaves: a leap of a pose must not decide."""
    costs, betas = table.costs()
    i = int(np.argmin(costs[0]))
    rest = np.abs(rows.y - rows.x(float(table.delays[i]), table.lag) @ betas[0, i])
    rows.weights = 1.0 / (1.0 + (rest / (3.0 * 1.4826 * float(np.median(rest)) + 1e-12)) ** 2)


class _Lowest(NamedTuple):
    """Where the rest is lowest, for each choice of blocks (m): delay (m,), squared rest (m,), coefficients (m, k)."""

    delay: Array
    rest: Array
    coefficients: Array


def _lowest(tables: Sequence[_Normal], chosen: Array | None) -> _Lowest:
    """The lowest of all tables' rests, with blocks `chosen` as in `costs`; a parabola between delays."""
    found = [_lowest_of(table, *table.costs(chosen)) for table in tables]
    best = np.argmin([one.rest for one in found], axis=0)
    row = np.arange(len(best))
    return _Lowest(*(np.stack(each)[best, row] for each in zip(*found, strict=True)))


def _lowest_of(table: _Normal, costs: Array, betas: Array) -> _Lowest:
    row, i = np.arange(len(costs)), np.argmin(costs, axis=1)
    inside = np.clip(i, 1, len(table.delays) - 2)
    a, b, c = (costs[row, inside + k] for k in (-1, 0, 1))
    between = np.where(i == inside, 0.5 * _FINE * (a - c), 0.0) / np.maximum(a - 2.0 * b + c, 1e-300)
    return _Lowest(table.delays[i] + between, costs[row, i], betas[row, i])


def _skew(table: _Normal, value: float, beta: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Drift of the delay over the recording, s per s, and its standard deviation: each block has its own parabola."""
    rest, delays, rows = table.rest(beta), table.delays, table.rows
    if len(delays) < 14:
        return 0.0, np.inf
    i = int(np.clip(np.searchsorted(delays, value), 6, len(delays) - 7))
    step = 6
    a, b, c = rest[i - step], rest[i], rest[i + step]
    bend = (a - 2.0 * b + c) / (step * _FINE) ** 2
    slope = (c - a) / (2.0 * step * _FINE)
    t = np.array([rows.end[rows.block == k].mean() for k in range(len(b))])
    used = bend > 1e-3 * np.median(np.abs(bend))
    if used.sum() < LEAST_BLOCKS:
        return 0.0, np.inf
    own = np.clip(delays[i] - slope[used] / bend[used], delays[0] - 0.2, delays[-1] + 0.2)
    return _line(t[used], own, bend[used], rng)


def _line(t: Array, own: Array, weight: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Slope of values (n,) over time and its standard deviation, by blocks drawn anew."""

    def slope(rows: Indices) -> float:
        w, x, y = weight[rows], t[rows], own[rows]
        middle = float(w @ x / w.sum())
        spread = float(w @ (x - middle) ** 2)
        return float(w @ ((x - middle) * y) / spread) if spread > 0 else 0.0

    weight = np.minimum(weight, 4.0 * np.median(weight))
    every = np.arange(len(t))
    drawn = [slope(rng.integers(0, len(t), len(t))) for _ in range(_DRAWS)]
    return slope(every), float(np.std(drawn))
