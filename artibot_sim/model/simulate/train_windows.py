"""Windows of robots of three modules or more: what `windows.WindowBatch` runs for them.

All are rollouts with the semi-implicit integrator: free wheels of a passive module, which RK4 follows in steps of half
a millisecond, are implicit there. Trains that stay on a plane run side by side in the processor's vector units
(`kernels.train_lanes`); the others, those with motors that have velocity loops, and those of which it is asked how
wheels slide or grip, one by one by `kernels.train_loop`. Both give the same to rounding. What sensors see is
sampled as of two modules, pair by pair: each module with the one behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.analysis.stability import largest_step, parts
from artibot_sim.model.effects import LAW_DTYPE, RECORD_DTYPE, records
from artibot_sim.model.equations.transmission import DRIVEN, PRESCRIBED, torque_factors
from artibot_sim.model.kernels.lane_layout import EFFECT_VALUES, EXTENDED, extension, flat
from artibot_sim.model.kernels.layout import (
    ACC,
    BACK,
    F_L,
    F_N,
    F_T,
    GAMMA,
    M_M,
    MEMORY,
    SAT,
    Grid,
    KernelInputs,
    RowTables,
    RunState,
    X,
    Y,
)
from artibot_sim.model.kernels.sampling import (
    COLUMNS,
    ENCODER_SCALE,
    GRIP_AT,
    POSE_AT,
    PUSH_AT,
    SLIDING_AT,
    SPEED_AT,
    TORQUE_AT,
    TORQUE_SCALE,
    VELOCITY_FILTER,
    sample,
)
from artibot_sim.model.kernels.train_layout import KEPT
from artibot_sim.model.robot.derived import packed_all, train
from artibot_sim.model.robot.parameters import Train
from artibot_sim.model.robot.robot import Robot
from artibot_sim.model.simulate import trains
from artibot_sim.model.simulate.sensors import sensor_errors
from artibot_sim.model.simulate.window_inputs import (
    OF_MODULE,
    OF_TWO,
    Items,
    MotorTable,
    SamplingPlan,
    by_numbers,
    kind_of,
    longest_step,
    real,
    whole,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_AS_BACK = np.array([3, 9, 12, 13])
"""Which kinds they are of the module that stands in the back one's place."""
_OF_WHEELS = [kind_of("sliding"), kind_of("grip")]
_STEPS = (1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5)
"""s: where wheels hold, paths by the first are those by short steps of RK4 within a millimetre in 5 s (tests)."""


@dataclass(frozen=True)
class Prepared:
    """A robot as the loops take it, but for its effects, for motors of some modes.

    Attributes
    ----------
    p : Train
    modules, joints : arrays of records
    modes : array of int, shape (sides,)
    factors : tuple of float
        Eq. 30's of each module.
    eta : array, shape (modules, 2)
        Efficiencies of a first step.
    sensors : array, shape (1, 8)
        A row of SensorErrors.
    parts : int
        Of a step.
    """

    p: Train
    modules: NDArray[Any]
    joints: NDArray[Any]
    modes: NDArray[np.int64]
    factors: tuple[float, ...]
    eta: Array
    sensors: Array
    parts: int

    @classmethod
    def of(cls, robot: Robot, table: MotorTable, dt: float) -> Prepared:
        """Of a robot and how its motors are driven."""
        modes, factors = trains.by_side(robot, table.modes), torque_factors(robot, table.kappa)
        p = trains.unlimited_beside_prescribed(train(robot), modes)
        eta = np.array([[m.right_front.eta_d, m.left_front.eta_d] for m in p.modules])
        return cls(
            p, packed_all(p.modules), packed_all(p.joints), np.array(modes, dtype=np.int64), factors, eta,
            np.array([sensor_errors(robot)], dtype=float), parts(p, dt, factors),
        )  # fmt: skip


class TrainWindows:
    """Some windows of trains, to be run by several threads.

    Parameters
    ----------
    robots : sequence of Robot
        All with as many modules.
    tables : sequence of MotorTable
    plans : sequence of SamplingPlan
    items : Items
        Their states are (n, 8 modules).
    dt : float
        Integration step, s.
    """

    def __init__(
        self,
        robots: Sequence[Robot],
        tables: Sequence[MotorTable],
        plans: Sequence[SamplingPlan],
        items: Items,
        dt: float,
    ) -> None:
        self._robots, self._tables, self._plans, self._items, self._dt = robots, tables, plans, items, dt
        self._ends = np.cumsum([len(plans[plan].t) for plan in items.plan])
        different, like = by_numbers(robots)
        self._every: list[Prepared] = []
        self._number = self._prepared(different, like)
        self._fx = [records(robot.effects, 0.0, len(robot.modules)) for robot in robots]
        self._lawful = [fx is not None and fx.dtype == LAW_DTYPE for fx in self._fx]
        self._laws = self._every_law()
        self._sides = trains.sides(robots[0])
        self._laid_out = [self._by_module(table) for table in tables]
        self._groups, self._alone, self._work = self._side_by_side()

    def run_all(self, part: int, parts: int, out: Array) -> None:
        """A thread's part of all items: what their plans ask for, item after item, into `out`."""
        from artibot_sim.model.kernels import train_lanes

        modules = len(self._robots[0].modules)
        samples = max((len(plan.t) for plan in self._plans), default=0)
        for group in self._groups:
            buffer = train_lanes.buffers(modules, int(self._items.knots[group.order[0]]) + 1, samples)
            fx = EXTENDED[group.extended - 1] if group.extended else None
            train_lanes.run_trains(
                self._work, group.order, part, parts, group.dt, group.steps, group.free, buffer, out, fx,
                self._laws if group.lawful else None,
            )  # fmt: skip
        for i in self._alone[part::parts]:
            self.run(int(i), out[self._ends[i] - len(self._plans[self._items.plan[i]].t) : self._ends[i]])

    def _prepared(self, different: Sequence[Robot], like: Indices) -> Indices:
        """Which of `_every` each item is of, (n,); made once for robots alike whose motors are driven alike."""
        numbers: dict[tuple[Any, ...], int] = {}
        found = np.empty(len(self._items), np.int64)
        driven = [(table.modes, table.kappa) for table in self._tables]
        own = like[self._items.robot]
        for i, (r, t) in enumerate(zip(own.tolist(), self._items.table.tolist(), strict=True)):
            key = (r, driven[t])
            if key not in numbers:
                numbers[key] = len(self._every)
                self._every.append(Prepared.of(different[r], self._tables[t], self._dt))
            found[i] = numbers[key]
        return found

    def _every_law(self) -> NDArray[Any]:
        """Laws of all robots (r, modules), of those that have any."""
        found = np.empty((len(self._robots) if any(self._lawful) else 0, len(self._robots[0].modules)), LAW_DTYPE)
        for i in np.flatnonzero(self._lawful):
            found[i] = self._fx[i]
        return found

    def _side_by_side(self) -> tuple[list[_Group], Indices, Any]:
        """Items that can share a block, those with most knots first; the others; what compiled code takes of all."""
        from artibot_sim.model.kernels import train_lanes

        items, every, robot = self._items, self._every, self._number
        plain = ~np.array([DRIVEN in of.modes for of in every])[robot]
        if not plain.any():
            return [], np.arange(len(items)), None
        fx_of = self._effects()
        work = self._work_of(fx_of)
        extended = np.array([len(extension(one.effects) or ()) for one in self._robots])[items.robot]
        level = np.zeros(len(items), bool)
        for rows, fx in ((extended == 0, None), (extended > 0, fx_of)):
            rows = rows & plain
            if rows.any():
                some = np.zeros(int(rows.sum()), bool)
                mine = work._replace(robot=work.robot[rows], fx=work.fx[rows], q=work.q[rows], v=work.v[rows])
                train_lanes.find_level(mine, fx, some)
                level[rows] = some
        wheels = np.array([bool(np.isin(plan.kind, _OF_WHEELS).any()) for plan in self._plans])
        together = level & ~wheels[items.plan]
        free = [tuple((of.modes.reshape(-1, 2) != PRESCRIBED).any(axis=1)) for of in every]
        spacing = [table.dt for table in self._tables]
        groups: dict[tuple[Any, ...], list[int]] = {}
        for i in np.flatnonzero(together).tolist():
            of = int(robot[i])
            key = (spacing[items.table[i]], every[of].parts, free[of], int(extended[i]), self._lawful[items.robot[i]])
            groups.setdefault(key, []).append(i)
        found = []
        for (h, cut, moves, version, lawful), rows in groups.items():
            mine = np.array(rows)
            order = mine[np.argsort(-items.knots[mine], kind="stable")]
            steps = round(h / self._dt) * cut
            found.append(_Group(order, self._dt / cut, steps, np.array(moves), version, lawful))
        return found, np.flatnonzero(~together), work

    def _effects(self) -> NDArray[Any]:
        """Effects of all robots but their laws (r, modules); zeros where they have none."""
        found = np.zeros((len(self._robots), len(self._robots[0].modules), EFFECT_VALUES))
        for row, fx in zip(found, self._fx, strict=True):
            if fx is not None:
                row[:] = fx.view(float).reshape(len(row), -1)[:, -EFFECT_VALUES:]  # laws stand before
        return found.view(RECORD_DTYPE)[..., 0]

    def _work_of(self, fx: NDArray[Any]) -> Any:
        """All that lanes need of all items; `fx` (r, modules) are the robots' effects."""
        from artibot_sim.model.kernels.train_lanes import TrainItems

        items, every, modules = self._items, self._every, len(self._robots[0].modules)
        memory = np.zeros((len(items), modules, MEMORY // 2))
        if items.memory is not None:
            memory = np.concatenate(items.memory.reshape(len(items), 4, modules, 4).transpose(1, 0, 2, 3), axis=-1)
        position, velocity, torque, late_angle, late_speed = (
            np.concatenate([table[k].transpose(1, 0, 2).reshape(-1, 2 * modules) for table in self._laid_out])
            for k in range(5)
        )
        begin = np.cumsum([0, *(len(table.position) for table in self._tables)])
        pairs, orders, kinds = _by_pairs(self._plans, modules)
        sizes = np.array([len(plan.t) for plan in self._plans])
        at = np.concatenate([plan.t[order] for plan, order in zip(self._plans, orders, strict=True)])
        effects = flat(fx).reshape(len(fx), modules, EFFECT_VALUES)
        states = [real(array).reshape(-1, modules, 8) for array in (items.q, items.v)]
        return TrainItems(
            np.array([of.modules for of in every]), np.array([of.joints for of in every]),
            np.array([of.eta.ravel() for of in every]), effects, np.concatenate([of.sensors for of in every]),
            np.array([of.modes for of in every]), np.array([of.factors for of in every], dtype=float), position,
            velocity, torque, late_angle, late_speed, self._number, whole(items.robot),
            begin[items.table] + items.first, whole(items.knots), states[0], states[1], real(items.t), memory,
            whole(items.plan), pairs, at, np.concatenate(kinds), np.concatenate(orders), self._ends - sizes[items.plan],
        )  # fmt: skip

    def _by_module(self, table: MotorTable) -> tuple[Array, ...]:
        """Position, velocity and torque of a table, and its `behind`, by module, (modules, knots, 2) each."""
        modules, knots = len(self._robots[0].modules), len(table.position)
        found = []
        late = np.hsplit(table.behind, 2)
        for values, none in zip(
            (table.position, table.velocity, table.torque, *late), (0.0, 0.0, np.nan, 0.0, 0.0), strict=True
        ):
            laid = np.full((2 * modules, knots), none)
            laid[self._sides] = values.T
            found.append(np.ascontiguousarray(laid.reshape(modules, 2, knots).swapaxes(1, 2)))
        return tuple(found)

    def run(self, i: int, out: Array) -> None:
        """Item `i`: what its plan asks for, into `out` (m,), left as it is from where the rollout diverged."""
        from artibot_sim.model.kernels import train_loop

        items, table = self._items, self._tables[self._items.table[i]]
        of, fx = self._every[self._number[i]], self._fx[items.robot[i]]
        plan = self._plans[items.plan[i]]
        first, knots, modules = int(items.first[i]), int(items.knots[i]), len(of.modules)
        turned, pulled, trailing = of.sensors[0, [ENCODER_SCALE, TORQUE_SCALE, VELOCITY_FILTER]]
        position, velocity, torque, *late = (
            np.ascontiguousarray(array[:, first : first + knots + 1]) for array in self._laid_out[items.table[i]]
        )
        if trailing:
            angle, speed = late
            position, velocity = position + trailing * (angle - angle[:, :1]), velocity + trailing * speed
        inputs = KernelInputs(
            of.modes.reshape(modules, 2), position / turned, velocity / turned, torque / pulled, np.array(of.factors)
        )
        q, v = (array[i].reshape(modules, 8).copy() for array in (items.q, items.v))
        effects: tuple[Any, ...] = ()
        if fx is not None:
            fx, memory = fx.copy(), np.zeros((modules, MEMORY // 2))
            fx["t"] = items.t[i]
            if items.memory is not None:
                memory = np.hstack(list(items.memory[i].reshape(4, modules, 4)))
            effects = fx, memory
        steps = round(table.dt / self._dt) * of.parts
        grid = Grid(self._dt / of.parts, knots * steps, steps, steps)
        rows = RowTables(
            np.empty((knots + 1, 8 * modules)), np.empty((knots + 1, 8 * modules)),
            np.empty((knots + 1, len(KEPT) * modules)),
        )  # fmt: skip
        _, kept = train_loop.train_semi_implicit(
            RunState(q, v, of.eta.copy(), np.zeros((modules, 2)), np.zeros((modules, 2))), of.modules, of.joints,
            inputs, grid, train_loop.workspace(modules), rows, None, *effects,
        )  # fmt: skip
        if kept > 1:
            _sample(rows, modules, table.dt, kept, plan, of.sensors, out)


class _Group(NamedTuple):
    """Items that run side by side: which, their step (s), steps a knot, `free` modules, version of the model, laws."""

    order: Indices
    dt: float
    steps: int
    free: NDArray[np.bool_]
    extended: int
    lawful: bool


def _pair_of(kind: Indices) -> Indices:
    """The pair of neighbours that each kind is sampled of, counted from the front."""
    return np.asarray(np.maximum(kind - OF_TWO, -1) // len(OF_MODULE) + 1)


def _two_modules_kind(kind: Indices) -> Indices:
    """What each kind is of a robot of the two modules of its pair."""
    return np.where(kind < OF_TWO, kind, _AS_BACK[(kind - OF_TWO) % len(OF_MODULE)])


def _by_pairs(plans: Sequence[SamplingPlan], modules: int) -> tuple[Indices, list[Indices], list[Indices]]:
    """Plans pair by pair, one after the other: where pairs begin and end, the order within each plan, and the kinds."""
    starts, orders, kinds, begin = np.zeros((len(plans), modules), np.int64), [], [], 0
    for row, plan in zip(starts, plans, strict=True):
        pair = _pair_of(plan.kind)
        order = np.argsort(pair, kind="stable")
        row[:] = begin + np.searchsorted(pair[order], np.arange(modules))
        orders.append(order)
        kinds.append(_two_modules_kind(plan.kind)[order])
        begin += len(order)
    return starts, orders, kinds


def _sample(rows: RowTables, modules: int, h: float, kept: int, plan: SamplingPlan, sensors: Array, out: Array) -> None:
    """Samples of a plan into `out`, from `kept` rows `h` (s) apart, pair of modules by pair."""
    behind, kinds = _pair_of(plan.kind), _two_modules_kind(plan.kind)
    for pair in range(modules - 1):
        mine = np.flatnonzero(behind == pair)
        if not len(mine):
            continue
        kind = kinds[mine]
        seen = np.full(len(mine), np.nan)
        flat = _pair(rows, pair, modules, kept).ravel()
        sample(flat, h, kept, True, plan.t[mine], kind, sensors, 0, seen)
        reached = np.isfinite(seen)
        out[mine[reached]] = seen[reached]


def _pair(rows: RowTables, pair: int, modules: int, kept: int) -> Array:
    """Rows (kept, COLUMNS) of a module and the one behind it; what single wheels do is of all modules."""
    q, v = (array[:kept, 8 * pair : 8 * pair + 16] for array in (rows.q, rows.v))
    w = rows.w[:kept].reshape(kept, modules, len(KEPT))
    found, at = np.empty((kept, COLUMNS)), [X, Y, GAMMA, BACK + GAMMA]
    found[:, POSE_AT : POSE_AT + 4], found[:, SPEED_AT : SPEED_AT + 4] = q[:, at], v[:, at]
    found[:, PUSH_AT : PUSH_AT + 2] = w[:, pair, _kept(ACC + X, 2)]
    torque = w[:, pair : pair + 2, _kept(M_M, 2)]
    found[:, TORQUE_AT : TORQUE_AT + 4] = torque.reshape(kept, 4)
    slides = w[:, :, _kept(SAT, 4)].reshape(kept, -1)
    found[:, SLIDING_AT] = slides @ 2.0 ** np.arange(slides.shape[1])
    F_n, F_l, F_t = (w[:, :, _kept(place, 4)].reshape(kept, -1) for place in (F_N, F_L, F_T))
    holds = (slides == 0.0) & (F_n > 0.0)
    share = np.divide(np.hypot(F_l, F_t), F_n, out=np.zeros_like(F_n), where=holds)
    found[:, GRIP_AT] = share.max(axis=1)
    return found


def _kept(first: int, count: int) -> NDArray[np.int64]:
    """Where `count` entries of a module's row stand in what is kept of it."""
    return np.searchsorted(KEPT, np.arange(first, first + count))


def train_step(robot: Robot, tables: Sequence[MotorTable]) -> float:
    """The longest of a few steps (s) that divides the tables' spacing and with which a train is stable.

    Raises
    ------
    ArtibotError
        If none does.
    """
    limit = np.inf
    for modes, kappa in {(table.modes, table.kappa) for table in tables}:
        sides, factors = trains.by_side(robot, modes), torque_factors(robot, kappa)
        limit = min(limit, largest_step(train(robot), "semi_implicit", sides, factors)[0])
    dt = longest_step(_STEPS, limit, tables)
    if dt is not None:
        return dt
    raise ArtibotError(
        f"robot '{robot.name}': the integrator is stable up to {limit:.2g} s only, too little for fitting; "
        "check its masses, inertias and slip coefficients"
    )
