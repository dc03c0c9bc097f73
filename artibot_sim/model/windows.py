"""Many short rollouts of one recording: windows × perturbed robots × perturbed starts, sampled where sensors were.

Fitting needs thousands of short simulations whose motors turn as they were measured, of which only what sensors saw
is wanted. `WindowBatch` runs them in threads (the compiled code holds no lock), each exactly as `rollout` would.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.batch import available_cores
from artibot_sim.model.effects import record
from artibot_sim.model.params import packed, params
from artibot_sim.model.robot import Robot
from artibot_sim.model.rollout import unlimited_beside_prescribed
from artibot_sim.model.sensors import sensor_errors
from artibot_sim.model.stability import largest_step
from artibot_sim.model.transmission import Mode, back_torque_factor

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KINDS = (
    "x", "y", "yaw", "articulation_yaw", "yaw_rate", "v_x", "v_y", "a_x", "a_y", "articulation_rate",
    "torque_front_right", "torque_front_left", "torque_back_right", "torque_back_left", "sliding", "grip",
    "origin_x", "origin_y", "heading", "turn_rate",
)  # fmt: skip
"""What can be sampled, by its name.

As sensors see it, their errors included (`sensors.SensorErrors`): position of the tracked point in `map` and the yaw
that comes with it, yaw rate, motor torques (N·m). Without such errors: articulation, and in the front module's frame
velocity and acceleration of its origin (m/s, m/s²); its origin, heading and turn rate; which wheels slide (bit i for
wheel i of WHEELS, as eq. 16 had it at the row before), and the largest share of its normal force that a wheel holds
without sliding."""

_STEPS = (5e-3, 2.5e-3, 2e-3, 1e-3, 5e-4)
_MARGIN = 0.8  # of the longest stable step: at the limit itself errors do not decay


@dataclass(frozen=True)
class MotorTable:
    """How the motors turned through one stretch of a recording: knots `dt` apart, cubic between them.

    Attributes
    ----------
    dt : float, s
    position, velocity : array, shape (n, 4)
        Motor-side as recorded, rad and rad/s; zeros for motors that do not exist. A robot whose encoders have a scale
        turned by as much less.
    torque : array, shape (n, 4)
        N m, for motors under torque, recorded likewise; NaN is eq. 30.
    modes : tuple of 4 Mode
    kappa : float or None
        Front share of eq. 29, where a motor is under eq. 30's torque; None is the robot's own.
    """

    dt: float
    position: Array
    velocity: Array
    torque: Array
    modes: tuple[Mode, ...]
    kappa: float | None = None


@dataclass(frozen=True)
class Plan:
    """Where a window is looked at.

    Attributes
    ----------
    t : array, shape (m,)
        s after the window's first knot, at most its length.
    kind : array, shape (m,)
        Which of KINDS.
    """

    t: Array
    kind: Indices


@dataclass(frozen=True)
class Items:
    """What to run, one row each: all arrays have the same length n.

    Attributes
    ----------
    robot, table, plan : array of int, shape (n,)
        Indices into what the batch was given.
    first, knots : array of int, shape (n,)
        First knot of the table, and how many intervals follow.
    q, v : array, shape (n, 16)
        Start states: the rover's own, motors included, not as its sensors show them.
    t : array, shape (n,)
        When they are, s since the recording's start: some effects change with time.
    """

    robot: Indices
    table: Indices
    plan: Indices
    first: Indices
    knots: Indices
    q: Array
    v: Array
    t: Array

    def __len__(self) -> int:
        return len(self.robot)


@dataclass
class WindowBatch:
    """Runs items; keeps the buffers between calls. Lagging tyre forces start from zero.

    Parameters
    ----------
    tables : sequence of MotorTable
    plans : sequence of Plan
    dt : float
        Integration step of RK4, s; it divides every table's `dt`.
    workers : int, optional
        Threads; as many as cores by default. Results do not depend on it.
    """

    tables: Sequence[MotorTable]
    plans: Sequence[Plan]
    dt: float
    workers: int | None = None
    _spare: list[_Buffers] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        for i, table in enumerate(self.tables):
            ratio = table.dt / self.dt
            if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
                raise ArtibotError(f"dt: {self.dt:g} s does not divide table {i}'s knot spacing of {table.dt:g} s")
        longest = max((len(table.position) for table in self.tables), default=1)
        self._rows = longest

    def run(self, robots: Sequence[Robot], items: Items) -> list[Array]:
        """What each item's plan asks for, (m,) each; NaN from where a rollout diverged."""
        shared = [_Shared(robot, self.tables) for robot in robots]
        results: list[Array] = [np.empty(0)] * len(items)
        workers = max(1, min(self.workers or available_cores(), len(items)))
        parts = [range(k, len(items), workers) for k in range(workers)]
        if workers == 1:
            self._work(shared, items, parts[0], results)
            return results
        with ThreadPoolExecutor(workers, thread_name_prefix="windows") as pool:
            for future in [pool.submit(self._work, shared, items, part, results) for part in parts]:
                future.result()
        return results

    def _work(self, shared: list[_Shared], items: Items, rows: range, results: list[Array]) -> None:
        buffers = self._spare.pop() if self._spare else _Buffers(self._rows)
        try:
            for i in rows:
                results[i] = self._one(shared[items.robot[i]], items, i, buffers)
        finally:
            self._spare.append(buffers)

    def _one(self, shared: _Shared, items: Items, i: int, buffers: _Buffers) -> Array:
        from artibot_sim.model import loop

        table, plan = self.tables[items.table[i]], self.plans[items.plan[i]]
        first, knots = int(items.first[i]), int(items.knots[i])
        part = slice(first, first + knots + 1)
        knot_steps = round(table.dt / self.dt)
        q, v, previous = items.q[i].copy(), items.v[i].copy(), np.zeros(4)
        eta = shared.eta.copy()
        fx = record(shared.robot.effects, float(items.t[i])) if shared.robot.effects else None
        extra = () if fx is None else (fx, np.zeros(8))
        status, kept = loop.integrate_rk4(
            q, v, eta, previous, shared.p, shared.modes[items.table[i]], self.dt, knots * knot_steps, knot_steps,
            *shared.driven(table, part), knot_steps,
            shared.back_factor[items.table[i]], buffers.work, buffers.q, buffers.v, buffers.w, None, *extra,
        )  # fmt: skip
        out = np.full(len(plan.t), math.nan)
        if status == loop.OK or kept > 1:
            from artibot_sim.model.sampling import sample

            sample(buffers.q, buffers.v, buffers.w, table.dt, kept, shared.two, plan.t, plan.kind, shared.sensors, out)
        return out


class _Buffers:
    """What one thread writes into."""

    def __init__(self, rows: int) -> None:
        from artibot_sim.model import loop
        from artibot_sim.model.layout import ROW

        self.work = loop.workspace()
        self.q, self.v, self.w = np.empty((rows, 16)), np.empty((rows, 16)), np.empty((rows, ROW))


class _Shared:
    """What all items of one robot share."""

    def __init__(self, robot: Robot, tables: Sequence[MotorTable]) -> None:
        p = params(robot)
        self.robot = robot
        self.two = robot.articulated
        self.eta = np.array([robot.drive.front.eta_d] * 2 + [(robot.drive.back or robot.drive.front).eta_d] * 2)
        modes = {table.modes for table in tables}
        limited = unlimited_beside_prescribed(p, next(iter(modes))) if len(modes) == 1 else p
        self.p: Any = packed(limited)
        self.modes = [np.array(table.modes, dtype=np.int64) for table in tables]
        self.errors = sensor_errors(robot)
        self.sensors = np.array(self.errors)
        self.back_factor = [back_torque_factor(robot, table.kappa) for table in tables]

    def driven(self, table: MotorTable, part: slice) -> tuple[Array, Array, Array]:
        """How the motors really turned and pulled where sensors showed what the table says."""
        turned, pulled = self.errors.encoder_scale, self.errors.torque_scale
        position, velocity, torque = table.position[part], table.velocity[part], table.torque[part]
        if turned != 1.0:
            position, velocity = position / turned, velocity / turned
        return position, velocity, torque if pulled == 1.0 else torque / pulled


def window_step(robot: Robot, tables: Sequence[MotorTable]) -> float:
    """The longest of a few steps (s) that divides the tables' spacing and that RK4 takes with some margin.

    Raises
    ------
    ArtibotError
        If none does.
    """
    limits = [largest_step(params(robot), "rk4", modes)[0] for modes in {table.modes for table in tables}]
    longest = _MARGIN * min(limits, default=math.inf)
    for dt in _STEPS:
        if dt <= longest and all(abs(table.dt / dt - round(table.dt / dt)) < 1e-6 for table in tables):
            return dt
    raise ArtibotError(
        f"robot '{robot.name}': RK4 is stable up to {longest / _MARGIN:.2g} s only, too little for fitting; "
        "check its masses, inertias and slip coefficients"
    )
