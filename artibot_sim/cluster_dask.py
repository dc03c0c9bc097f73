"""Tasks on an existing Dask cluster (``pip install 'artibot_sim[cluster]'``)."""

from __future__ import annotations

import asyncio
import concurrent.futures
import importlib
import logging
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from artibot_sim.cluster import AHEAD, identity
from artibot_sim.errors import ArtibotError

Task = TypeVar("Task")
Result = TypeVar("Result")

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
