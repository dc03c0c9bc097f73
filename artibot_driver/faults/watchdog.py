"""Watches whether this machine gives its processes the time they ask for: ``… faults.watchdog PID PRIORITY``.

It has nothing to do with what a trial tries: a process of its own, with a thread on every processor that only sleeps
and sees how late it wakes, and one that reads how long the threads of process PID and its children waited for a
processor, as far as the kernel tells. A trial in which either was long is the machine's and not the driver's.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from artibot_driver.priority import drop_priority, take_priority
from artibot_sim.errors import ArtibotError

HELD_UP: Final = 0.02
"""A trial is void where something had to wait for so long, s: less than what its bounds leave beyond the time-outs."""

PRIORITY: Final = 45
"""Of trials among the machine's real-time threads, where the system grants it. With a single processor none: the
kernel's own thread that hands frames over would starve."""

WATCHING: Final = 99
"""Of the watchdog: a processor that is busy with somebody else is no stall while the trial has another."""

_SLEEP: Final = 0.005
_READ_EVERY: Final = 0.01
_LIST_EVERY: Final = 0.25
_PROC: Final = Path("/proc")


class Stall(NamedTuple):
    """The longest wait: how long, s, and whose."""

    seconds: float
    whose: str


class Watchdog:
    """The process, and what it has seen; a context manager.

    Parameters
    ----------
    priority : int
        Among the machine's real-time ones; 0: none.

    Attributes
    ----------
    process : Popen
    """

    def __init__(self, priority: int) -> None:
        command = [sys.executable, "-m", "artibot_driver.faults.watchdog", str(os.getpid()), str(priority)]
        pipe = subprocess.PIPE
        path = os.pathsep.join(filter(None, sys.path))
        self.process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, text=True, env=os.environ | {"PYTHONPATH": path}
        )
        self.longest()

    def __enter__(self) -> Watchdog:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()  # closes its standard input, which ends it

    def longest(self) -> Stall:
        """The longest wait since this was asked last.

        Raises
        ------
        ArtibotError
            When the process is gone.
        """
        assert self.process.stdin is not None and self.process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write("\n")
            self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise ArtibotError(f"the watchdog ended with status {self.process.wait()}; nothing can be judged without")
        return Stall(*json.loads(line))


@contextlib.contextmanager
def attended() -> Iterator[Watchdog]:
    """A watchdog, and this thread preferred to ordinary ones meanwhile, where the system allows it."""
    priority = PRIORITY if (os.cpu_count() or 1) > 1 else 0
    with Watchdog(WATCHING if priority else 0) as watchdog:
        take_priority(priority)
        try:
            yield watchdog
        finally:
            if priority:
                drop_priority()


class Stalls:
    """What the threads of the watching process have seen since they were asked."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._longest = Stall(0.0, "")
        self._awake: dict[str, float] = {}

    def note(self, seconds: float, whose: str) -> None:
        """Somebody had to wait."""
        with self._lock:
            self._longest = max(self._longest, Stall(seconds, whose))

    def sleep(self, whose: str) -> None:
        """Sleep for so long, and note by how much it became longer."""
        begin = self._awake[whose] = time.monotonic()
        time.sleep(_SLEEP)
        self.note(time.monotonic() - begin - _SLEEP, whose)

    def take(self) -> Stall:
        """The longest so far, which is forgotten; a sleep that is too long already counts."""
        now = time.monotonic()
        for whose, since in self._awake.items():
            self.note(now - since - _SLEEP, whose)
        with self._lock:
            found, self._longest = self._longest, Stall(0.0, "")
        return found


def _sleep_on(core: int, stalls: Stalls) -> None:
    os.sched_setaffinity(0, {core})
    while True:
        stalls.sleep(f"processor {core}")


def _read_queues(pid: int, stalls: Stalls) -> None:
    """Note how much longer every thread of `pid` and its children has waited for a processor than at the last look."""
    waited: dict[Path, int] = {}
    files: tuple[Path, ...] = ()
    listed = -_LIST_EVERY
    while True:
        now = time.monotonic()
        if now - listed > _LIST_EVERY:
            files, listed = tuple(_threads(pid)), now
        seen = {}
        for file in files:
            with contextlib.suppress(OSError, ValueError, IndexError):
                seen[file] = int(file.read_text(encoding="ascii").split()[1])
                stalls.note(1e-9 * (seen[file] - waited.get(file, seen[file])), f"thread {file.parent.name}")
        waited = seen
        time.sleep(_READ_EVERY)


def _threads(pid: int) -> Iterator[Path]:
    """Files that tell how long the threads of a process and of its children have run and waited."""
    with contextlib.suppress(OSError):
        for task in (_PROC / str(pid) / "task").iterdir():
            yield task / "schedstat"
            for child in (task / "children").read_text(encoding="ascii").split():
                if int(child) != os.getpid():
                    yield from _threads(int(child))


def main(argv: Sequence[str] | None = None) -> int:
    """Watch until standard input ends; each line of it is answered by the longest wait since the one before."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever is watched
    words = sys.argv[1:] if argv is None else argv
    stalls = Stalls()
    take_priority(int(words[1]))
    cores = sorted(os.sched_getaffinity(0))
    for core in cores:
        threading.Thread(target=_sleep_on, args=(core, stalls), daemon=True).start()
    if len(cores) > 1:  # on a single one they wait for each other: that is no stall, but how fast the machine is
        threading.Thread(target=_read_queues, args=(int(words[0]), stalls), daemon=True).start()
    for _ in sys.stdin:
        print(json.dumps(stalls.take()), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
