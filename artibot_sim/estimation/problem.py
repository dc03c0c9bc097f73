"""Windows predicted by the model: residuals, and how they change with parameters and starts."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import InitVar, dataclass, field, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation import kernels
from artibot_sim.estimation.kernels import Parts, WindowSamples
from artibot_sim.estimation.measurements import Stretch
from artibot_sim.estimation.parallel import threads
from artibot_sim.estimation.parameters import ParameterSet
from artibot_sim.estimation.windows import (
    CHANNEL_NAMES,
    Past,
    Window,
    arms_of,
    bent_bristles,
    for_starts,
    lagging_forces,
    past_of,
    postures,
    predecessors,
    states,
    wound_wheels,
)
from artibot_sim.model import Robot
from artibot_sim.model.effects import has_memory, stiction, tyre_relaxation, wheel_windup
from artibot_sim.model.simulate.sensors import measured_starts, sensor_errors, true_starts
from artibot_sim.model.simulate.window_inputs import Items, MotorTable, SamplingPlan, kind_of
from artibot_sim.model.simulate.windows import WindowBatch, window_step

# ----------------------------------------------------------------------
# How residuals of windows change with parameters and starts.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

_SHARE = 0.99
"""Share of the sensitivities of a channel that set the limit for all of them."""


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the residuals of all windows.

    Attributes
    ----------
    parameters : array, shape (p, n)
        By the coordinates of the parameters, for all samples.
    starts : array, shape (8 or 6, n)
        By the start of the window that a sample is of.
    """

    parameters: Array
    starts: Array


def clip(of: WindowSamples, table: Array) -> None:
    """Limit sensitivities (c, n) in place, channel by channel, to three times what 99 of 100 have.

    A finite difference across a switch of eq. 16 is as large as its step is small; a thousandth of all rows would
    hold most of the information, and none of it is true.
    """
    largest = np.full((len(CHANNEL_NAMES), len(table)), np.inf)
    for c, rows in enumerate(of.some()):
        if len(rows):
            largest[c] = 3.0 * _high(np.abs(table[:, rows]))
    kernels.limit(of, table, largest)


def moved_along(of: WindowSamples, table: Array, starts: Array, moves: Array) -> None:
    """Sensitivities (p, n), taken with starts that moved along by `moves` (p, windows, 8 or 6), as if these had stayed.

    `starts` (8 or 6, n) are the sensitivities to them, limited already: so a step that takes the starts along cancels
    them exactly. Differences with starts that stay would be limited themselves where a start's forces die away.
    """
    for row, move in zip(table, moves, strict=True):
        if move.any():
            row -= np.einsum("nk,kn->n", of.of_window(move), starts)


def _high(values: Array) -> Array:
    """What _SHARE of each row (c, n) is below, (c,)."""
    place = _SHARE * (values.shape[1] - 1)
    low = int(place)
    high = min(low + 1, values.shape[1] - 1)
    values.partition((low, high), axis=1)
    return np.asarray(values[:, low] + (place - low) * (values[:, high] - values[:, low]), float)


def rigid(of: WindowSamples, predicted: Array, starts: Array) -> Array:
    """How samples (n,) move with x, y and yaw of their windows' starts (windows, 8 or 6), shape (3, n).

    As on ground that is the same everywhere and in all directions, where only positions and headings notice.
    """
    found, at = np.zeros((3, len(predicted))), of.of_window(starts[:, :2])
    found[0, of.x], found[1, of.y], found[2, of.yaw] = 1.0, 1.0, 1.0
    found[2, of.x] = at[of.y, 1] - predicted[of.y]
    found[2, of.y] = predicted[of.x] - at[of.x, 0]
    found /= of.sigma
    return np.nan_to_num(found, copy=False)


# ----------------------------------------------------------------------
# Windows predicted by the model: residuals, and how they change with parameters and starts.
# ----------------------------------------------------------------------


Indices = NDArray[np.int64]


_START_STEP = np.array([1e-3, 1e-3, 1e-3, 3e-3, 3e-3, 3e-3, 1e-3, 3e-3])


def start_steps(size: int) -> Array:
    """Steps of the differences that give gradients by a window's start of `size` numbers."""
    return for_starts(_START_STEP, size)


_HALVINGS = 3
"""How often a step is halved for the stiffest of some soils; on stiffer ones than that wheels hardly slip."""
_RIGID = 3
"""The first starts, x, y and yaw, move a window's prediction as a whole."""
_LOST = 50.0
"""Residual, in units of noise, of a sample that the simulation never reached."""
_CALM = 10.0
"""Residual, in units of noise, from which a sample pulls a whole window by its size no longer."""


def longest_step(parameters: ParameterSet, tables: Sequence[MotorTable]) -> float:
    """The longest step (s) that the robot allows, and so it does with each effect that is fitted at its plain size.

    Coulomb friction in the joint of a light rover is a stiff damper about standstill; with a step that is too long the
    joint chatters, and the friction found is less than there is. Effects with which no step is short enough are left
    out: these are stops, at which a rover is seldom.
    """
    steps, none = [window_step(parameters.robot, tables)], np.zeros(len(parameters))
    for extension, place in zip(parameters.extensions, parameters.places, strict=True):
        if extension.one_sided and not (extension.search.logarithmic or extension.search.reference):
            plain = none.copy()
            plain[place] = 1.0
            with suppress(ArtibotError):
                steps.append(window_step(parameters.robot_at(plain), tables))
    return min(steps)


class Draw(IntEnum):
    """What random numbers are drawn for."""

    FIRST_GUESSES = 0
    STARTS = 2
    BOOTSTRAP = 3
    ENCODER_NOISE = 4


@dataclass
class Problem:
    """Some windows and the parameters that are to explain them.

    Attributes
    ----------
    parameters : ParameterSet
    stretches : sequence of Stretch
    windows : sequence of Window
    workers : int, optional
        Threads; as many as cores by default.
    kappa : sequence of float or None
        Front shares of the stretches, where motors are under torque.
    dt : float, optional
        Integration step, s; the longest that the robot allows by default.
    seed : int
        Of every random draw that a fit of these windows makes.
    known : WindowBatch, optional
        Of the same parameters and stretches, with other windows: what it knows of motors is not worked out again.
    """

    parameters: ParameterSet
    stretches: Sequence[Stretch]
    windows: Sequence[Window]
    workers: int | None = None
    kappa: Sequence[float | None] = ()
    dt: float | None = None
    seed: int = 0
    known: InitVar[WindowBatch | None] = None
    _batch: WindowBatch = field(init=False, repr=False)
    _before: list[int | None] = field(init=False, repr=False)

    def __post_init__(self, known: WindowBatch | None) -> None:
        batch = known or self._any_batch()
        plans = [window.plan for window in self.windows]
        self._before = predecessors(self.windows)
        after = {before: i for i, before in enumerate(self._before) if before is not None}
        ends = []
        for i, w in enumerate(self.windows):
            knots = self.windows[after[i]].first - w.first if i in after else w.knots
            ends.append(_state_at(self.parameters.robot, knots * batch.tables[w.stretch].dt))
        self._batch = batch.with_plans(plans + ends)

    def _any_batch(self) -> WindowBatch:
        """A batch of these stretches that is asked for nothing yet."""
        kappa = self.kappa or [None] * len(self.stretches)
        tables = [stretch.table(share) for stretch, share in zip(self.stretches, kappa, strict=True)]
        dt = self.dt or longest_step(self.parameters, tables)
        return WindowBatch(tables, (), dt, self.workers, self.parameters.robot)

    def __len__(self) -> int:
        return len(self.windows)

    def generator(self, purpose: Draw, number: int = 0) -> np.random.Generator:
        """A stream of random numbers of its own for each purpose, and each time that it is served.

        Fits that run side by side share no state, so the number of workers does not matter; and competing models are
        given the same draws, so that none is better by the luck of its own.
        """
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(purpose, number)))

    def part(self, rows: Sequence[int]) -> Problem:
        """This problem with some of its windows only."""
        return replace(self, windows=[self.windows[i] for i in rows], known=self._batch)

    def with_parameters(self, parameters: ParameterSet) -> Problem:
        """This problem for other parameters: its windows stay, and its integration step unless effects need another."""
        if self.dt is None and longest_step(parameters, self._batch.tables) != self._batch.dt:
            return replace(self, parameters=parameters)
        new = copy.copy(self)  # what was worked out of the windows stays
        new.parameters = parameters
        return new

    def widening(self, window: Window) -> dict[str, float]:
        """By channel of a window, by how much its noise is taken to be more than its sensor's own."""
        ratio = window.sigma / window.sensor
        return {CHANNEL_NAMES[c]: float(ratio[window.channel == c][0]) for c in np.unique(window.channel)}

    def rescaled(self, levels: Array) -> Problem:
        """This problem with the noise of each channel multiplied by `levels` (channels,)."""
        windows = [replace(w, sigma=w.sigma * levels[w.channel]) for w in self.windows]
        return replace(self, windows=windows, known=self._batch)

    @property
    def size(self) -> int:
        """How many numbers describe a start."""
        return len(self.windows[0].start.mean)

    @cached_property
    def durations(self) -> Array:
        """How long the windows are, shape (windows,), s."""
        return np.array([window.knots * self.stretches[window.stretch].inputs.dt for window in self.windows])

    @cached_property
    def recordings(self) -> tuple[tuple[str, ...], Indices]:
        """Names of the recordings, in the order of their paths, and which one each window is of, shape (windows,)."""
        names = {str(stretch.experiment.path): stretch.experiment.name for stretch in self.stretches}
        paths = [str(self.stretches[window.stretch].experiment.path) for window in self.windows]
        every = sorted(set(paths))
        return tuple(names[path] for path in every), np.array([every.index(path) for path in paths], np.int64)

    @cached_property
    def starts(self) -> Array:
        """Measured starts, shape (windows, 8 or 6)."""
        return np.array([window.start.mean for window in self.windows])

    @cached_property
    def start_sd(self) -> Array:
        """Their standard deviations, same shape."""
        return np.array([window.start.sd for window in self.windows])

    @cached_property
    def start_weight(self) -> Array:
        """Square roots of their information, shape (windows, 8, 8) or (windows, 6, 6)."""
        return np.array([window.start.weight for window in self.windows])

    @cached_property
    def start_information(self) -> Array:
        """Their information, same shape."""
        return np.asarray(self.start_weight.transpose(0, 2, 1) @ self.start_weight, float)

    @cached_property
    def samples(self) -> WindowSamples:
        """What was measured in all windows."""
        return WindowSamples.of(self.windows)

    @cached_property
    def _late(self) -> NDArray[np.bool_]:
        return np.array([window.start.late for window in self.windows])

    @cached_property
    def _motors(self) -> tuple[Array, Array]:
        return np.array([w.start.q for w in self.windows]), np.array([w.start.v for w in self.windows])

    def simulate(
        self, robots: Sequence[Robot], robot: Indices, window: Indices, guesses: Array, ends: bool = False
    ) -> list[Array]:
        """Predictions of windows, (n,) each, for rows of (which robot, window, start); or the states at their ends."""
        plan = window + len(self.windows) if ends else window
        return self._batch_for(robots).run(robots, self._items(robots, robot, window, guesses, plan))

    def predictions(self, robots: Sequence[Robot], robot: Indices, starts: Array) -> Array:
        """Predictions of all samples, shape (sets, n), for sets of which `robot` (sets, windows) and starts."""
        count = len(self.windows)
        window, guesses = np.tile(np.arange(count), len(robot)), starts.reshape(-1, self.size)
        items = self._items(robots, np.ascontiguousarray(robot).ravel(), window, guesses, window)
        return self._batch_for(robots).run_flat(robots, items).reshape(len(robot), -1)

    def _batch_for(self, robots: Sequence[Robot]) -> WindowBatch:
        """The batch in steps that all `robots` take, in as many threads as are free here.

        A search tries soils that are stiffer than the robot's own. What is compared at once has one step:
        sensitivities are differences, and steps of another length would show in them.
        """
        batch, count = self._batch, threads(self.workers)
        for _ in range(_HALVINGS):
            if batch.suits(robots):
                break
            batch = batch.halved
        if count == batch.workers:
            return batch
        batch = copy.copy(batch)
        batch.workers = count
        return batch

    def _items(self, robots: Sequence[Robot], robot: Indices, window: Indices, guesses: Array, plan: Indices) -> Items:
        q, v = self._motors
        q, v = states(postures(robots), robot, q[window], v[window], guesses, self._late[window])
        stretch, first, knots = (column[window] for column in self._places)
        memory = self._remembered(robots, robot, window, q, v)
        return Items(robot, stretch, plan, first, knots, q, v, self._times[window], memory)

    def _remembered(self, robots: Sequence[Robot], robot: Indices, window: Indices, q: Array, v: Array) -> Array | None:
        """What wheels remember at starts q and v, see `Items.memory`; None where none of the robots' does."""
        if not any(has_memory(one.effects) for one in robots):
            return None
        wheels = q.shape[1] // 2
        found = np.zeros((len(q), 4 * wheels))
        if any(tyre_relaxation.EFFECT.id in one.effects for one in robots):
            found[:, :wheels] = lagging_forces(robots, robot, window, q, v, self._past)
        if any(stiction.EFFECT.id in one.effects for one in robots):
            found[:, 2 * wheels :] = bent_bristles(robots, robot, q, v)
        if any(wheel_windup.EFFECT.id in one.effects for one in robots):
            found[:, wheels : 2 * wheels] = wound_wheels(robots, robot, q, v)
        return found

    @cached_property
    def _past(self) -> Past:
        robot = self.parameters.robot
        return past_of(self.stretches, self.windows, arms_of(robot))

    @cached_property
    def _places(self) -> Indices:
        """Of each window stretch, first knot and intervals, shape (3, windows)."""
        return np.array([(w.stretch, w.first, w.knots) for w in self.windows], np.int64).reshape(-1, 3).T

    @cached_property
    def _times(self) -> Array:
        return np.array([w.t for w in self.windows])

    def items_from(self, robot: Robot, starts: Array) -> Items:
        """All windows as a robot of this kind begins them, one row each, from starts (windows, 8 or 6)."""
        count = np.arange(len(self.windows))
        return self._items([robot], np.zeros_like(count), count, starts, count)

    def sampled(self, coordinates: Array, starts: Array, plans: Sequence[SamplingPlan]) -> list[Array]:
        """Whatever `plans` (one a window) ask for, (m,) each."""
        robots, count = [self.parameters.robot_at(coordinates)], np.arange(len(self.windows))
        usual = self._batch_for(robots)
        return usual.with_plans(plans).run(robots, self._items(robots, np.zeros_like(count), count, starts, count))

    def carried(self, coordinates: Array, starts: Array) -> Array:
        """Starts as the windows before predict them, where there is one; `starts` elsewhere."""
        count = len(self.windows)
        robots = [self.parameters.robot_at(coordinates)]
        ends = self.simulate(robots, np.zeros(count, np.int64), np.arange(count), starts, ends=True)
        own = np.array([starts[i] if b is None else ends[b][: self.size] for i, b in enumerate(self._before)])
        seen = measured_starts(np.array([sensor_errors(robots[0])]), own, self._late)
        followed = [b is not None and bool(np.isfinite(ends[b]).all()) for b in self._before]
        return np.where(np.array(followed)[:, None], seen, starts)

    def held(self, before: Robot, after: Robot, starts: Array) -> Array:
        """Starts as the sensors of `after` see the rover move as `starts` did to those of `before`, places as they are.

        A tracked point that is taken to be elsewhere would otherwise change the rover's motion, and all its forces.
        """
        old, new = sensor_errors(before), sensor_errors(after)
        if old == new:
            return starts
        seen = measured_starts(np.array([new]), true_starts(np.array([old]), starts, self._late), self._late)
        seen[:, :2] = starts[:, :2]
        return seen

    def residuals(self, coordinates: Sequence[Array], starts: Array) -> list[Parts]:
        """Residuals in units of noise for several sets of coordinates (p,), window by window.

        Parameters
        ----------
        starts : array, shape (windows, 8 or 6) or (sets, windows, 8 or 6)
        """
        return [self.parts(row) for row in self.flat_residuals(coordinates, starts)]

    def flat_residuals(self, coordinates: Sequence[Array], starts: Array) -> Array:
        """Residuals of all windows one after the other, shape (sets, n), for sets of coordinates and starts."""
        places: dict[bytes, int] = {}
        which = [places.setdefault(c.tobytes(), len(places)) for c in coordinates]
        robots = [self.parameters.candidate(np.frombuffer(c)) for c in places]
        count = len(self.windows)
        guesses = np.broadcast_to(starts, (len(which), count, self.size))
        return self.compare(self.predictions(robots, np.repeat(which, count).reshape(-1, count), guesses))

    def parts(self, flat: Array) -> Parts:
        """Values of all samples, (n,), window by window."""
        return Parts(flat, self.samples.begin)

    def compare(self, predicted: Array) -> Array:
        """Predictions (sets, n) made residuals in units of noise; yaw by its shortest way, what diverged very wrong."""
        kernels.compare(self.samples, predicted, _LOST)
        return predicted

    def aligned(self, residuals: Array, starts: Array) -> tuple[Array, Array]:
        """Starts moved and turned as a whole so that their paths fit best, and the residuals then: no simulation.

        Where the ground is uniform only positions and headings notice; elsewhere the residuals are a guess.

        Parameters
        ----------
        residuals : array, shape (sets, n)
        starts : array, shape (sets, windows, 8 or 6)
        """
        starts, residuals = np.array(starts), np.array(residuals)
        scratch = np.zeros((3, 3)), np.zeros(3)
        kernels.align(self.samples, residuals, starts, self.starts, self.start_information, _CALM, *scratch)
        return starts, residuals

    def linearised(self, coordinates: Array, starts: Array, free: Sequence[int]) -> tuple[Parts, Sensitivity]:
        """Residuals and their sensitivities to the parameters numbered `free` and to the starts."""
        robots, differences = [self.parameters.candidate(coordinates)], self.parameters.steps(coordinates)
        for i in free:
            moved = coordinates.copy()
            moved[i] += differences[i]
            robots.append(self.parameters.candidate(moved))
        count, p, moves = len(self.windows), len(free), start_steps(self.size)
        whole = range(_RIGID, self.size) if self.parameters.uniform else range(self.size)
        robot = np.repeat([*range(1 + p), *(0 for _ in whole)], count).reshape(-1, count)
        guesses = np.tile(starts, (len(robot), 1, 1))
        for k in range(1, 1 + p):
            guesses[k] = self.held(robots[0], robots[k], starts)
        for k, column in enumerate(whole):
            guesses[1 + p + k, :, column] += moves[column]
        flat = self.predictions(robots, robot, guesses)
        table = np.zeros((p + self.size, flat.shape[1]))
        if self.parameters.uniform:
            table[p : p + _RIGID] = rigid(self.samples, flat[0], starts)
        self.compare(flat)
        steps = np.concatenate([differences[list(free)], moves[list(whole)]])
        rows = [*range(p), *(p + column for column in whole)]
        table[rows] = (flat[1:] - flat[0]) / steps[:, None]
        clip(self.samples, table)
        moved_along(self.samples, table[:p], table[p:], (guesses[1 : 1 + p] - starts) / steps[:p, None, None])
        return self.parts(flat[0].copy()), Sensitivity(table[:p], table[p:])


def _state_at(robot: Robot, t: float) -> SamplingPlan:
    """The whole state `t` s after a window's start, as `windows.start_names` has it."""
    first = ("origin_x", "origin_y", "heading", "v_x", "v_y", "turn_rate", "articulation_yaw", "articulation_rate")
    kinds = [kind_of(name) for name in first]
    kinds += [kind_of(f"articulation_{what}_{j + 2}") for j in range(len(robot.trailing)) for what in ("yaw", "rate")]
    return SamplingPlan(np.full(len(kinds), t), np.array(kinds))
