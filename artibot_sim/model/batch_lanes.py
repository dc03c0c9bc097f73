"""Which rollouts of a batch run side by side, and their results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import RECORD_DTYPE, record
from artibot_sim.model.lane_effects import extension, flat
from artibot_sim.model.layout import ROW
from artibot_sim.model.params import PARAMS_DTYPE
from artibot_sim.model.rollout import Rollout, finished
from artibot_sim.model.rollout_checks import Setup, driven_by
from artibot_sim.model.state import State
from artibot_sim.model.transmission import back_torque_factor

Indices = NDArray[np.int64]
_Array = NDArray[np.float64]
_Tables = dict[int, tuple[_Array, _Array, _Array]]


@dataclass(frozen=True)
class Lanes:
    """Up to as many rollouts as a block has lanes, all of one length.

    Attributes
    ----------
    places : sequence of int
        Where they stand in the batch.
    """

    places: Sequence[int]
    setups: Sequence[Setup]
    dt: float
    every: int

    def run(self) -> list[Rollout]:
        """All of them, in order."""
        from artibot_sim.model import rollout_lanes
        from artibot_sim.model.lane_layout import BLOCK, LANES, aligned

        records, effects, extended = _packed(self.setups)
        tables = {id(setup.commands): driven_by(setup.commands) for setup in self.setups}
        lot = self._lot(records, effects, tables)
        steps, knot_steps = self.setups[0].steps, round(self.setups[0].commands.dt / self.dt)
        count = -(-steps // self.every) + 1
        kept, rows = aligned(count * rollout_lanes.KEPT_SIZE * LANES), np.zeros(LANES, np.int64)
        rollout_lanes.run_lot(
            lot, self.dt, steps, self.every, knot_steps, np.array([4, 4]), aligned(BLOCK), kept, rows,
            *(() if extended is None else (extended,)),
        )  # fmt: skip
        return [
            self._result(lane, kept, min(int(rows[lane]), count), count, records, effects, extended, tables)
            for lane in range(len(self.setups))
        ]

    def _lot(self, records: NDArray[Any], effects: NDArray[Any], tables: _Tables) -> Any:
        from artibot_sim.model.rollout_lanes import Lot

        lengths = [len(position) for position, _, _ in tables.values()]
        begin = dict(zip(tables, np.cumsum([0, *lengths]), strict=False))
        first = np.array([begin[id(setup.commands)] for setup in self.setups])
        starts = [setup.start for setup in self.setups]
        q, v, eta, torque, lateral = (
            np.array([getattr(start, name) for start in starts]) for name in ("q", "v", "eta", "torque", "lateral")
        )
        position, velocity, torque_d = (np.concatenate(parts) for parts in zip(*tables.values(), strict=True))
        last = first + np.array([len(setup.commands.velocity) - 1 for setup in self.setups])
        share = np.array([back_torque_factor(setup.robot, setup.kappa) for setup in self.setups])
        modes = np.array([setup.modes for setup in self.setups], np.int64)
        return Lot(
            records, flat(effects), modes, share, q, v, eta, torque, lateral, position, velocity, torque_d, first, last
        )

    def _result(
        self, lane: int, kept: NDArray[np.float64], rows: int, wanted: int, records: NDArray[Any],
        effects: NDArray[Any], extended: tuple[float, ...] | None, driven: _Tables,
    ) -> Rollout:  # fmt: skip
        """One lane's rows with all their columns, and its last state if it got so far."""
        from artibot_sim.model import loop, rollout_lanes

        setup = self.setups[lane]
        tables = np.empty((rows, 16)), np.empty((rows, 16)), np.empty((rows, ROW))
        start = setup.start
        q, v, eta, torque, lateral = (
            array.copy() for array in (start.q, start.v, start.eta, start.torque, start.lateral)
        )
        rollout_lanes.fill_rows(
            records[lane], np.array(setup.modes, np.int64), back_torque_factor(setup.robot, setup.kappa),
            *driven[id(setup.commands)], kept, lane, rows, self.dt, setup.steps, self.every,
            round(setup.commands.dt / self.dt), loop.workspace(), q, v, eta, torque, lateral, *tables,
            *(() if extended is None else (effects[lane],)),
        )  # fmt: skip
        final = State(start.t + setup.steps * self.dt, q, v, eta, torque, lateral) if rows == wanted else None
        return finished(setup, self.dt, "rk4", self.every, rows, (*tables, None), final)


def _packed(setups: Sequence[Setup]) -> tuple[NDArray[Any], NDArray[Any], tuple[float, ...] | None]:
    """Parameters and effects as records, and what of the extended model they need."""
    effects = np.zeros(len(setups), RECORD_DTYPE)
    for i, setup in enumerate(setups):
        found = record(setup.robot.effects, setup.start.t)
        if found is not None:
            effects[i] = found
    return np.array([setup.p for setup in setups], dtype=PARAMS_DTYPE), effects, extension(setups[0].robot.effects)


def in_lanes(setups: Sequence[Setup], dt: float, every: Sequence[int]) -> Iterator[Lanes]:
    """Those that stay on a plane, in lots of equal length and commands' spacing, with or without effects."""
    from artibot_sim.model.lane_layout import LANES
    from artibot_sim.model.lane_loading import find_level

    alike: dict[tuple[Any, ...], list[int]] = {}
    for i, setup in enumerate(setups):
        alike.setdefault(
            (extension(setup.robot.effects), setup.steps, every[i], round(setup.commands.dt / dt)), []
        ).append(i)
    for (extended, steps, rows_every, _), places in alike.items():
        records, effects, _ = _packed([setups[i] for i in places])
        q, v = (np.array([getattr(setups[i].start, name) for i in places]) for name in ("q", "v"))
        flat_enough = np.zeros(len(places), bool)
        find_level(records, None if extended is None else effects, np.arange(len(places)), q, v, flat_enough)
        level = [place for place, fine in zip(places, flat_enough, strict=True) if fine and steps > 0]
        for k in range(0, len(level), LANES):
            chosen = level[k : k + LANES]
            yield Lanes(chosen, [setups[i] for i in chosen], dt, rows_every)
