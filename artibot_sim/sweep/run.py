"""`sweep`: all runs of a plan, chunk by chunk, into a folder."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from artibot_sim.cluster import cores, map_tasks
from artibot_sim.errors import ArtibotError
from artibot_sim.model import Commands, Robot, Rollout, Status, rollout
from artibot_sim.model.simulate.batch import rollout_batch
from artibot_sim.model.simulate.commands import as_executed
from artibot_sim.planning import FrontKinematics, Plan, PlanSample, manoeuvre_from_dict, plan
from artibot_sim.sweep.axes import Base, Document, Value, manoeuvre_document, robot_with
from artibot_sim.sweep.folder import Folder, chunk_size, table_bytes
from artibot_sim.sweep.measures import PlannedArc, arcs, measure, status_of
from artibot_sim.sweep.plan import KNOTS, SweepPlan, base_of

# ----------------------------------------------------------------------
# The runs of one chunk: what a worker does, wherever it is.
# ----------------------------------------------------------------------


BATCH = 64
"""Runs simulated together; their rows (about 1 MB a run of half a minute) are all that is held in memory."""
_PLANS = 32

Task = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class _Planned:
    """What all runs share that drive the same manoeuvre with the same wheels."""

    plan: Plan
    commands: Commands
    arcs: Sequence[PlannedArc]


@dataclass
class _Run:
    """One run on its way to a row of the table."""

    values: dict[str, Value]
    robot: Robot | None = None
    planned: _Planned | None = None
    commands: Commands | None = None
    status: str = "refused"
    message: str = ""
    measures: dict[str, float] = field(default_factory=dict)

    @property
    def ready(self) -> bool:
        """Whether it can be simulated."""
        return self.commands is not None


def run_chunk(task: Task) -> bytes:
    """Simulate the runs of a chunk.

    Parameters
    ----------
    task : mapping
        ``plan`` (:meth:`SweepPlan.as_task`), ``first`` (number of the first run), ``values`` (lists, by key) and
        ``threads``.

    Returns
    -------
    bytes
        A Parquet table, one row a run in their order: the same whatever runs are together in a chunk.
    """
    chunk = _chunk_of(task["plan"])
    columns = task["values"]
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    runs: list[_Run] = []
    for start in range(0, len(rows), BATCH):
        runs += chunk.runs(rows[start : start + BATCH], task["threads"])
    return table_bytes(
        task["first"], columns, task["plan"]["text"], task["plan"]["measures"],
        [run.measures for run in runs], [run.status for run in runs], [run.message for run in runs],
    )  # fmt: skip


_KNOWN = threading.local()


def _chunk_of(plan: Mapping[str, Any]) -> _Chunk:
    """What this thread had for its last task, where that was of the same plan: reading a robot takes milliseconds."""
    key = json.dumps(plan, sort_keys=True)
    if getattr(_KNOWN, "key", None) != key:
        _KNOWN.key, _KNOWN.chunk = key, _Chunk(plan)
    chunk: _Chunk = _KNOWN.chunk
    return chunk


class _Chunk:
    """Simulates a plan's runs; keeps the plans of manoeuvres that several of them drive."""

    def __init__(self, task: Mapping[str, Any]) -> None:
        self._task = task
        self._base: Base = base_of(task)
        self._plans: dict[tuple[str, str, FrontKinematics], _Planned] = {}
        self._sampled = lru_cache(maxsize=_PLANS)(_sampled)

    def runs(self, rows: Sequence[dict[str, Value]], threads: int) -> list[_Run]:
        """Simulate some runs together."""
        runs = [self._prepared(values) for values in rows]
        ready = [run for run in runs if run.ready]
        results = self._simulate(ready, threads)
        for run, result in zip((run for run in ready if run.ready), results, strict=True):
            run.status = status_of(result)
            if result.status is not Status.OK:
                run.message = result.message
                continue
            assert run.planned is not None
            sample = self._sampled(run.planned.plan, result.t.tobytes())
            run.measures = measure(result, run.planned.plan, sample, run.planned.arcs)
        return runs

    def _prepared(self, values: dict[str, Value]) -> _Run:
        """Robot, plan and commands of a run, or why there are none."""
        run = _Run(values)
        every = {**self._task["fixed"], **values}
        try:
            run.robot = robot_with(self._base.robot, every)
            run.planned = self._plan(*manoeuvre_document(self._base, every), run.robot)
            run.commands = as_executed(run.robot, run.planned.commands)
        except ArtibotError as error:
            run.message = str(error)
        return run

    def _plan(self, name: str, document: Document, robot: Robot) -> _Planned:
        key = (name, json.dumps(document, sort_keys=True), FrontKinematics.of(robot))
        if key not in self._plans:
            if len(self._plans) >= _PLANS:
                self._plans.pop(next(iter(self._plans)))
            made = plan(manoeuvre_from_dict(document, name), robot, dt=KNOTS)
            self._plans[key] = _Planned(made, made.commands(), arcs(made))
        return self._plans[key]

    def _simulate(self, runs: Sequence[_Run], threads: int) -> list[Rollout]:
        """Roll out; a run that is refused gets the reason as its message, and the others go on without it."""
        options = {name: self._task[name] for name in ("dt", "integrator", "energy")}
        for last in (False, True):
            chosen = [run for run in runs if run.ready]
            try:
                return rollout_batch(
                    [run.robot for run in chosen if run.robot], [run.commands for run in chosen if run.commands],
                    workers=threads, keep="rows", every=self._task["every"], **options,
                )  # fmt: skip
            except ArtibotError:
                if last:
                    raise
                _refuse(chosen, options)
        return []


def _refuse(runs: Sequence[_Run], options: Mapping[str, Any]) -> None:
    """Ask each alone, for no time at all, whether it can be simulated."""
    for run in runs:
        assert run.robot is not None and run.commands is not None
        try:
            rollout(run.robot, run.commands, duration=0.0, **options)
        except ArtibotError as error:
            run.commands, run.message = None, str(error)


def _sampled(plan: Plan, times: bytes) -> PlanSample:
    """The plan at a run's times, which most runs share."""
    import numpy as np

    return plan.at(np.frombuffer(times))


# ----------------------------------------------------------------------
# `sweep`: all runs of a plan, into a folder.
# ----------------------------------------------------------------------


FEW = 128
"""Runs that are sooner done in this process than others are started."""

Tell = Callable[[int, int], None]
"""Called with how many runs are finished, and how many of them were before."""


@dataclass(frozen=True)
class SweepOutcome:
    """Where a sweep's results are.

    Attributes
    ----------
    folder, runs : Path
        The folder, and the table in it.
    count, before : int
        Runs of the table, and how many of them were there before.
    """

    folder: Path
    runs: Path
    count: int
    before: int


def sweep(
    plan: SweepPlan,
    out: str | os.PathLike[str],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    chunk: int | None = None,
    progress: Tell | None = None,
) -> SweepOutcome:
    """Simulate all runs of a plan that are not in the folder yet.

    Parameters
    ----------
    plan : SweepPlan
    out : path
        Folder; made where it is not there. One that holds part of this very sweep is gone on with.
    workers : int, optional
        Processes; as many as cores by default. They are started anew and import ``__main__``, so a script that calls
        this needs its ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a Dask scheduler that does it instead (:mod:`artibot_sim.cluster`).
    chunk : int, optional
        Runs that are written at once. No result depends on it, nor on `workers` or `scheduler`.
    progress : callable
        Called with (finished runs, runs finished before).

    Returns
    -------
    Outcome

    Raises
    ------
    ArtibotError
        Where the folder holds something else, cannot be written, or work could not go on. What is finished is kept.
    """
    advance = progress or (lambda done, before: None)
    if chunk is not None and chunk < 1:
        raise ArtibotError(f"chunk: {chunk}; expected at least 1 run")
    size = chunk or chunk_size(plan.count)
    with Folder(Path(out), plan) as folder:
        before = finished = sum(count for _, count in folder.done())
        advance(finished, before)
        missing = list(folder.missing(size))
        for number, data in _done(plan, missing, workers, scheduler):
            first, count = missing[number]
            folder.add(first, count, data)
            finished += count
            advance(finished, before)
        folder.finish()
        return SweepOutcome(folder.path, folder.table, plan.count, before)


def _done(
    plan: SweepPlan, missing: list[tuple[int, int]], workers: int | None, scheduler: str | None
) -> Iterator[tuple[int, bytes]]:
    """Finished chunks with their numbers. A few runs are simulated in this process, by threads."""
    count = cores() if workers is None else workers
    few = scheduler is None and sum(runs for _, runs in missing) <= FEW
    shared = plan.as_task()

    def tasks() -> Iterator[dict[str, Any]]:
        for first, runs in missing:
            columns = plan.columns(first, runs)
            yield {"plan": shared, "first": first, "values": columns, "threads": count if few else 1}

    return map_tasks(run_chunk, tasks(), workers=1 if few else count, scheduler=scheduler)
