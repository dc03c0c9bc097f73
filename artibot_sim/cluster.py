"""Independent tasks on this machine's cores, or on a Dask cluster: the same results wherever they come from."""

from __future__ import annotations

import asyncio
import concurrent.futures
import hashlib
import importlib
import logging
import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from artibot_sim.errors import ArtibotError
from artibot_sim.version import __version__

# ----------------------------------------------------------------------
# Independent tasks on this machine's cores, or on a Dask cluster: the same results wherever they come from.
#
# A task is plain data and a function of a module; what one returns depends on nothing else, so tasks may run
# anywhere, in any order, and again where a worker was lost.
#
# >>> from artibot_sim.cluster import map_tasks
# >>> sorted(map_tasks(abs, [-3, 4], workers=1))
# [(0, 3), (1, 4)]
# ----------------------------------------------------------------------


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
        Address of a Dask scheduler (``tcp://host:8786``): its workers do it. See :mod:`artibot_sim.cluster`.

    Raises
    ------
    ArtibotError
        What a task raised; or one line on a scheduler that does not answer or was lost, on workers of another
        artibot, on a worker process that was killed.
    """
    if scheduler is not None:
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


# ----------------------------------------------------------------------
# Tasks on an existing Dask cluster (``pip install 'artibot_sim[cluster]'``).
# ----------------------------------------------------------------------


CONNECT = 10.0
"""How long a scheduler, and then a first worker, may take to answer, s."""
_LOOK = 2.0
"""s between two looks at how many workers there are."""
_GONE = (concurrent.futures.CancelledError, asyncio.CancelledError)


def on_cluster(function: Callable[[Task], Result], tasks: Iterable[Task], address: str) -> Iterator[tuple[int, Result]]:
    """Do tasks on a cluster and yield (number, result) as they are done.

    A task whose worker is lost is done again by another one. Workers that join later are used.

    Raises
    ------
    ArtibotError
        As :func:`artibot_sim.cluster.map_tasks` says.
    """
    try:
        import distributed  # noqa: F401 - sets its loggers when it is imported first
    except ModuleNotFoundError as error:
        raise ArtibotError(
            "--scheduler needs Dask, which is not installed; pip install 'artibot_sim[cluster]'"
        ) from error
    with _quiet(), _connected(address) as client:
        _check_workers(client, address, _module_of(function))
        yield from _spread(client, function, tasks, address)


@contextmanager
def _quiet() -> Iterator[None]:
    """What goes wrong is said once, by us; Dask gives some of its loggers levels and outputs of their own."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]
    loggers = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in loggers:
            logger.disabled = False


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    from distributed import Client

    try:
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ArtibotError(
            f"--scheduler {address}: no Dask scheduler answers there within {CONNECT:g} s; start one with "
            "'dask scheduler --host 127.0.0.1', or leave --scheduler out to run on this machine"
        ) from error
    try:
        yield client
    finally:
        try:
            client.close(timeout=2.0)
        except (OSError, concurrent.futures.TimeoutError, *_GONE):
            pass  # a scheduler that is gone cannot be told


def _module_of(function: Callable[..., Any]) -> str:
    """Where workers find a function; "" for one that travels by itself."""
    module = str(getattr(function, "func", function).__module__)  # of a partial one: what it is part of
    return "" if module == "__main__" else module


def _check_workers(client: Any, address: str, module: str) -> None:
    """There are workers, all of them run this very artibot, and have the module with the task."""
    try:
        client.wait_for_workers(1, timeout=CONNECT)
    except (concurrent.futures.TimeoutError, asyncio.TimeoutError, TimeoutError) as error:
        raise ArtibotError(
            f"--scheduler {address}: it has no workers; start some with 'dask worker {address}'"
        ) from error
    for worker, there in _asked(client, address, identity):
        if there != identity():
            raise _mismatch(worker, there)
    for worker, why in _asked(client, address, _missing, module):
        if why:
            raise ArtibotError(
                f"worker {worker} cannot import {module} ({why}); put the folder that holds it on the PYTHONPATH of "
                "the workers as well, and restart them"
            )


def _asked(client: Any, address: str, function: Callable[..., Any], *arguments: Any) -> list[tuple[str, Any]]:
    """What every worker says, by its address; an exception where it cannot."""
    try:
        return sorted(client.run(function, *arguments, on_error="return").items())
    except (OSError, *_GONE) as error:
        raise ArtibotError(f"--scheduler {address}: lost while its workers were asked what they are") from error


def _missing(module: str) -> str:
    """In a worker: why a module cannot be imported, "" where it can."""
    try:
        if module:
            importlib.import_module(module)
    except ImportError as error:
        return str(error)
    return ""


def _mismatch(worker: str, there: Any) -> ArtibotError:
    what = f"artibot {there}" if isinstance(there, str) else f"no artibot that can do this ({there})"
    return ArtibotError(
        f"worker {worker} has {what}, this is artibot {identity()}; results might differ: install the same on both "
        "and restart the workers"
    )


def _remote(function: Callable[[Task], Result], here: str, task: Task) -> Result:
    """In a worker: do a task, if it is by the same artibot as the client's; it may have joined after the check."""
    if identity() != here:
        raise ArtibotError(
            f"a worker that joined has artibot {identity()}, the client {here}; install the same on both"
        )
    return function(task)


def _spread(
    client: Any, function: Callable[[Task], Result], tasks: Iterable[Task], address: str
) -> Iterator[tuple[int, Result]]:
    """Keep every worker busy and a task in hand, not more: results are taken as they come."""
    from distributed import KilledWorker, wait
    from distributed import TimeoutError as NotYet

    numbered = enumerate(tasks)
    pending: dict[Any, int] = {}
    finished, room, looked = 0, 0, -_LOOK
    try:
        while True:
            if time.monotonic() - looked > _LOOK:
                looked, room = time.monotonic(), AHEAD * max(sum(client.nthreads().values()), 1)
            for number, task in islice(numbered, max(room - len(pending), 0)):
                pending[client.submit(_remote, function, identity(), task, pure=False)] = number
            if not pending:
                return
            try:
                with client.as_current():
                    done = wait(list(pending), timeout=_LOOK, return_when="FIRST_COMPLETED").done
            except NotYet:
                continue
            for future in done:
                number, result = pending.pop(future), future.result()
                future.release()
                finished += 1
                yield number, result
    except KilledWorker as error:
        raise ArtibotError(
            f"--scheduler {address}: one task ended several workers, perhaps for lack of memory; give them more"
        ) from error
    except (OSError, *_GONE) as error:
        raise ArtibotError(
            f"--scheduler {address}: lost after {finished} tasks, which a sweep or a campaign has kept; start it and "
            "its workers again and repeat the command, or leave --scheduler out"
        ) from error
    finally:
        if client.status == "running":
            client.cancel(list(pending))
