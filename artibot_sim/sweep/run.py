"""`sweep`: all runs of a plan, into a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from artibot_sim.cluster import cores, map_tasks
from artibot_sim.errors import ArtibotError
from artibot_sim.sweep.chunk import run_chunk
from artibot_sim.sweep.folder import Folder, chunk_size
from artibot_sim.sweep.plan import SweepPlan

FEW = 128
"""Runs that are sooner done in this process than others are started."""

Tell = Callable[[int, int], None]
"""Hears how many runs are finished, and how many of them were before."""


@dataclass(frozen=True)
class Outcome:
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
) -> Outcome:
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
        Hears (finished runs, runs finished before).

    Returns
    -------
    Outcome

    Raises
    ------
    ArtibotError
        Where the folder holds something else, cannot be written, or work could not go on. What is finished is kept.
    """
    tell = progress or (lambda done, before: None)
    if chunk is not None and chunk < 1:
        raise ArtibotError(f"chunk: {chunk}; expected at least 1 run")
    size = chunk or chunk_size(plan.count)
    with Folder(Path(out), plan) as folder:
        before = finished = sum(count for _, count in folder.done())
        tell(finished, before)
        missing = list(folder.missing(size))
        for number, data in _done(plan, missing, workers, scheduler):
            first, count = missing[number]
            folder.add(first, count, data)
            finished += count
            tell(finished, before)
        folder.finish()
        return Outcome(folder.path, folder.table, plan.count, before)


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
