"""What the wheels' currents say of torques: up to a constant and an offset, which the recordings themselves give.

`/motor_currents` says amperes, and seldom of what: of the motor, with its sign or without, or of what its drive takes
from the battery, which follows power. Each of these is held against the torques that the model needs to move as the
recording says. What explains the currents best turns them into torques, whose scale a fit leaves open (`SCALE`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.measurements import motor_pairs
from artibot_sim.estimation.parameters import Prior
from artibot_sim.estimation.windows import predecessors
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.columns import Channel
from artibot_sim.experiment.measured import TORQUE_DEVIATION, TORQUE_OF_CURRENT
from artibot_sim.experiment.smoothing import fresh
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.validation import fitted_starts
from artibot_sim.model import Robot
from artibot_sim.model.simulate.window_inputs import SamplingPlan, kind_of

Array = NDArray[np.float64]

SCALE = "effects.torque_scale.scale"
"""The parameter that a fit of torques from currents leaves open."""
SCALE_PRIOR = Prior(1.0, 0.3)

_WINDOW = 2.0
"""s of the windows in which torques are simulated."""
_GRID = 0.02
"""s between two looks at a simulated torque."""
_LEAD = 0.3
"""s at a window's beginning in which its start is forgotten."""
_DELAYS = np.arange(-0.2, 0.61, 0.05)
"""s by which currents may be late."""
_FOR_A_SECOND = 0.05
"""Share that a delay of a second explains at least: slow drives do not tell."""
_SHARE = 0.25
"""Share of how currents vary that torques explain at least, or currents say nothing of them."""
_EACH = 0.1
"""Share of how the current of one motor varies that its torque explains at least."""
_FEWEST = 60
"""Samples without which nothing is said."""
_TURNING = 0.2
"""Of the largest speed: a motor that turns slower takes no power that tells its torque, and counts as standing."""
_TUNING = 1.345
"""Huber's: residuals over their scale from which they count by their size alone."""
_ROUNDS = 6
"""Of weights anew."""
_DRAWS, _BLOCK = 200, 12.0
"""Of the bootstrap, from blocks of so many s."""


@dataclass(frozen=True)
class Reading:
    """What a current may follow.

    Attributes
    ----------
    words : str
    unit : str
        Of its constant.
    of : callable
        From torque (N m) and speed (rad/s) of a motor to what the current is proportional to.
    """

    words: str
    unit: str
    of: Callable[[Array, Array], Array]


READINGS: Mapping[str, Reading] = {
    "signed": Reading("the motors' torques", "A/(N·m)", lambda torque, speed: torque),
    "unsigned": Reading("the motors' torques without their sign", "A/(N·m)", lambda torque, speed: np.abs(torque)),
    "supply": Reading(
        "the motors' power, as what drives take from a battery", "A/W", lambda torque, speed: torque * speed
    ),
}


@dataclass(frozen=True)
class CurrentSensor:
    """How recorded currents follow torques.

    Attributes
    ----------
    reading : str
        One of READINGS.
    constant : float
        A/(N m) of the motors' own torque, or A/W.
    ci95 : (float, float)
        Of the constant, for the soil that explains the path.
    offsets : mapping of str to float
        Motor → A that it says without any torque.
    late : float
        s by which currents are stamped later than rotations.
    share : float
        Of how currents vary that this explains, by Huber's loss.
    scatter : float
        Standard deviation of what it does not explain while wheels turn, A.
    """

    reading: str
    constant: float
    ci95: tuple[float, float]
    offsets: Mapping[str, float]
    late: float
    share: float
    scatter: float

    def __str__(self) -> str:
        one = READINGS[self.reading]
        low, high = self.ci95
        offsets = " and ".join(f"{value:.2g}" for value in self.offsets.values())
        volt = f", a supply of {1.0 / self.constant:.3g} V" if self.reading == "supply" else ""
        return (
            f"currents follow {one.words}: {self.constant:.3g} {one.unit} ({low:.3g}–{high:.3g}){volt}, beside "
            f"{offsets} A; this explains {100 * self.share:.0f} % of how they vary, and they count as torques of a "
            "scale that is fitted"
        )


class Currents(NamedTuple):
    """What was measured: times (n,), s, and currents of all motors (n, motors), A."""

    t: Array
    current: Array


class _Line(NamedTuple):
    """A fit of currents.

    Attributes
    ----------
    constant, scatter : float
    offsets : array, shape (motors,)
    share : array, shape (motors + 1,)
        Of the loss about the median that it takes away while wheels turn: of each motor, and of all.
    """

    constant: float
    scatter: float
    offsets: Array
    share: Array


@dataclass(frozen=True)
class Simulated:
    """Torques (n, motors) and speeds of a recording's motors at increasing times (n,), s; where windows were."""

    t: Array
    torque: Array
    speed: Array

    def at(self, t: Array) -> tuple[Array, Array]:
        """Torque and speed (m, motors) at times (m,); NaN where nothing was simulated."""
        near = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        inside = (t >= self.t[near - 1]) & (t <= self.t[near]) & (self.t[near] - self.t[near - 1] < 2.0 * _GRID)
        found = []
        for table in (self.torque, self.speed):
            value = np.column_stack([np.interp(t, self.t, column) for column in table.T])
            found.append(np.where(inside[:, None], value, np.nan))
        return found[0], found[1]


def with_torques(
    recordings: Sequence[Experiment], others: Sequence[Experiment], paths: Sequence[Robot], workers: int | None
) -> tuple[list[Experiment], list[Experiment], str]:
    """Recordings whose currents stand as torques, where no torques were recorded.

    Parameters
    ----------
    recordings : sequence of Experiment
        Those that constants are found from, with currents in some of them.
    others : sequence of Experiment
    paths : sequence of Robot
        On soils that explain where it went; the one counts whose torques are followed best.
    workers : int or None

    Returns
    -------
    recordings, others : list of Experiment
        As given where currents follow no torque.
    said : str
        What the currents are.
    """
    pairs = [(one, current) for one in recordings if (current := currents_of(one, paths[0])) is not None]
    topic, found = pairs[0][0].channels["motor_currents"].topic, list[tuple[CurrentSensor, Robot]]()
    for robot in paths:
        sensor = current_sensor([(current, simulated(one, robot, workers)) for one, current in pairs], robot)
        if sensor is not None:
            found.append((sensor, robot))
    if not found:
        said = f"{topic}: currents follow neither torque nor power of the motors; they are left out"
        return list(recordings), list(others), said
    best, path = max(found, key=lambda one: one[0].share)

    def converted(one: Experiment) -> Experiment:
        current = currents_of(one, path)
        return one if current is None else _converted(one, current, simulated(one, path, workers), best, path)

    return [converted(one) for one in recordings], [converted(one) for one in others], f"{topic}: {best}"


def counts_currents(experiment: Experiment) -> bool:
    """Whether a recording's currents stand as torques."""
    channel = experiment.channels.get("motor_currents")
    return channel is not None and any(name.endswith(f".{TORQUE_OF_CURRENT}") for name in channel.columns)


def driven(robot: Robot) -> list[str]:
    """Motors whose torques can be measured, those of the front module first."""
    pairs = [pair for channel in ("torque_front", "torque_back") for pair in motor_pairs(robot, channel)]
    return [motor for pair in pairs for motor in pair]


def currents_of(experiment: Experiment, robot: Robot) -> Currents | None:
    """Currents as they change; None without them, or where torques were recorded."""
    channel, torques = experiment.channels.get("motor_currents"), experiment.channels.get("motor_torques")
    motors = driven(robot)
    if channel is None or (torques is not None and any(f"{motor}.effort" in torques for motor in motors)):
        return None
    names = [motor if f"{motor}.effort" in channel else motor.rpartition("_")[2] for motor in motors]
    if len(set(names)) < len(names) or not all(f"{name}.effort" in channel for name in names):
        return None
    values = np.column_stack([channel[f"{name}.effort"] for name in names])
    kept = np.isfinite(values).all(axis=1)
    t, values = channel.t[kept], values[kept]
    new = fresh(values)
    return Currents(t[new], values[new]) if new.sum() >= _FEWEST else None


def simulated(experiment: Experiment, robot: Robot, workers: int | None) -> Simulated:
    """Torques and speeds that the model has where a recording's windows are."""
    problem = problem_of([experiment], parameter_set(robot), _WINDOW, workers)
    point, motors = fitted_starts(problem, 1), driven(robot)
    begins = [_LEAD if before is not None else 0.0 for before in predecessors(problem.windows)]
    times = [np.arange(begin, duration, _GRID) for begin, duration in zip(begins, problem.durations, strict=True)]
    torque = []
    for motor in motors:
        kind = kind_of(f"torque_{motor}")
        plans = [SamplingPlan(t, np.full(len(t), kind)) for t in times]
        torque.append(np.concatenate(problem.sampled(point.coordinates, point.starts, plans)))
    at, speed = [], []
    for t, window in zip(times, problem.windows, strict=True):
        inputs = problem.stretches[window.stretch].inputs
        at.append(window.t + t)
        columns = inputs.velocity.T[: len(motors)]
        speed.append(np.column_stack([np.interp(window.t + t, inputs.t, column) for column in columns]))
    t, order = np.unique(np.concatenate(at), return_index=True)
    return Simulated(t, np.column_stack(torque)[order], np.vstack(speed)[order])


def current_sensor(seen: Sequence[tuple[Currents, Simulated]], robot: Robot) -> CurrentSensor | None:
    """What recorded currents follow; None where neither torque nor power explains them.

    Parameters
    ----------
    seen : sequence of (Currents, Simulated)
        Of each recording what was measured, and what the model says of its motors.
    robot : Robot
    """
    tried = [
        (_fitted(rows, reading), name, rows, late)
        for late in _DELAYS.tolist()
        for rows in [_together(seen, late)]
        if rows.turns.sum() >= _FEWEST
        for name, reading in READINGS.items()
    ]
    usable = [one for one in tried if one[0].share.min() > _EACH and (one[0].constant > 0.0 or one[1] == "signed")]
    if not usable:
        return None
    best, name, rows, late = max(usable, key=lambda one: one[0].share[-1] - _FOR_A_SECOND * abs(one[3]))
    rng, members = np.random.default_rng(0), [np.flatnonzero(rows.block == one) for one in np.unique(rows.block)]
    draws = [np.concatenate([members[i] for i in rng.integers(0, len(members), len(members))]) for _ in range(_DRAWS)]
    constants = [_fitted(rows.some(draw), READINGS[name]).constant for draw in draws]
    low, high = np.quantile(constants, (0.025, 0.975)).tolist()
    if best.share[-1] < _SHARE or low <= 0.0 <= high:
        return None
    offsets = dict(zip(driven(robot), best.offsets.tolist(), strict=True))
    return CurrentSensor(name, best.constant, (low, high), offsets, late, float(best.share[-1]), best.scatter)


class _Rows(NamedTuple):
    """Instants (n,) of all recordings at which currents were measured and torques simulated.

    Attributes
    ----------
    torque, speed, current : array, shape (n, motors)
    turns : array of bool, shape (n,)
        Whether some motor does: what stands tells the offset alone.
    block : array, shape (n,)
        Number of the seconds that are drawn together.
    """

    torque: Array
    speed: Array
    current: Array
    turns: NDArray[np.bool_]
    block: Array

    def some(self, rows: NDArray[np.int64]) -> _Rows:
        """These rows alone."""
        torque, speed, current, turns, block = self
        return _Rows(torque[rows], speed[rows], current[rows], turns[rows], block[rows])


def _together(seen: Sequence[tuple[Currents, Simulated]], late: float) -> _Rows:
    parts = []
    for number, (measured, simulated) in enumerate(seen):
        torque, speed = simulated.at(measured.t - late)
        turns = np.asarray(_turns(speed).any(axis=1))
        known = np.flatnonzero(np.isfinite(torque).all(axis=1))
        block = 1e6 * number + np.floor(measured.t / _BLOCK)
        parts.append(_Rows(torque, speed, measured.current, turns, block).some(known))
    return _Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _turns(speed: Array) -> NDArray[np.bool_]:
    """Which motors turn when, shape as `speed` (n, motors); those of unknown speeds do not."""
    known = np.abs(speed[np.isfinite(speed)])
    least = _TURNING * float(np.quantile(known, 0.95)) if len(known) else np.inf
    return np.asarray(np.abs(speed) > least)


def _fitted(rows: _Rows, reading: Reading) -> _Line:
    """A constant of all motors and an offset of each, by Huber's loss."""
    x, current = reading.of(rows.torque, rows.speed), rows.current
    weight, constant, offsets = np.ones_like(x), 0.0, np.zeros(x.shape[1])
    for _ in range(_ROUNDS):
        middle, usual = (np.average(v, axis=0, weights=weight) for v in (x, current))
        away = x - middle
        constant = float((weight * away * (current - usual)).sum() / max((weight * away**2).sum(), 1e-12))
        offsets = usual - constant * middle
        rest = np.abs(current - constant * x - offsets)
        scale = 1.4826 * max(float(np.median(rest[rows.turns])), 1e-9)
        weight = np.minimum(1.0, _TUNING * scale / np.maximum(rest, 1e-12))
    spread = np.abs(current - np.median(current[rows.turns], axis=0))[rows.turns]
    unit = np.maximum(1.4826 * np.median(spread, axis=0), 1e-9)  # one for all readings and delays
    left, was = (_loss(part / unit).sum(axis=0) for part in (rest[rows.turns], spread))
    return _Line(
        constant, scale, offsets, 1.0 - np.append(left, left.sum()) / np.maximum(np.append(was, was.sum()), 1e-12)
    )


def _loss(size: Array) -> Array:
    """Huber's, of sizes that are not negative."""
    return np.where(size < _TUNING, 0.5 * size**2, _TUNING * (size - 0.5 * _TUNING))


def _converted(
    experiment: Experiment, measured: Currents, model: Simulated, sensor: CurrentSensor, robot: Robot
) -> Experiment:
    """A recording whose channel of currents has torques beside them, stamped as rotations are."""
    t, values = measured.t - sensor.late, measured.current
    torque, speed = model.at(t)
    offsets = np.array([sensor.offsets[motor] for motor in driven(robot)])
    own = (values - offsets) / sensor.constant
    if sensor.reading == "unsigned":  # the model says which way they pull
        own *= np.sign(torque)
    elif sensor.reading == "supply":
        turns = _turns(speed)
        own = np.where(turns, own / np.where(turns, speed, 1.0), np.nan)
    raw = experiment.channels["motor_currents"]
    ns = experiment.start_ns + np.round(1e9 * t).astype(np.int64)
    ns, order = np.unique(ns, return_index=True)
    sd = sensor.scatter / abs(sensor.constant)
    if sensor.reading == "supply":
        sd /= float(np.nanmedian(np.abs(speed[turns])))
    columns = {}
    for k, motor in enumerate(driven(robot)):
        columns[f"{motor}.{TORQUE_OF_CURRENT}"] = own[order, k]
        columns[f"{motor}.{TORQUE_DEVIATION}"] = np.full(len(order), sd)
    units = dict.fromkeys(columns, "N·m")
    channel = Channel(raw.topic, ns, (ns - experiment.start_ns) / 1e9, ns, columns, units)
    return replace(experiment, channels={**experiment.channels, "motor_currents": channel})
