"""Many rollouts at once: `rollout_batch` runs them on all cores, in threads.

The compiled loops run without the interpreter's lock, so threads are enough: nothing is copied between processes,
and no result depends on how many there are.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.model.commands import Commands
from artibot_sim.model.robot import Robot
from artibot_sim.model.rollout import Rollout, rollout
from artibot_sim.model.state import State
from artibot_sim.model.transmission import Mode

KEEP = ("final", "rows")


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class _Job:
    """What one rollout of a batch is given."""

    name: str
    robot: Robot
    commands: Commands
    options: dict[str, Any]

    def run(self) -> Rollout:
        try:
            return rollout(self.robot, self.commands, **self.options)
        except ArtibotError as error:
            raise ArtibotError(f"{self.name}: {error}") from error


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
    """Simulate many rovers, each exactly as `rollout` does, bit for bit, whatever the number of `workers`.

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
    shared = {"dt": dt, "integrator": integrator, "modes": modes, "kappa": kappa, "duration": duration}
    shared |= {"energy": energy}
    lists = {
        "robots": _listed("robots", robots, Robot),
        "commands": _listed("commands", commands, Commands),
        "state": _listed("state", state, (State, type(None))),
    }
    count = _count(lists)
    columns = {name: items * count if len(items) == 1 else items for name, items in lists.items()}
    jobs = []
    for i, (robot, command, start) in enumerate(
        zip(columns["robots"], columns["commands"], columns["state"], strict=True)
    ):
        rows_every = every if keep == "rows" else _steps(command, duration, dt)
        jobs.append(_Job(f"rollout {i}", robot, command, {**shared, "state": start, "every": rows_every}))
    return _run(jobs, min(workers or available_cores(), max(count, 1)), progress)


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


def _steps(commands: Commands, duration: float | None, dt: float) -> int:
    """The last row's distance from the first; wrong durations and steps are `rollout`'s to refuse."""
    length = commands.duration if duration is None else duration
    ratio = length / dt if dt else 0.0
    return max(round(ratio), 1) if 0.0 <= ratio < 1e15 else 1


def _run(jobs: Sequence[_Job], workers: int, progress: Callable[[int], None] | None) -> list[Rollout]:
    """All jobs; each worker takes the next one that nobody has, so none waits for another's slow rollout."""
    results: dict[int, Rollout] = {}
    failed: dict[int, ArtibotError] = {}
    numbers = itertools.count()
    lock, stop = threading.Lock(), threading.Event()

    def work() -> None:
        while not stop.is_set():
            with lock:
                i = next(numbers)
            if i >= len(jobs):
                return
            try:
                result = jobs[i].run()
            except ArtibotError as error:
                with lock:
                    failed[i] = error
                stop.set()  # lower numbers are already under way, so the lowest failure is always found
                return
            with lock:
                results[i] = result
                if progress is not None:
                    progress(len(results))

    if workers == 1:
        work()
    elif jobs:
        _in_threads(work, workers, stop)
    if failed:
        raise failed[min(failed)]
    return [results[i] for i in range(len(jobs))]


def _in_threads(work: Callable[[], None], workers: int, stop: threading.Event) -> None:
    """Run `work` in so many threads until all return; an exception in any, or Ctrl-C, ends the others early."""
    with ThreadPoolExecutor(workers, thread_name_prefix="rollout") as pool:
        futures = [pool.submit(work) for _ in range(workers)]
        try:
            for future in futures:
                future.result()
        finally:
            stop.set()
