"""Windows one by one, by the kernels of `rollout`: for what does not stay on a plane, or is asked how wheels slide."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model import loop
from artibot_sim.model.advance import advance
from artibot_sim.model.layout import ROW
from artibot_sim.model.sampling import COLUMNS, gather, sample

if TYPE_CHECKING:
    from artibot_sim.model.window_work import Fleet
    from artibot_sim.model.windows import Items, MotorTable, Plan

Array = NDArray[np.float64]


class Buffers(NamedTuple):
    """What one thread writes into."""

    work: loop.Work
    q: Array
    v: Array
    w: Array
    rows: Array


def buffers(rows: int) -> Buffers:
    """Fresh ones, for items of at most `rows` rows."""
    return Buffers(
        loop.workspace(), np.empty((rows, 16)), np.empty((rows, 16)), np.empty((rows, ROW)), np.empty(rows * COLUMNS)
    )


def run_window(
    fleet: Fleet, items: Items, i: int, table: MotorTable, plan: Plan, dt: float, room: Buffers, out: Array
) -> None:
    """Item `i`: what its plan asks for, into `out` (m,), which is left as it is from where the rollout diverged."""
    r, first, knots = int(items.robot[i]), int(items.first[i]), int(items.knots[i])
    part, knot_steps = slice(first, first + knots + 1), round(table.dt / dt)
    position, velocity, torque = (
        np.ascontiguousarray(array[part]) for array in (table.position, table.velocity, table.torque)
    )  # as `rollout` has them: another order would be compiled for anew
    extra: tuple[Any, ...] = ()
    if fleet.extended[r]:
        fx = fleet.effects[r].copy()
        fx["t"] = items.t[i]
        extra = (fx, np.zeros(8) if items.lateral is None else items.lateral[i].copy())
    work, q, v, w, rows = room
    turned, pulled = fleet.sensors[r, :2]
    given = (
        items.q[i].copy(), items.v[i].copy(), fleet.eta[r].copy(), np.zeros(4), fleet.records[r],
        np.array(table.modes, dtype=np.int64), dt, knots * knot_steps, knot_steps, position / turned,
        velocity / turned, torque / pulled, knot_steps, fleet.share[r, items.table[i]], work, q, v, w, None,
    )  # fmt: skip
    _, kept = advance("rk4", given, extra)
    if kept > 1:
        gather(q, v, w, kept, rows)
        sample(rows, table.dt, kept, fleet.robots[r].articulated, plan.t, plan.kind, fleet.sensors, r, out)
