"""Many rollouts at once: `rollout_batch` runs them on all cores, in threads, side by side in lanes where it can."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import RECORD_DTYPE, has_laws, record
from artibot_sim.model.equations.transmission import Mode, back_torque_factor
from artibot_sim.model.kernels.lane_layout import extension, flat
from artibot_sim.model.kernels.layout import ROW, Grid
from artibot_sim.model.robot.derived import PARAMS_DTYPE
from artibot_sim.model.robot.robot import Robot
from artibot_sim.model.simulate.commands import Commands
from artibot_sim.model.simulate.rollout import Rollout, RolloutSetup, driven_by, finished, prepare, simulate
from artibot_sim.model.simulate.state import State, from_memory

# ----------------------------------------------------------------------
# Which rollouts of a batch run side by side, and their results.
# ----------------------------------------------------------------------


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
    setups: Sequence[RolloutSetup]
    dt: float
    every: int

    def run(self) -> list[Rollout]:
        """All of them, in order."""
        from artibot_sim.model.kernels import lane_rollouts
        from artibot_sim.model.kernels.lane_layout import BLOCK, LANES, aligned

        records, effects, extended = _packed(self.setups)
        tables = {id(setup.commands): driven_by(setup.commands) for setup in self.setups}
        lot = self._lot(records, effects, tables)
        steps = self.setups[0].steps
        grid = Grid(self.dt, steps, self.every, round(self.setups[0].commands.dt / self.dt))
        count = -(-steps // self.every) + 1
        kept, rows = aligned(count * lane_rollouts.KEPT_SIZE * LANES), np.zeros(LANES, np.int64)
        lane_rollouts.run_lot(
            lot, grid, np.array([4, 4]), aligned(BLOCK), kept, rows,
            *(() if extended is None else (extended,)),
        )  # fmt: skip
        return [
            self._result(lane, lot, grid, kept, min(int(rows[lane]), count), effects[lane : lane + 1], extended)
            for lane in range(len(self.setups))
        ]

    def _lot(self, records: NDArray[Any], effects: NDArray[Any], tables: _Tables) -> Any:
        from artibot_sim.model.kernels.lane_rollouts import Lot

        lengths = [len(position) for position, _, _ in tables.values()]
        begin = dict(zip(tables, np.cumsum([0, *lengths]), strict=False))
        first = np.array([begin[id(setup.commands)] for setup in self.setups])
        starts = [setup.start for setup in self.setups]
        q, v, eta, torque, behind, memory = (
            np.array([getattr(start, name) for start in starts])
            for name in ("q", "v", "eta", "torque", "behind", "memory")
        )
        position, velocity, torque_d = (np.concatenate(parts) for parts in zip(*tables.values(), strict=True))
        last = first + np.array([len(setup.commands.velocity) - 1 for setup in self.setups])
        share = np.array([back_torque_factor(setup.robot, setup.kappa) for setup in self.setups])
        modes = np.array([setup.modes for setup in self.setups], np.int64)
        return Lot(
            records, flat(effects), modes, share, q, v, eta, torque, behind, memory, position, velocity, torque_d,
            first, last,
        )  # fmt: skip

    def _result(
        self, lane: int, lot: Any, grid: Any, kept: NDArray[np.float64], rows: int, effects: NDArray[Any],
        extended: tuple[float, ...] | None,
    ) -> Rollout:  # fmt: skip
        """One lane's rows with all their columns, and its last state if it got so far."""
        from artibot_sim.model.kernels import lane_rollouts, loop

        setup, wanted = self.setups[lane], -(-grid.steps // grid.every) + 1
        tables = np.empty((rows, 16)), np.empty((rows, 16)), np.empty((rows, ROW))
        lane_rollouts.fill_rows(
            lot, lane, grid, kept, rows, loop.workspace(), tables, *(() if extended is None else (effects[0],))
        )
        ends = lot.q[lane], lot.v[lane], lot.eta[lane], lot.torque[lane], *from_memory(lot.memory[lane])
        final = State(setup.start.t + grid.steps * self.dt, *ends, lot.behind[lane]) if rows == wanted else None
        return finished(setup, self.dt, "rk4", self.every, rows, (*tables, None), final)


def _packed(setups: Sequence[RolloutSetup]) -> tuple[NDArray[Any], NDArray[Any], tuple[float, ...] | None]:
    """Parameters and effects as records, and what of the extended model they need."""
    effects = np.zeros(len(setups), RECORD_DTYPE)
    for i, setup in enumerate(setups):
        found = record(setup.robot.effects, setup.start.t)
        if found is not None:
            effects[i] = found
    return np.array([setup.p for setup in setups], dtype=PARAMS_DTYPE), effects, extension(setups[0].robot.effects)


def in_lanes(setups: Sequence[RolloutSetup], dt: float, every: Sequence[int]) -> Iterator[Lanes]:
    """Those that stay on a plane and know no laws, in lots of equal length and commands' spacing."""
    from artibot_sim.model.kernels.lane_layout import LANES
    from artibot_sim.model.kernels.lane_loading import find_level

    alike: dict[tuple[Any, ...], list[int]] = {}
    for i, setup in enumerate(setups):
        if setup.robot.trailing or has_laws(setup.robot.effects):
            continue
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


# ----------------------------------------------------------------------
# Many rollouts at once: `rollout_batch` runs them on all cores, in threads.
#
# The compiled loops run without the interpreter's lock, so threads are enough: nothing is copied between processes,
# and no result depends on how many there are.
# ----------------------------------------------------------------------


KEEP = ("final", "rows")


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class _Single:
    """A rollout that runs alone."""

    places: tuple[int]
    setup: RolloutSetup
    options: tuple[float, str, int, bool]

    def run(self) -> list[Rollout]:
        return [simulate(self.setup, *self.options)]


def rollout_batch(
    robots: Robot | Sequence[Robot],
    commands: Commands | Sequence[Commands],
    *,
    workers: int | None = None,
    keep: str = "final",
    every: int = 10,
    dt: float = 1e-3,
    integrator: str = "rk4",
    modes: Mode | Sequence[Mode] | None = None,
    kappa: float | None = None,
    state: State | Sequence[State] | None = None,
    duration: float | None = None,
    energy: bool = False,
    progress: Callable[[int], None] | None = None,
) -> list[Rollout]:
    """Simulate many rovers, each as `rollout` does.

    With RK4 those that stay on a plane and know no laws run side by side in the processor's vector units (`lanes`), and
    equal single rollouts to rounding (1e-9 in the test suite); the others, and all where energies are asked for, to the
    bit.
    Results do not depend on the number of `workers`, nor on what else is in the batch.

    Parameters
    ----------
    robots : Robot or sequence of Robot
    commands : Commands or sequence of Commands
        One for all, or as many as robots; one robot may have many commands.
    workers : int, optional
        Threads; by default as many as there are cores for this process.
    keep : {"final", "rows"}
        "final" keeps the first row and the last of each rollout (as ``every`` = its number of steps would), which
        takes a few kB; "rows" keeps each `every`-th, which takes about 1.2 kB a row.
    every, dt, integrator, modes, kappa, duration, energy
        As for `rollout`, the same for all.
    state : State or sequence of State, optional
        Where to start: one for all, or one each.
    progress : callable, optional
        Called with the number of finished rollouts after each, from the thread that finished it.

    Returns
    -------
    list of Rollout
        In the order of `robots` (or of `commands`). A rollout that diverges has that as its status; the others go on.

    Raises
    ------
    ArtibotError
        When something is refused, with the number of the rollout it belongs to, the lowest one of those refused.
    """
    if keep not in KEEP:
        raise ArtibotError(f"keep: '{keep}'; expected one of {', '.join(KEEP)}")
    if workers is not None and workers < 1:
        raise ArtibotError(f"workers: {workers}; expected at least 1, or None for all cores")
    lists = {
        "robots": _listed("robots", robots, Robot),
        "commands": _listed("commands", commands, Commands),
        "state": _listed("state", state, (State, type(None))),
    }
    count = _count(lists)
    columns = {name: items * count if len(items) == 1 else items for name, items in lists.items()}
    setups = []
    for i, (robot, command, start) in enumerate(
        zip(columns["robots"], columns["commands"], columns["state"], strict=True)
    ):
        try:
            setups.append(prepare(robot, command, dt, integrator, every, modes, kappa, start, duration))
        except ArtibotError as error:
            raise ArtibotError(f"rollout {i}: {error}") from error
    each = [every if keep == "rows" else max(setup.steps, 1) for setup in setups]
    together = list(in_lanes(setups, dt, each)) if integrator == "rk4" and not energy else []
    done = {place for lanes in together for place in lanes.places}
    alone = [_Single((i,), setup, (dt, integrator, each[i], energy)) for i, setup in enumerate(setups) if i not in done]
    jobs: list[Lanes | _Single] = [*together, *alone]
    return _run(jobs, len(setups), min(workers or available_cores(), max(len(jobs), 1)), progress)


def _listed(name: str, items: Any, kind: Any) -> list[Any]:
    """`items` as a list: one thing is a list of one."""
    listed = [items] if isinstance(items, kind) else list(items)
    for i, item in enumerate(listed):
        if not isinstance(item, kind):
            wanted = "Robot" if name == "robots" else name.capitalize()
            raise ArtibotError(f"{name}[{i}]: {type(item).__name__}; expected a {wanted}")
    return listed


def _count(lists: dict[str, list[Any]]) -> int:
    """How many rollouts there are: lists of one go with all, others must agree."""
    lengths = {name: len(items) for name, items in lists.items() if len(items) != 1}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"{length} {name}" for name, length in lengths.items())
        raise ArtibotError(f"rollout_batch: {said}; expected equal numbers, or one for all")
    return next(iter(lengths.values()), 1)


def _run(
    jobs: Sequence[Lanes | _Single], count: int, workers: int, progress: Callable[[int], None] | None
) -> list[Rollout]:
    """All jobs; each worker takes the next one that nobody has, so none waits for another's slow rollout."""
    results: dict[int, Rollout] = {}
    numbers = itertools.count()
    lock, stop = threading.Lock(), threading.Event()

    def work() -> None:
        while not stop.is_set():
            with lock:
                i = next(numbers)
            if i >= len(jobs):
                return
            found = jobs[i].run()
            with lock:
                for place, result in zip(jobs[i].places, found, strict=True):
                    results[place] = result
                    if progress is not None:
                        progress(len(results))

    if workers == 1:
        work()
    elif jobs:
        _in_threads(work, workers, stop)
    return [results[i] for i in range(count)]


def _in_threads(work: Callable[[], None], workers: int, stop: threading.Event) -> None:
    """Run `work` in so many threads until all return; an exception in any, or Ctrl-C, ends the others early."""
    with ThreadPoolExecutor(workers, thread_name_prefix="rollout") as pool:
        futures = [pool.submit(work) for _ in range(workers)]
        try:
            for future in futures:
                future.result()
        finally:
            stop.set()
