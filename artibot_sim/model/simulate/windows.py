"""Many short rollouts of one recording: windows × perturbed robots × perturbed starts, sampled where sensors were.

Fitting needs thousands of short simulations whose motors turn as they were measured, of which only what sensors saw
is wanted. `WindowBatch` runs them in threads (the compiled code holds no lock), each exactly as `rollout` would.

"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.analysis.stability import largest_step, rigid_limit, slip_speedup, slip_time
from artibot_sim.model.effects import LAW_DTYPE, RECORD_DTYPE, has_laws, has_memory, record
from artibot_sim.model.equations.transmission import Mode, back_torque_factor
from artibot_sim.model.kernels import loop
from artibot_sim.model.kernels.advance import advance
from artibot_sim.model.kernels.lane_layout import EXTENDED, TRANSFERRING, extension, flat
from artibot_sim.model.kernels.layout import MEMORY, ROW, Grid, KernelInputs, RowTables, RunState
from artibot_sim.model.kernels.sampling import (
    COLUMNS,
    ENCODER_SCALE,
    TORQUE_SCALE,
    VELOCITY_FILTER,
    gather,
    sample,
)
from artibot_sim.model.robot.derived import PARAMS_DTYPE, params
from artibot_sim.model.robot.parameters import NO_SENSOR_ERRORS
from artibot_sim.model.robot.robot import Robot
from artibot_sim.model.simulate.batch import available_cores
from artibot_sim.model.simulate.rollout import unlimited_beside_prescribed
from artibot_sim.model.simulate.sensors import sensor_errors
from artibot_sim.model.simulate.train_windows import TrainWindows, train_step
from artibot_sim.model.simulate.window_inputs import (
    Items,
    MotorTable,
    SamplingPlan,
    by_numbers,
    longest_step,
    real,
    whole,
)

if TYPE_CHECKING:
    from artibot_sim.model.kernels.window_lanes import WindowItems
    from artibot_sim.model.robot.parameters import Params

# ----------------------------------------------------------------------
# What `WindowBatch` is given, laid out for compiled code: knots of all tables, samples of all plans, robots.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Knots:
    """Tables one after the other.

    Attributes
    ----------
    position, velocity, torque : array, shape (k, 4)
    behind : array, shape (k, 8)
    begin, steps : array of int, shape (tables,)
        First row of each table, and integration steps from a knot to the next.
    modes : array of int, shape (tables, 4)
    free, front_free : array of bool, shape (tables,)
        Whether any motor is not prescribed, and whether any front one is: a rigid robot has no others.
    """

    position: Array
    velocity: Array
    torque: Array
    behind: Array
    begin: Indices
    steps: Indices
    modes: Indices
    free: Mask
    front_free: Mask

    @classmethod
    def of(cls, tables: Sequence[MotorTable], dt: float) -> Knots:
        """Of tables, whose `dt` are whole multiples of the step `dt`, s."""
        position, velocity, torque, behind = (
            real(np.concatenate([getattr(table, name) for table in tables] or [np.empty((0, 4))]))
            for name in ("position", "velocity", "torque", "behind")
        )
        lengths = [len(table.position) for table in tables]
        modes = np.array([table.modes for table in tables], dtype=np.int64).reshape(len(tables), position.shape[1])
        begin, steps = np.cumsum([0, *lengths])[:-1], np.array([round(table.dt / dt) for table in tables], np.int64)
        free = modes != Mode.PRESCRIBED
        front_free = free[:, :2].any(axis=1)
        return cls(position, velocity, torque, behind, begin, steps, modes, free.any(axis=1), front_free)


@dataclass(frozen=True)
class PlanTable:
    """Plans one after the other.

    Attributes
    ----------
    t : array, shape (m,)
    kind : array of int, shape (m,)
    begin, sizes : array of int, shape (plans,)
    torques, wheels : array of bool, shape (plans,)
        Whether they ask for torques, and for what single wheels do.
    """

    t: Array
    kind: Indices
    begin: Indices
    sizes: Indices
    torques: Mask
    wheels: Mask

    @classmethod
    def of(cls, plans: Sequence[SamplingPlan]) -> PlanTable:
        """Of plans."""
        sizes = np.array([len(plan.t) for plan in plans], np.int64)
        t = np.concatenate([np.empty(0), *(plan.t for plan in plans)])
        kind = np.concatenate([np.empty(0, np.int64), *(plan.kind for plan in plans)])
        torques, wheels = (
            np.array([((plan.kind >= low) & (plan.kind < high)).any() for plan in plans], dtype=bool)
            for low, high in ((10, 14), (14, 16))
        )
        return cls(t, kind, np.cumsum(sizes) - sizes, sizes, torques, wheels)


@dataclass(frozen=True)
class Fleet:
    """Robots as compiled code takes them.

    Attributes
    ----------
    robots : sequence of Robot
    records : array of PARAMS_DTYPE, shape (r,)
    eta : array, shape (r, 4)
        Efficiencies of a first step.
    effects : array of RECORD_DTYPE, shape (r,)
        Zeros for those without.
    laws : array of LAW_DTYPE, shape (r,)
        Effects of robots with laws, these among them; empty where no robot has any.
    lawful : array of bool, shape (r,)
        Which have laws.
    extended : array of int, shape (r,)
        Which need the extended model: 0 for none, else which of EXTENDED, from 1.
    share : array, shape (r, tables)
        Eq. 30's factor.
    sensors : array, shape (r, 8)
        Rows of SensorErrors.
    """

    robots: Sequence[Robot]
    records: NDArray[Any]
    eta: Array
    effects: NDArray[Any]
    laws: NDArray[Any]
    lawful: Mask
    extended: Indices
    share: Array
    sensors: Array

    @classmethod
    def of(cls, robots: Sequence[Robot], tables: Sequence[MotorTable], free: bool) -> Fleet:
        """Of robots; eq. 30 is for tables with `free` motors."""
        different, like = by_numbers(robots)
        every = [params(robot) for robot in different]
        modes = {table.modes for table in tables}
        if len(modes) == 1:
            every = [unlimited_beside_prescribed(p, next(iter(modes))) for p in every]
        drives = [(robot.drive.front, robot.drive.back or robot.drive.front) for robot in different]
        effects, extended = np.zeros(len(robots), RECORD_DTYPE), np.zeros(len(robots), np.int64)
        lawful = np.array([has_laws(robot.effects) for robot in robots], dtype=bool)
        laws = np.zeros(len(robots) if lawful.any() else 0, LAW_DTYPE)
        for i, robot in enumerate(robots):
            found = record(robot.effects, 0.0) if robot.effects else None
            if found is None:
                continue
            effects[i] = found[list(effects.dtype.names or ())] if lawful[i] else found
            if lawful[i]:
                laws[i] = found
            extended[i] = len(extension(robot.effects) or ())
        share = np.zeros((len(different), len(tables)))
        if free:
            share[:] = [[back_torque_factor(robot, table.kappa) for table in tables] for robot in different]
        eta = np.array([[front.eta_d] * 2 + [back.eta_d] * 2 for front, back in drives]).reshape(-1, 4)
        sensors = np.array([sensor_errors(robot) for robot in different], dtype=float).reshape(
            -1, len(NO_SENSOR_ERRORS)
        )
        records = np.array(every, dtype=PARAMS_DTYPE)
        return cls(robots, records[like], eta[like], effects, laws, lawful, extended, share[like], sensors[like])


def level(fleet: Fleet, items: Items) -> Mask:
    """Which items lanes take, shape (n,): those that stay on a plane, unless laws might follow loads that move.

    Lanes find what laws do before they know these.
    """
    from artibot_sim.model.kernels.lane_loading import find_level

    found = np.zeros(len(items), bool)
    extended = fleet.extended[items.robot] > 0
    moving = fleet.lawful & np.array(TRANSFERRING)[fleet.extended]
    for rows, effects in ((~extended, None), (extended & ~moving[items.robot], fleet.effects)):
        if rows.any():
            some = np.zeros(int(rows.sum()), bool)
            find_level(fleet.records, effects, whole(items.robot[rows]), items.q[rows], items.v[rows], some)
            found[rows] = some
    return found


def lane_work(fleet: Fleet, items: Items, knots: Knots, plans: PlanTable, ends: Indices) -> WindowItems:
    """All that lanes need; `ends` (n,) are where the items' results end."""
    from artibot_sim.model.kernels.window_lanes import WindowItems

    sizes, begin = plans.sizes[items.plan], plans.begin[items.plan]
    return WindowItems(
        fleet.records, fleet.eta, flat(fleet.effects), fleet.sensors, knots.position, knots.velocity, knots.torque,
        knots.behind, knots.modes[items.table], fleet.share[items.robot, items.table], whole(items.robot),
        knots.begin[items.table] + items.first, whole(items.knots), real(items.q), real(items.v), real(items.t),
        remembered(items), begin, begin + sizes, plans.t, plans.kind, ends - sizes,
    )  # fmt: skip


def remembered(items: Items) -> Array:
    """What wheels remember at the starts of all items, (n, MEMORY)."""
    return np.zeros((len(items), MEMORY)) if items.memory is None else real(items.memory)


# ----------------------------------------------------------------------
# Windows one by one, by the kernels of `rollout`: for what does not stay on a plane, or is asked how wheels slide.
# ----------------------------------------------------------------------


class SingleBuffers(NamedTuple):
    """What one thread writes into."""

    work: loop.Workspace
    q: Array
    v: Array
    w: Array
    rows: Array


def single_buffers(rows: int) -> SingleBuffers:
    """Fresh ones, for items of at most `rows` rows."""
    return SingleBuffers(
        loop.workspace(), np.empty((rows, 16)), np.empty((rows, 16)), np.empty((rows, ROW)), np.empty(rows * COLUMNS)
    )


def turned_motors(table: MotorTable, part: slice, sensors: Array) -> tuple[Array, Array]:
    """Angles and speeds (n, 4) of motors whose rotations a robot's `sensors` (8,) have recorded so.

    Angles count from the first knot, where both are the same.
    """
    position, velocity, trailing = table.position[part], table.velocity[part], sensors[VELOCITY_FILTER]
    if trailing:
        angle, speed = np.hsplit(table.behind[part], 2)
        position, velocity = position + trailing * (angle - angle[0]), velocity + trailing * speed
    turned = sensors[ENCODER_SCALE]
    return np.ascontiguousarray(position / turned), np.ascontiguousarray(velocity / turned)


def run_window(
    fleet: Fleet,
    items: Items,
    i: int,
    table: MotorTable,
    plan: SamplingPlan,
    dt: float,
    room: SingleBuffers,
    out: Array,
) -> None:
    """Item `i`: what its plan asks for, into `out` (m,), which is left as it is from where the rollout diverged."""
    r, first, knots = int(items.robot[i]), int(items.first[i]), int(items.knots[i])
    part, knot_steps = slice(first, first + knots + 1), round(table.dt / dt)
    torque = np.ascontiguousarray(table.torque[part])  # as `rollout` has it: another order would be compiled for anew
    position, velocity = turned_motors(table, part, fleet.sensors[r])
    extra: tuple[Any, ...] = ()
    if fleet.extended[r]:
        fx = (fleet.laws[r] if fleet.lawful[r] else fleet.effects[r]).copy()
        fx["t"] = items.t[i]
        lags = np.zeros(MEMORY) if items.memory is None else real(items.memory[i])
        extra = fx, (lags,) if has_memory(fleet.robots[r].effects) else ()
    work, q, v, w, rows = room
    pulled = fleet.sensors[r, TORQUE_SCALE]
    state = RunState(items.q[i].copy(), items.v[i].copy(), fleet.eta[r].copy(), np.zeros(4), np.zeros(4))
    inputs = KernelInputs(
        np.array(table.modes, dtype=np.int64), position, velocity, torque / pulled,
        fleet.share[r, items.table[i]],
    )  # fmt: skip
    grid = Grid(dt, knots * knot_steps, knot_steps, knot_steps)
    _, kept = advance("rk4", (state, fleet.records[r], inputs, grid, work, RowTables(q, v, w), None), extra)
    if kept > 1:
        gather(q, v, w, kept, rows)
        sample(rows, table.dt, kept, fleet.robots[r].articulated, plan.t, plan.kind, fleet.sensors, r, out)


# ----------------------------------------------------------------------
# Many short rollouts of one recording: windows × perturbed robots × perturbed starts, sampled where sensors were.
#
# Fitting needs thousands of short simulations whose motors turn as they were measured, of which only what sensors
# saw is wanted. `WindowBatch` runs them in threads (the compiled code holds no lock), each exactly as `rollout`
# would.
# ----------------------------------------------------------------------


_STEPS = (1e-2, 5e-3, 2.5e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5)
_MARGIN = 0.8  # of the longest stable step: at the limit itself errors do not decay
_ALWAYS_EXACT = 5e-3
"""A longer step (s) is taken where slip decays as slowly: else its own error is a part of what is estimated.

With 1.3 times that time a low-pass of 0.150 s before a Husky's speeds was found 0.8 ms too small, a third of its
interval.
"""


@dataclass
class WindowBatch:
    """Runs items; keeps what it can between calls.

    Rovers that stay on a plane run side by side in the processor's vector units (`window_lanes`); the others, and those
    of which it is asked how wheels slide or grip, one by one. Both give what `rollout` would, to rounding, and neither
    depends on what else runs. So do robots of three modules or more, of which all that run at once have as many
    (`train_windows`).

    Parameters
    ----------
    tables : sequence of MotorTable
    plans : sequence of SamplingPlan
    dt : float
        Integration step, s; it divides every table's `dt`.
    workers : int, optional
        Threads; as many as cores by default. Results do not depend on it.
    plain : Robot, optional
        The robot that the step was chosen for, by which `suits` knows what an articulated one allows.
    knots : Knots, optional
        The tables' in such steps, where they are known.
    """

    tables: Sequence[MotorTable]
    plans: Sequence[SamplingPlan]
    dt: float
    workers: int | None = None
    plain: Robot | None = None
    knots: InitVar[Knots | None] = None
    _knots: Knots = field(init=False, repr=False)
    _plan_table: PlanTable = field(init=False, repr=False)
    _spare: dict[Callable[[int], Any], list[tuple[int, Any]]] = field(default_factory=dict, repr=False)

    def __post_init__(self, knots: Knots | None) -> None:
        for i, table in enumerate(self.tables):
            ratio = table.dt / self.dt
            if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
                raise ArtibotError(f"dt: {self.dt:g} s does not divide table {i}'s knot spacing of {table.dt:g} s")
        self._knots, self._plan_table = knots or Knots.of(self.tables, self.dt), PlanTable.of(self.plans)

    def run(self, robots: Sequence[Robot], items: Items) -> list[Array]:
        """What each item's plan asks for, (m,) each; NaN from where a rollout diverged."""
        if not len(items):
            return []
        sizes = self._plan_table.sizes[items.plan]
        found, ends = self.run_flat(robots, items), np.cumsum(sizes)
        return [found[begin:end] for begin, end in zip(ends - sizes, ends, strict=True)]

    def run_flat(self, robots: Sequence[Robot], items: Items) -> Array:
        """Run all items; what their plans ask for, item after item, shape (sum of the plans' lengths,)."""
        ends = np.cumsum(self._plan_table.sizes[items.plan])
        out = np.full(int(ends[-1]) if len(ends) else 0, math.nan)
        if robots[0].trailing:
            trains = TrainWindows(robots, self.tables, self.plans, items, self.dt)
            in_threads(lambda part, parts: trains.run_all(part, parts, out), self.workers or available_cores())
            return out
        free = self._knots.free if any(robot.articulated for robot in robots) else self._knots.front_free
        fleet = Fleet.of(robots, self.tables, bool(free.any()))
        together = level(fleet, items) & ~self._plan_table.wheels[items.plan]
        groups = list(self._groups(fleet, items, np.flatnonzero(together)))
        alone = np.flatnonzero(~together)
        work = lane_work(fleet, items, self._knots, self._plan_table, ends) if groups else None

        def run(part: int, parts: int) -> None:
            for group in groups:
                self._run_lanes(fleet, work, group, part, parts, out)
            if len(alone[part::parts]):
                self._run_alone(fleet, items, alone[part::parts], ends, out)

        in_threads(run, self.workers or available_cores())
        return out

    def with_plans(self, plans: Sequence[SamplingPlan]) -> WindowBatch:
        """This batch for other plans."""
        return replace(self, plans=plans, knots=self._knots)

    @cached_property
    def halved(self) -> WindowBatch:
        """This batch with integration steps of half the length."""
        return replace(self, dt=self.dt / 2.0)

    def suits(self, robots: Sequence[Robot]) -> bool:
        """Whether all `robots` take the step, as far as that is known at once: of one or two modules."""
        if robots[0].trailing:
            return True
        every = [params(robot) for robot in robots]
        if robots[0].articulated or bool(self._knots.front_free.any()):
            limit, plain = self._plain_limit
            return plain is None or all(self.dt * slip_speedup(p, plain) <= _MARGIN * limit for p in every)
        rim = max(p.right_front.r_w * p.right_front.tau for p in every)
        stable = all(self.dt <= _MARGIN * rigid_limit(p, rim * self._fastest) for p in every)
        return stable and (self.dt <= _ALWAYS_EXACT or all(self.dt <= slip_time(p) for p in every))

    @cached_property
    def _plain_limit(self) -> tuple[float, Params | None]:
        """Longest stable step (s) of the robot that the step was chosen for, and what it is made of."""
        return (math.inf, None) if self.plain is None else (rk4_limit(self.plain, self.tables), params(self.plain))

    @cached_property
    def _fastest(self) -> float:
        """The highest speed of a motor, rad/s."""
        return float(np.nanmax(np.abs(self._knots.velocity), initial=0.0))

    def _groups(self, fleet: Fleet, items: Items, rows: Indices) -> Iterator[_Group]:
        """Items that can share a block: those with most knots first."""
        robots, tables = items.robot[rows], items.table[rows]
        rigid, extended = ~fleet.records["two"][robots], fleet.extended[robots]
        free = np.where(rigid, self._knots.front_free[tables], self._knots.free[tables])
        steps = self._knots.steps[tables]
        version = extended * 2 + fleet.lawful[robots]
        kinds = ((steps * 2 + free) * 2 * (len(EXTENDED) + 1) + version) * 2 + rigid  # one number each: quick to sort
        for kind in np.unique(kinds):
            among = np.flatnonzero(kinds == kind)
            one, mine = among[0], rows[among]
            order = mine[np.argsort(-items.knots[mine], kind="stable")]
            torques = bool(self._plan_table.torques[items.plan[mine]].any())
            most = int(items.knots[order[0]])
            yield _Group(
                order, int(steps[one]), bool(free[one]), torques, int(extended[one]), bool(rigid[one]),
                bool(fleet.lawful[robots[one]]), most,
            )  # fmt: skip

    def _run_lanes(self, fleet: Fleet, work: Any, group: _Group, part: int, parts: int, out: Array) -> None:
        """A thread's part of a group."""
        from artibot_sim.model.kernels import window_lanes

        fx = EXTENDED[group.extended - 1] if group.extended else None
        laws = fleet.laws.copy() if group.lawful else None  # motion is noted there
        count, buffers = self._borrow(window_lanes.buffers, group.most + 1)
        settings = np.array([4, 4 if group.free else int(group.torques)], dtype=np.int64)
        window_lanes.run_windows(
            work, group.order, part, parts, self.dt, group.steps, settings, buffers, out,
            fx, True if group.rigid else None, laws,
        )  # fmt: skip
        self._spare[window_lanes.buffers].append((count, buffers))

    def _run_alone(self, fleet: Fleet, items: Items, rows: Indices, ends: Indices, out: Array) -> None:
        """Items one by one."""

        count, buffers = self._borrow(single_buffers, int(items.knots[rows].max()) + 1)
        for i in rows:
            table, plan = self.tables[items.table[i]], self.plans[items.plan[i]]
            mine = out[ends[i] - len(plan.t) : ends[i]]
            run_window(fleet, items, int(i), table, plan, self.dt, buffers, mine)
        self._spare[single_buffers].append((count, buffers))

    def _borrow(self, make: Callable[[int], Any], rows: int) -> tuple[int, Any]:
        """Buffers that no other thread has, for at least so many rows."""
        try:
            count, found = self._spare.setdefault(make, []).pop()
        except IndexError:
            count, found = 0, None
        return (count, found) if count >= rows else (rows, make(rows))


class _Group(NamedTuple):
    """Items that run side by side.

    Which, steps a knot, `free` motors, `torques` wanted, version of the model, `rigid` ones, those with laws, knots of
    the longest one.
    """

    order: Indices
    steps: int
    free: bool
    torques: bool
    extended: int
    rigid: bool
    lawful: bool
    most: int


def in_threads(run: Callable[[int, int], None], workers: int) -> None:
    """``run(k, workers)`` for every k at once, this thread among them; the first exception is raised again."""
    failed: list[BaseException] = []

    def guarded(k: int) -> None:
        try:
            run(k, workers)
        except BaseException as error:  # noqa: BLE001 - raised again below, in the calling thread
            failed.append(error)

    others = [threading.Thread(target=guarded, args=(k,), name=f"windows-{k}") for k in range(1, workers)]
    for thread in others:
        thread.start()
    guarded(0)
    for thread in others:
        thread.join()
    if failed:
        raise failed[0]


def rk4_limit(robot: Robot, tables: Sequence[MotorTable]) -> float:
    """Longest step (s) at which RK4 is stable for a robot of one or two modules whose motors turn as tables say."""
    driven = {(table.modes, back_torque_factor(robot, table.kappa)) for table in tables}
    return min((largest_step(params(robot), "rk4", modes, share)[0] for modes, share in driven), default=math.inf)


def window_step(robot: Robot, tables: Sequence[MotorTable]) -> float:
    """The longest of a few steps (s) that divides the tables' spacing and that RK4 takes with some margin.

    Of a robot of three modules or more, that of `train_step`.

    Raises
    ------
    ArtibotError
        If none does.
    """
    if robot.trailing:
        return train_step(robot, tables)
    longest = _MARGIN * rk4_limit(robot, tables)
    dt = longest_step(_STEPS, longest, tables)
    if dt is not None:
        return dt
    raise ArtibotError(
        f"robot '{robot.name}': RK4 is stable up to {longest / _MARGIN:.2g} s only, too little for fitting; "
        "check its masses, inertias and slip coefficients"
    )
