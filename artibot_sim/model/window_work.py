"""What `WindowBatch` is given, laid out for compiled code: knots of all tables, samples of all plans, robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import RECORD_DTYPE, record
from artibot_sim.model.lane_effects import extension, flat
from artibot_sim.model.params import PARAMS_DTYPE, params
from artibot_sim.model.robot import Robot
from artibot_sim.model.rollout_checks import unlimited_beside_prescribed
from artibot_sim.model.sensors import sensor_errors
from artibot_sim.model.transmission import Mode, back_torque_factor

if TYPE_CHECKING:
    from artibot_sim.model.window_lanes import Work
    from artibot_sim.model.windows import Items, MotorTable, Plan

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Knots:
    """Tables one after the other.

    Attributes
    ----------
    position, velocity, torque : array, shape (k, 4)
    begin, steps : array of int, shape (tables,)
        First row of each table, and integration steps from a knot to the next.
    modes : array of int, shape (tables, 4)
    free : array of bool, shape (tables,)
        Whether any motor is not prescribed.
    """

    position: Array
    velocity: Array
    torque: Array
    begin: Indices
    steps: Indices
    modes: Indices
    free: Mask

    @classmethod
    def of(cls, tables: Sequence[MotorTable], dt: float) -> Knots:
        """Of tables, whose `dt` are whole multiples of the step `dt`, s."""
        position, velocity, torque = (
            _real(np.concatenate([np.empty((0, 4)), *(getattr(table, name) for table in tables)]))
            for name in ("position", "velocity", "torque")
        )
        lengths = [len(table.position) for table in tables]
        modes = np.array([table.modes for table in tables], dtype=np.int64).reshape(-1, 4)
        begin, steps = np.cumsum([0, *lengths])[:-1], np.array([round(table.dt / dt) for table in tables], np.int64)
        return cls(position, velocity, torque, begin, steps, modes, (modes != Mode.PRESCRIBED).any(axis=1))


@dataclass(frozen=True)
class Looks:
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
    def of(cls, plans: Sequence[Plan]) -> Looks:
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
    extended : array of int, shape (r,)
        Which need the extended model: 0 none, 1 LIGHT, 2 FULL.
    share : array, shape (r, tables)
        Eq. 30's factor.
    sensors : array, shape (r, 6)
        Rows of SensorErrors.
    """

    robots: Sequence[Robot]
    records: NDArray[Any]
    eta: Array
    effects: NDArray[Any]
    extended: Indices
    share: Array
    sensors: Array

    @classmethod
    def of(cls, robots: Sequence[Robot], tables: Sequence[MotorTable], free: bool) -> Fleet:
        """Of robots; eq. 30 is for tables with `free` motors."""
        every = [params(robot) for robot in robots]
        modes = {table.modes for table in tables}
        if len(modes) == 1:
            every = [unlimited_beside_prescribed(p, next(iter(modes))) for p in every]
        drives = [(robot.drive.front, robot.drive.back or robot.drive.front) for robot in robots]
        effects, extended = np.zeros(len(robots), RECORD_DTYPE), np.zeros(len(robots), np.int64)
        for i, robot in enumerate(robots):
            found = record(robot.effects, 0.0) if robot.effects else None
            if found is not None:
                effects[i], extended[i] = found, len(extension(robot.effects) or ())
        share = np.zeros((len(robots), len(tables)))
        if free:
            share[:] = [[back_torque_factor(robot, table.kappa) for table in tables] for robot in robots]
        eta = np.array([[front.eta_d] * 2 + [back.eta_d] * 2 for front, back in drives]).reshape(-1, 4)
        sensors = np.array([sensor_errors(robot) for robot in robots], dtype=float).reshape(-1, 6)
        return cls(robots, np.array(every, dtype=PARAMS_DTYPE), eta, effects, extended, share, sensors)


def level(fleet: Fleet, items: Items) -> Mask:
    """Which items stay on a plane, shape (n,)."""
    from artibot_sim.model.lane_loading import find_level

    found = np.zeros(len(items), bool)
    extended = fleet.extended[items.robot] > 0
    for rows, effects in ((~extended, None), (extended, fleet.effects)):
        if rows.any():
            some = np.zeros(int(rows.sum()), bool)
            find_level(fleet.records, effects, _whole(items.robot[rows]), items.q[rows], items.v[rows], some)
            found[rows] = some
    return found


def lane_work(fleet: Fleet, items: Items, knots: Knots, looks: Looks, ends: Indices) -> Work:
    """All that lanes need; `ends` (n,) are where the items' results end."""
    from artibot_sim.model.window_lanes import Work

    sizes, begin = looks.sizes[items.plan], looks.begin[items.plan]
    return Work(
        fleet.records, fleet.eta, flat(fleet.effects), fleet.sensors, knots.position, knots.velocity, knots.torque,
        knots.modes[items.table], fleet.share[items.robot, items.table], _whole(items.robot),
        knots.begin[items.table] + items.first, _whole(items.knots), _real(items.q), _real(items.v), _real(items.t),
        lagging(items), begin, begin + sizes, looks.t, looks.kind, ends - sizes,
    )  # fmt: skip


def lagging(items: Items) -> Array:
    """Lateral forces that lag, (n, 8), at the starts of all items."""
    return np.zeros((len(items), 8)) if items.lateral is None else _real(items.lateral)


def _whole(values: Indices) -> Indices:
    """A copy that compiled code takes whatever it was."""
    return np.array(values, dtype=np.int64, order="C")


def _real(values: Array) -> Array:
    """The same for numbers."""
    return np.array(values, dtype=np.float64, order="C")
