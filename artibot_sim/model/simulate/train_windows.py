"""Windows of robots of three modules or more: what `windows.WindowBatch` runs for them, one by one.

Trains have no lanes. Each window is a rollout of its own by the loops of `kernels.train_loop`, with the semi-implicit
integrator: free wheels of a passive module, which RK4 follows in steps of half a millisecond, are implicit there.
What sensors see is sampled as of two modules, pair by pair: each module with the one behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.analysis.stability import largest_step, parts
from artibot_sim.model.effects import records
from artibot_sim.model.equations.transmission import torque_factors
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
from artibot_sim.model.simulate.window_inputs import OF_MODULE, OF_TWO, Items, MotorTable, SamplingPlan, longest_step

Array = NDArray[np.float64]

_AS_BACK = np.array([3, 9, 12, 13])
"""Which kinds they are of the module that stands in the back one's place."""
_STEPS = (1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5)
"""s: where wheels hold, paths by the first are those by short steps of RK4 within a millimetre in 5 s (tests)."""


@dataclass(frozen=True)
class Prepared:
    """A robot as the loops take it, for motors of some modes.

    Attributes
    ----------
    p : Train
    modules, joints : arrays of records
    modes : array of int, shape (sides,)
    factors : tuple of float
        Eq. 30's of each module.
    eta : array, shape (modules, 2)
        Efficiencies of a first step.
    fx : array of records or None
        Effects, module by module.
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
    fx: Any
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
            records(robot.effects, 0.0, len(p.modules)), np.array([sensor_errors(robot)], dtype=float),
            parts(p, dt, factors),
        )  # fmt: skip


class TrainWindows:
    """Some windows of trains, to be run in any order and from several threads.

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
        wanted = sorted({(int(r), int(t)) for r, t in zip(items.robot, items.table, strict=True)})
        alike: dict[tuple[Any, ...], Prepared] = {}
        self._prepared: dict[tuple[int, int], Prepared] = {}
        for r, t in wanted:
            key = (r, tables[t].modes, tables[t].kappa)
            if key not in alike:
                alike[key] = Prepared.of(robots[r], tables[t], dt)
            self._prepared[r, t] = alike[key]
        self._sides = trains.sides(robots[0])
        self._laid_out = [self._by_module(table) for table in tables]

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
        of, plan = self._prepared[int(items.robot[i]), int(items.table[i])], self._plans[items.plan[i]]
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
        if of.fx is not None:
            fx, memory = of.fx.copy(), np.zeros((modules, MEMORY // 2))
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


def _sample(rows: RowTables, modules: int, h: float, kept: int, plan: SamplingPlan, sensors: Array, out: Array) -> None:
    """Samples of a plan into `out`, from `kept` rows `h` (s) apart, pair of modules by pair."""
    behind = np.maximum(plan.kind - OF_TWO, -1) // len(OF_MODULE) + 1
    for pair in range(modules - 1):
        mine = np.flatnonzero(behind == pair)
        if not len(mine):
            continue
        kind = plan.kind[mine] if pair == 0 else _AS_BACK[(plan.kind[mine] - OF_TWO) % len(OF_MODULE)]
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
