"""Commands of the front motors and what they did, laid out so that any response of the motors is quickly computed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from artibot_sim.experiment import Channel, Experiment
from artibot_sim.experiment.inputs import GAP
from artibot_sim.experiment.smoothing import fresh, noise_of
from artibot_sim.model import MOTORS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Places = NDArray[np.int64]

H = 0.005
"""s, spacing of the grid on which commands are followed."""
SPAN = 0.04
"""s over which measured speeds are averaged: motors do little in less, and what encoders count is coarse."""
GUARD = 3.0
"""s before a part for which its motor is taken to have done what it did at first."""
_BEGUN = 0.5
"""s after the beginning of a part that begins in motion which do not count: nobody knows what was commanded before."""
_STILL, _SLOW = 1e-3, 0.02
"""Shares of the largest commanded speed: up to one is standstill, from the other on is motion."""
_SHORT = 0.5
"""s that a part lasts at least."""
_BREAK = 0.15
"""s without a measurement that no speed is averaged over."""
_FEW, _SOME = 8, 800
"""Parts, and samples of each, that say how noisy angles and speeds are."""


_SLOWLY = 1.0
"""s over which angles say better than the sum of speeds how far a motor has turned."""
_ALIKE = 0.05
"""Share of recorded speeds by which angles may differ from them over that time, to be of the same motor."""
_LEAST = 8
"""Measurements in a part, below which it says nothing."""


@dataclass(frozen=True)
class CommandData:
    """Commanded and measured speeds of the front motors of some recordings, part by part.

    Attributes
    ----------
    command : array, shape (g,)
        Commanded speeds (rad/s) on a grid H apart, all parts one after the other, each led by GUARD of what the motor
        did at first.
    begins : array of int, shape (parts,)
        Where on that grid each part begins.
    at : array, shape (n, k)
        Places on that grid. A measured speed is the mean of those at k instants; or, with `rise`, over the time
        between two.
    rise : bool
    speed : array, shape (n,)
        Measured, rad/s.
    torque : array, shape (n,)
        Measured meanwhile, N m; NaN where there is none.
    whole : array of bool, shape (n, lags)
        Whether the samples so many before belong to the same part without a gap.
    counts : array of bool, shape (n,)
        False where nobody knows what was commanded before.
    recording, motor : array of int, shape (n,)
        Which recording, and which of MOTORS.
    middle : array, shape (n,)
        s since the recording's start.
    period : float
        Typical spacing of the commands, s.
    slow : array, shape (n,)
        What recorded angles have recorded speeds lack over _SLOWLY, rad/s; zero with `rise`, and where none are
        recorded. The sum of noisy speeds wanders, and angles do not.
    """

    command: Array
    begins: Places
    at: Array
    rise: bool
    speed: Array
    torque: Array
    whole: Flags
    counts: Flags
    recording: Places
    motor: Places
    middle: Array
    period: float
    slow: Array

    def __len__(self) -> int:
        return len(self.speed)

    @cached_property
    def steepest(self) -> float:
        """Fastest change of a command within a part, rad/s²: from one part to the next nothing was commanded."""
        inside = np.diff(self.command) / H
        for begin in self.begins:
            inside[max(begin - 1, 0) : begin + round(GUARD / H)] = 0.0
        return float(np.abs(inside).max())

    @cached_property
    def valid(self) -> Flags:
        """Samples that count, with all that came before them, shape (n,)."""
        return np.asarray(self.whole.all(axis=1) & self.counts)


class _Part(NamedTuple):
    """One front motor through a stretch in which it was commanded without a gap."""

    recording: int
    motor: int
    t: Array  # of the commands
    command: Array
    angle: tuple[Array, Array]  # times and angles; empty where none were recorded
    speed: tuple[Array, Array]
    torque: tuple[Array, Array]


LAGS = 3
"""Samples back to which errors are taken to be alike."""


def command_data(recordings: Sequence[Experiment], quantity: str = "velocity") -> CommandData | None:
    """What motors were told and did in `recordings`; None where no part has both.

    With the quantity ``"effort"`` it is the back motors, and all speeds are torques, N m.
    """
    parts = [part for k, recording in enumerate(recordings) for part in _parts(k, recording, quantity)]
    rise = bool(parts) and _by_angles(parts)
    pieces, grid, begins, base = [], [], [], 0
    for part in parts:
        piece = _piece(part, rise, base)
        if piece is None:
            continue
        first, last = part.t[0], part.t[-1]
        knots = first + H * np.arange(int(np.ceil((last - first) / H)) + 2)
        lead = np.full(round(GUARD / H), _before(part, piece))
        grid.append(np.concatenate([lead, np.interp(knots, part.t, part.command)]))
        begins.append(base)
        base += len(grid[-1])
        pieces.append(piece)
    if not pieces:
        return None
    joined = [np.concatenate(column) for column in zip(*pieces, strict=True)]
    at, speed, torque, whole, counts, recording, motor, slow, middle = joined
    period = float(np.median(np.concatenate([np.diff(part.t) for part in parts])))
    return CommandData(
        np.concatenate(grid), np.array(begins), at, rise, speed, torque, whole, counts, recording, motor, middle,
        period, slow,
    )  # fmt: skip


def _parts(number: int, experiment: Experiment, quantity: str) -> Iterator[_Part]:
    commands, motors = experiment.channels.get("motor_command"), experiment.channels.get("motor_torques")
    if commands is None or motors is None:
        return
    names = ("position", "velocity", "effort") if quantity == "velocity" else ("", "effort", "")
    which = [i for i in ((0, 1) if quantity == "velocity" else (2, 3)) if f"{MOTORS[i]}.{quantity}" in commands]
    measured = {i: [fresh_column(motors, f"{MOTORS[i]}.{name}") for name in names] for i in which}
    for (t_start, t_end), i in product(experiment.segments, which):
        t, speed = commands.between(t_start - 1e-6, t_end + 1e-6).series(f"{MOTORS[i]}.{quantity}")
        breaks = np.flatnonzero(np.diff(t) > GAP) + 1
        for part_t, part_speed in zip(np.split(t, breaks), np.split(speed, breaks), strict=True):
            if len(part_t) < 4 or part_t[-1] - part_t[0] < _SHORT or not part_speed.any():
                continue
            yield _Part(number, i, part_t, part_speed, *(_between(*one, part_t[0], part_t[-1]) for one in measured[i]))


def fresh_column(channel: Channel, name: str) -> tuple[Array, Array]:
    """Times and values of a column, held samples left out; empty where it is not recorded."""
    if name not in channel:
        return np.empty(0), np.empty(0)
    t, values = channel.series(name)
    new = fresh(values)
    return t[new], values[new]


def _between(t: Array, values: Array, begin: float, end: float) -> tuple[Array, Array]:
    inside = (t >= begin) & (t <= end)
    return t[inside], values[inside]


def _by_angles(parts: Sequence[_Part]) -> bool:
    """Whether mean speeds are better known from angles than from recorded speeds: in more of the parts, or better."""
    turned, spoken = ([len(getattr(part, name)[0]) >= _LEAST for part in parts] for name in ("angle", "speed"))
    lasting = np.array([part.t[-1] - part.t[0] for part in parts])
    if turned != spoken and lasting[turned].sum() != lasting[spoken].sum():
        return bool(lasting[turned].sum() > lasting[spoken].sum())
    some = [part for part, *both in zip(parts, turned, spoken, strict=True) if all(both)][:_FEW]
    if not some:
        return False
    risen = [_risen(*part.angle) for part in some]
    angles = [noise_of(t[:_SOME].mean(axis=1), speed[:_SOME]) for t, speed in risen]
    speeds = [noise_of(*(column[:_SOME] for column in part.speed)) / np.sqrt(_stride(part.speed[0])) for part in some]
    return bool(np.nanmedian(angles) < np.nanmedian(speeds))


def _stride(t: Array) -> int:
    """Samples that make up SPAN."""
    return max(1, round(SPAN / float(np.median(np.diff(t))))) if len(t) > 1 else 1


def _risen(t: Array, angle: Array) -> tuple[Array, Array]:
    """Ends of intervals, shape (n, 2), and mean speeds over them, from angles."""
    step = _stride(t)
    ends = np.column_stack([t[:-step:step], t[step::step]])
    rise = angle[step::step] - angle[:-step:step]
    kept = (ends[:, 1] - ends[:, 0] > 1e-4) & (ends[:, 1] - ends[:, 0] < max(_BREAK, 2.5 * step * _usual(t)))
    return ends[kept], rise[kept] / (ends[kept, 1] - ends[kept, 0])


def _usual(t: Array) -> float:
    return float(np.median(np.diff(t))) if len(t) > 1 else 1.0


def _averaged(t: Array, speed: Array) -> tuple[Array, Array]:
    """Instants whose speeds are averaged, shape (n, k), and the means."""
    step = _stride(t)
    count = len(t) // step
    at, means = t[: count * step].reshape(count, step), speed[: count * step].reshape(count, step)
    kept = at[:, -1] - at[:, 0] < max(_BREAK, 2.5 * step * _usual(t))
    return at[kept], means[kept].mean(axis=1)


def _piece(part: _Part, rise: bool, base: int) -> tuple[Array, ...] | None:
    """The columns of `CommandData` for a part whose grid begins at place `base`."""
    times, values = part.angle if rise else part.speed
    if len(times) < _LEAST:
        return None
    t, speed = _risen(times, values) if rise else _averaged(times, values)
    if len(t) < LAGS + 2:
        return None
    middle = t.mean(axis=1)
    step = float(np.median(np.diff(middle)))
    whole = np.zeros((len(t), LAGS), bool)
    for lag in range(1, LAGS + 1):
        whole[lag:, lag - 1] = middle[lag:] - middle[:-lag] < (lag + 0.6) * step
    counts = middle > part.t[0] + _BEGUN if _moving(part, _SLOW) else np.ones(len(t), bool)
    torque = np.full(len(t), np.nan)
    if len(part.torque[0]) > 3:
        torque = _mean_between(*part.torque, t[:, 0], t[:, -1])
    at = (t - part.t[0]) / H + base + round(GUARD / H)
    size = len(t)
    slow = np.zeros(size) if rise or len(part.angle[0]) < _LEAST else _slowly(part.angle, t, speed, whole[:, 0])
    return at, speed, torque, whole, counts, np.full(size, part.recording), np.full(size, part.motor), slow, middle


def _slowly(angle: tuple[Array, Array], t: Array, speed: Array, goes_on: Flags) -> Array:
    """What angles say of speeds (n,), which are means over instants (n, k), beyond the speeds themselves, rad/s."""
    middle, found = t.mean(axis=1), np.zeros(len(t))
    turned = np.interp(t.ravel(), *angle).reshape(t.shape).mean(axis=1)
    edges = np.flatnonzero(np.concatenate(([True], ~goes_on[1:], [True])))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        at = middle[begin:end]
        if len(at) < _LEAST or at[-1] - at[0] < 2.0 * _SLOWLY:
            continue
        rises = 0.5 * (speed[begin + 1 : end] + speed[begin : end - 1]) * np.diff(at)
        apart = turned[begin:end] - np.concatenate(([0.0], np.cumsum(rises)))
        width = max(3, round(_SLOWLY / float(np.median(np.diff(at)))))
        found[begin:end] = savgol_filter(apart, 2 * (width // 2) + 1, 1, deriv=1) / float(np.median(np.diff(at)))
    if np.square(found).mean() > _ALIKE**2 * np.square(speed).mean():
        return np.zeros(len(t))  # they are not the angles of these speeds
    return found


def _moving(part: _Part, share: float) -> bool:
    """Whether a part begins with a command of more than this share of its largest."""
    return bool(np.abs(part.command[0]) > share * np.abs(part.command).max())


def _before(part: _Part, piece: tuple[Array, ...]) -> float:
    """Speed at the beginning of a part: what a lag begins from, which nobody knows the commands of."""
    if not _moving(part, _STILL):
        return float(part.command[0])
    speed, middle = piece[1], piece[-1]
    return float(speed[0] + (speed[2] - speed[0]) / (middle[2] - middle[0]) * (part.t[0] - middle[0]))


def _mean_between(t: Array, values: Array, begin: Array, end: Array) -> Array:
    """Means (n,) of samples taken from `begin` to `end`, the nearest one where there is none."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    first, last = np.searchsorted(t, begin - 1e-6), np.searchsorted(t, end + 1e-6)
    near = np.interp(0.5 * (begin + end), t, values)
    count = last - first
    return np.where(count > 0, (total[last] - total[first]) / np.maximum(count, 1), near)
