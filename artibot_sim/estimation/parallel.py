"""Independent fits side by side, one a core: what stands between two simulations then holds up no other core.

A simulation shared among threads leaves the other cores idle while one thread sums up its samples, a tenth to a third
of a fit's time. So where there are several fits to make, each core makes its own; where fewer are left than cores,
their simulations share the cores again. Results do not depend on it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TypeVar

from artibot_sim.cluster import cores, map_tasks

Item = TypeVar("Item")
Result = TypeVar("Result")

_here = threading.local()
"""Of a thread: `until` when it may simulate, and where it does one of several tasks `tasks`, which it belongs to."""


class TimeIsUp(Exception):
    """Ends work that was to be over by now, at its next simulation."""


@contextmanager
def until(instant: float) -> Iterator[None]:
    """Within, simulations that begin after an instant of `time.perf_counter` raise `TimeIsUp`.

    Work on a cluster ends with the task that is done next.
    """
    before = getattr(_here, "until", math.inf)
    _here.until = min(before, instant)
    try:
        yield
    finally:
        _here.until = before


def check_time() -> None:
    """Raise `TimeIsUp` where this work was to be over by now."""
    if time.perf_counter() > getattr(_here, "until", math.inf):
        raise TimeIsUp


class _GivenUp(Exception):
    """Ends a task at its next simulation: another one failed, or the user wants no more."""


class _Tasks:
    """How many cores the simulations of one task may take, as long as so many are not done yet."""

    def __init__(self, count: int, workers: int) -> None:
        self._left, self._workers, self._lock = count, workers, threading.Lock()
        self.until = getattr(_here, "until", math.inf)
        self.over = False

    @property
    def share(self) -> int:
        """Threads of one of them."""
        if self.over:
            raise _GivenUp
        return max(1, self._workers // max(1, self._left))

    def done(self) -> None:
        """One more is over."""
        with self._lock:
            self._left -= 1


def threads(workers: int | None) -> int | None:
    """Threads that a simulation begun here may take, where it is to take `workers` (all cores by default)."""
    check_time()
    tasks = getattr(_here, "tasks", None)
    return workers if tasks is None else tasks.share


def side_by_side(
    do: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int | None = None,
    tick: Callable[[], None] = lambda: None,
    scheduler: str | None = None,
) -> list[Result]:
    """What `do` makes of each item, in their order.

    Parameters
    ----------
    do : callable
        Must not change what others read.
    items : sequence
    workers : int, optional
        Cores; all by default. Tasks within a task are done one after the other.
    tick : callable, optional
        Called with each that is done.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do them instead; `do` and the items must then be picklable.
    """
    done = _done(do, items, workers) if scheduler is None else map_tasks(do, items, scheduler=scheduler)
    found = {}
    for number, result in done:
        found[number] = result
        tick()
        check_time()
    return [found[number] for number in range(len(items))]


def _done(do: Callable[[Item], Result], items: Sequence[Item], workers: int | None) -> Iterator[tuple[int, Result]]:
    """The number and result of each, as they come."""
    count = min(workers or cores(), len(items))
    if count < 2 or getattr(_here, "tasks", None) is not None:
        yield from ((number, do(item)) for number, item in enumerate(items))
        return
    tasks = _Tasks(len(items), workers or cores())

    def within(item: Item) -> Result:
        _here.tasks, _here.until = tasks, tasks.until
        try:
            return do(item)
        finally:
            tasks.done()

    pool = ThreadPoolExecutor(count, "fits")
    try:
        numbers = {pool.submit(within, item): number for number, item in enumerate(items)}
        for future in as_completed(numbers):
            yield numbers[future], future.result()
    finally:
        tasks.over = True
        pool.shutdown(wait=True, cancel_futures=True)
