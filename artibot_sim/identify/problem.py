"""Windows predicted by the model: residuals, and how they change with parameters and starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.identify.parameters import ParameterSet
from artibot_sim.identify.sensing import Stretch
from artibot_sim.identify.sensitivity import Sensitivity, clip, rigid
from artibot_sim.identify.starts import postures, states
from artibot_sim.identify.windows import Window
from artibot_sim.model import Robot
from artibot_sim.model.sensors import measured_starts, sensor_errors
from artibot_sim.model.windows import KINDS, Items, Plan, WindowBatch, window_step

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_START_STEP = np.array([1e-3, 1e-3, 1e-3, 3e-3, 3e-3, 3e-3, 1e-3, 3e-3])
"""The same for starts, in the order of START."""
_RIGID = 3
"""The first starts, x, y and yaw, move a window's prediction as a whole."""
_LOST = 50.0
"""Residual, in units of noise, of a sample that the simulation never reached."""


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
    """

    parameters: ParameterSet
    stretches: Sequence[Stretch]
    windows: Sequence[Window]
    workers: int | None = None
    kappa: Sequence[float | None] = ()
    dt: float | None = None
    _batch: WindowBatch = field(init=False, repr=False)
    _before: list[int | None] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        kappa = self.kappa or [None] * len(self.stretches)
        tables = [stretch.table(share) for stretch, share in zip(self.stretches, kappa, strict=True)]
        dt = self.dt or window_step(self.parameters.robot, tables)
        plans = [window.plan for window in self.windows]
        self._before = predecessors(self.windows)
        after = {before: i for i, before in enumerate(self._before) if before is not None}
        ends = [
            _state_at((self.windows[after[i]].first - w.first if i in after else w.knots) * tables[w.stretch].dt)
            for i, w in enumerate(self.windows)
        ]
        self._batch = WindowBatch(tables, plans + ends, dt, self.workers)

    def __len__(self) -> int:
        return len(self.windows)

    def part(self, rows: Sequence[int]) -> Problem:
        """The same with some of the windows."""
        return replace(self, windows=[self.windows[i] for i in rows])

    def with_parameters(self, parameters: ParameterSet) -> Problem:
        """The same windows, in the same integration steps, for other parameters to explain."""
        return replace(self, parameters=parameters, dt=self._batch.dt)

    def rescaled(self, levels: Array) -> Problem:
        """The same with the noise of each channel multiplied by `levels` (channels,)."""
        windows = [replace(w, sigma=w.sigma * levels[w.channel]) for w in self.windows]
        return replace(self, windows=windows)

    @property
    def size(self) -> int:
        """How many numbers describe a start."""
        return len(self.windows[0].start.mean)

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
        return self._batch.run(robots, self._items(robots, robot, window, guesses, plan))

    def _items(self, robots: Sequence[Robot], robot: Indices, window: Indices, guesses: Array, plan: Indices) -> Items:
        q, v = self._motors
        q, v = states(postures(robots), robot, q[window], v[window], guesses, self._late[window])
        stretch, first, knots = (
            np.array([getattr(w, name) for w in self.windows])[window] for name in ("stretch", "first", "knots")
        )
        t = np.array([w.t for w in self.windows])[window]
        return Items(robot, stretch, plan, first, knots, q, v, t)

    def look(self, coordinates: Array, starts: Array, plans: Sequence[Plan]) -> list[Array]:
        """Whatever `plans` (one a window) ask for, (m,) each."""
        batch = WindowBatch(self._batch.tables, list(plans), self._batch.dt, self.workers)
        return self._run(batch, [self.parameters.robot_at(coordinates)], starts)

    def _run(self, batch: WindowBatch, robots: Sequence[Robot], starts: Array) -> list[Array]:
        count = np.arange(len(self.windows))
        return batch.run(robots, self._items(robots, np.zeros_like(count), count, starts, count))

    def carried(self, coordinates: Array, starts: Array) -> Array:
        """Starts as the windows before predict them, where there is one; `starts` elsewhere."""
        count = len(self.windows)
        robots = [self.parameters.robot_at(coordinates)]
        ends = self.simulate(robots, np.zeros(count, np.int64), np.arange(count), starts, ends=True)
        own = np.array([starts[i] if b is None else ends[b][: self.size] for i, b in enumerate(self._before)])
        seen = measured_starts(np.array([sensor_errors(robots[0])]), own, self._late)
        followed = [b is not None and bool(np.isfinite(ends[b]).all()) for b in self._before]
        return np.where(np.array(followed)[:, None], seen, starts)

    def residuals(self, coordinates: Sequence[Array], starts: Array) -> list[list[Array]]:
        """Residuals in units of noise for several sets of coordinates (p,), window by window.

        Parameters
        ----------
        starts : array, shape (windows, 8 or 6) or (sets, windows, 8 or 6)
        """
        robots = [self.parameters.robot_at(c) for c in coordinates]
        count = len(self.windows)
        robot, window = np.repeat(np.arange(len(robots)), count), np.tile(np.arange(count), len(robots))
        guesses = np.broadcast_to(starts, (len(robots), count, self.size)).reshape(-1, self.size)
        flat = self.simulate(robots, robot, window, guesses)
        return [[self.compare(i, flat[k * count + i]) for i in range(count)] for k in range(len(robots))]

    def compare(self, number: int, predicted: Array) -> Array:
        """Residuals of a window in units of noise; yaw by its shortest way, what diverged as very wrong."""
        window = self.windows[number]
        difference = predicted - window.value
        turned = window.places[2]
        difference[turned] = np.arctan2(np.sin(difference[turned]), np.cos(difference[turned]))
        residual: Array = difference / window.sigma
        residual[~np.isfinite(residual)] = _LOST
        return residual

    def aligned(self, number: int, residual: Array, start: Array) -> tuple[Array, Array]:
        """A start moved and turned as a whole so that its path fits best, and the residuals then: no simulation.

        Where the ground is uniform only positions and headings notice; elsewhere the residuals are a guess.
        """
        window = self.windows[number]
        x, y, yaw = window.places
        if not len(x):
            return start, residual
        known = self.start_weight[number].T @ self.start_weight[number]
        rows = np.concatenate([x, y, yaw])
        sigma, value, now = window.sigma[rows], window.value[rows], residual[rows]
        predicted = now * sigma + value
        J = rigid(predicted, start, len(x), len(yaw)) / sigma[:, None]
        calm = 1.0 / np.maximum(1.0, np.abs(now) / 10.0)
        pull = (J.T * calm) @ now + (known @ (start - self.starts[number]))[:3]
        move = -np.linalg.solve((J.T * calm) @ J + known[:3, :3], pull)
        new, moved, count = start.copy(), residual.copy(), len(x)
        new[:3] += move
        c, s = np.cos(move[2]), np.sin(move[2])
        away_x, away_y = predicted[:count] - start[0], predicted[count : 2 * count] - start[1]
        there = np.concatenate(
            [new[0] + c * away_x - s * away_y, new[1] + s * away_x + c * away_y, predicted[2 * count :] + move[2]]
        )
        difference = there - value
        difference[2 * count :] = np.arctan2(np.sin(difference[2 * count :]), np.cos(difference[2 * count :]))
        moved[rows] = difference / sigma
        return new, moved

    def linearised(
        self, coordinates: Array, starts: Array, free: Sequence[int]
    ) -> tuple[list[Array], list[Sensitivity]]:
        """Residuals and their sensitivities to the parameters numbered `free` and to the starts."""
        steps = self.parameters.steps
        robots = [self.parameters.robot_at(coordinates)]
        for i in free:
            moved = coordinates.copy()
            moved[i] += steps[i]
            robots.append(self.parameters.robot_at(moved))
        count, p = len(self.windows), len(free)
        whole = range(_RIGID, self.size) if self._uniform else range(self.size)
        window = np.tile(np.arange(count), 1 + p + len(whole))
        robot = np.repeat([*range(1 + p), *(0 for _ in whole)], count)
        guesses = np.tile(starts, (1 + p + len(whole), 1))
        for k, column in enumerate(whole):
            guesses[(1 + p + k) * count : (2 + p + k) * count, column] += _START_STEP[column]
        flat = self.simulate(robots, robot, window, guesses)
        residuals, sensitivities = [], []
        for i in range(count):
            base = self.compare(i, flat[i].copy())
            columns = [(self.compare(i, flat[(1 + k) * count + i]) - base) / steps[free[k]] for k in range(p)]
            moved = {c: (self.compare(i, flat[(1 + p + k) * count + i]) - base) / _START_STEP[c]
                     for k, c in enumerate(whole)}  # fmt: skip
            if self._uniform:
                moved |= dict(enumerate(self._whole(i, flat[i], starts[i]).T))
            start = np.column_stack([moved[c] for c in range(self.size)])
            parameters = np.column_stack(columns) if columns else np.empty((len(base), 0))
            residuals.append(base)
            sensitivities.append(Sensitivity(parameters, start))
        clip(self.windows, [s.parameters for s in sensitivities])
        clip(self.windows, [s.start for s in sensitivities])
        return residuals, sensitivities

    @property
    def _uniform(self) -> bool:
        """Whether the ground is the same everywhere and in all directions."""
        return self.parameters.uniform

    def _whole(self, number: int, predicted: Array, start: Array) -> Array:
        """Sensitivities (n, 3) to x, y and yaw of the start, where the ground is uniform."""
        window = self.windows[number]
        x, y, yaw = window.places
        rows, columns = np.concatenate([x, y, yaw]), np.zeros((len(window), 3))
        columns[rows] = np.nan_to_num(rigid(predicted[rows], start, len(x), len(yaw)) / window.sigma[rows][:, None])
        return columns


_STATE = np.array([KINDS.index(k) for k in (
    "origin_x", "origin_y", "heading", "v_x", "v_y", "turn_rate", "articulation_yaw", "articulation_rate"
)])  # fmt: skip
"""What `starts.START` is called among KINDS."""


def _state_at(t: float) -> Plan:
    """A look at the whole state `t` s after a window's start."""
    return Plan(np.full(len(_STATE), t), _STATE)


def predecessors(windows: Sequence[Window]) -> list[int | None]:
    """For each window which one runs when it begins, None where none does."""
    found: list[int | None] = []
    for window in windows:
        running = [
            i for i, w in enumerate(windows)
            if w.stretch == window.stretch and w.first < window.first <= w.first + w.knots
        ]  # fmt: skip
        found.append(max(running, key=lambda i: windows[i].first) if running else None)
    return found
