"""Independent tasks on this machine's cores, or on a Dask cluster: the same results wherever they come from.

A task is plain data and a function of a module; what one returns depends on nothing else, so tasks may run anywhere,
in any order, and again where a worker was lost.

>>> from artibot_sim.cluster import map_tasks
>>> sorted(map_tasks(abs, [-3, 4], workers=1))
[(0, 3), (1, 4)]
"""

from __future__ import annotations

import concurrent.futures
import hashlib
import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from artibot_sim.errors import ArtibotError
from artibot_sim.version import __version__

Task = TypeVar("Task")
Result = TypeVar("Result")

AHEAD = 2
"""Tasks handed out for every worker: the one it does, and the next."""
_ADDRESS = re.compile(r"(tcp|tls|ucx|ws|wss)://[^/\s:]+:\d+/?|(tcp|tls)://\[[0-9a-fA-F:]+\]:\d+/?")


def map_tasks(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[tuple[int, Result]]:
    """Do tasks and yield (number, result) as they are done, in no certain order.

    Parameters
    ----------
    function : callable
        Found by its module and name in other processes; must not depend on what ran before.
    tasks : iterable
        Taken one after the other, not far ahead of the work.
    workers : int, optional
        Processes on this machine; 1 does all in this one. As many as cores by default.
    scheduler : str, optional
        Address of a Dask scheduler (``tcp://host:8786``): its workers do it. See :mod:`artibot_sim.cluster_dask`.

    Raises
    ------
    ArtibotError
        What a task raised; or one line on a scheduler that does not answer or was lost, on workers of another
        artibot, on a worker process that was killed.
    """
    if scheduler is not None:
        from artibot_sim.cluster_dask import on_cluster

        return on_cluster(function, tasks, check_address(scheduler))
    count = cores() if workers is None else workers
    if count < 1:
        raise ArtibotError(f"workers: {count}; expected at least 1")
    return _here(function, tasks) if count == 1 else _in_processes(function, tasks, count)


def check_address(scheduler: str) -> str:
    """The address, if it looks like one (ArtibotError otherwise)."""
    if not _ADDRESS.fullmatch(scheduler):
        raise ArtibotError(f"--scheduler {scheduler}: expected an address such as tcp://127.0.0.1:8786")
    return scheduler


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@lru_cache(maxsize=1)
def identity() -> str:
    """Version of this artibot with a hash of its sources: equal where results are made by the same code."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parent
    for source in sorted(root.rglob("*.py")):
        digest.update(str(source.relative_to(root)).encode())
        digest.update(source.read_bytes())
    return f"{__version__} ({digest.hexdigest()[:12]})"


def _here(function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[tuple[int, Result]]:
    for number, task in enumerate(tasks):
        yield number, function(task)


def _in_processes(
    function: Callable[[Task], Result], tasks: Iterable[Task], count: int
) -> Iterator[tuple[int, Result]]:
    """In processes that end when this one does, however it does."""
    context = multiprocessing.get_context("spawn")  # a fork would copy threads' locks
    theirs, ours = context.Pipe(duplex=False)
    pool = concurrent.futures.ProcessPoolExecutor(count, context, _follow_parent, (theirs,))
    numbered = enumerate(tasks)
    pending: dict[concurrent.futures.Future[Result], int] = {}
    try:
        while True:
            for number, task in islice(numbered, AHEAD * count - len(pending)):
                pending[pool.submit(function, task)] = number
            if not pending:
                pool.shutdown()
                return
            done, _ = concurrent.futures.wait(pending, return_when="FIRST_COMPLETED")
            for future in done:
                yield pending.pop(future), future.result()
    except BrokenProcessPool as error:
        raise ArtibotError(
            "a worker process was killed, perhaps for lack of memory; free some, or take fewer by --workers, "
            "and start again"
        ) from error
    finally:
        ours.close()  # ends workers in the middle of a task
        pool.shutdown(wait=False, cancel_futures=True)


def _follow_parent(parent: Any) -> None:
    """In a worker: leave Ctrl-C to the parent, and end when it closes its end of the pipe, or is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        try:
            parent.recv()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
