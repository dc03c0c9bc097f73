"""Commands of artibot that begin with everything imported: ``python test/preloaded.py``, a process that forks them.

It reads orders from standard input, a JSON line each: the command's arguments, environment, working folder, and the
file for what it prints. A child goes on from here as ``python -m artibot_sim.cli …`` does, to the end of an interpreter
of its own; it only spares the imports, two thirds of what the start of a node costs. On standard output stand a line
with the number of each child as it begins, and a line with number and status when it has ended.

The threads that LTTng begins where rclpy is imported wait for a tracer, in whatever process; a child has none of them.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import pkgutil
import runpy
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ELSEWHERE = ("demo", "view", "exercise", "resimulate")
"""Parts of the package of nodes that most of them do without."""


class Forked:
    """A process that another one forked, with what `subprocess.Popen` has for its own.

    Parameters
    ----------
    pid : int
        It is the leader of a process group of its own.
    server : Preloaded
        Knows when it ends.
    """

    def __init__(self, pid: int, server: Preloaded) -> None:
        self.pid, self._server = pid, server

    @property
    def returncode(self) -> int | None:
        """Exit status, or minus the number of the signal that ended it; None while it runs."""
        return self._server.ended.get(self.pid)

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        with self._server.changed:
            if not self._server.changed.wait_for(lambda: self.pid in self._server.ended, timeout):
                raise subprocess.TimeoutExpired("artibot", timeout or 0.0)
            return self._server.ended[self.pid]


class Preloaded:
    """The process that forks, and what it says of those that it forked.

    Parameters
    ----------
    environment : mapping
        What is imported is imported with.

    Attributes
    ----------
    ended : dict
        Numbers of processes that are over, and how they ended.
    changed : threading.Condition
        Notified when it says something.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self.ended: dict[int, int] = {}
        self.changed = threading.Condition()
        self._begun: list[int] = []
        self._process = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=dict(environment),
            cwd=ROOT,
            start_new_session=True,
        )
        threading.Thread(target=self._listen, name="preloaded", daemon=True).start()
        atexit.register(self.close)

    def start(self, arguments: list[str], environment: Mapping[str, str], log: Path) -> Forked:
        """Have ``artibot ARGUMENTS…`` run; one at a time is started."""
        order = {"arguments": arguments, "environment": dict(environment), "folder": os.getcwd(), "log": str(log)}
        assert self._process.stdin is not None
        log.write_bytes(b"")  # there is one from the beginning
        with self.changed:
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            self._process.stdin.flush()
            assert self.changed.wait_for(lambda: self._begun or self._process.poll() is not None, 60.0)
            return Forked(self._begun.pop(), self)

    def close(self) -> None:
        """It ends when nobody orders any more."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            pid, *status = map(int, line.split())
            with self.changed:
                if status:
                    self.ended[pid] = status[0]
                else:
                    self._begun.append(pid)
                self.changed.notify_all()


def main() -> None:
    """Import, and serve; in a child, be the command."""
    sys.path[0] = str(ROOT)  # not the tests' folder
    import artibot_sim.nodes

    for module in pkgutil.walk_packages(artibot_sim.nodes.__path__, "artibot_sim.nodes."):
        if not any(part in ELSEWHERE for part in module.name.split(".")):
            importlib.import_module(module.name)
    gc.collect()
    gc.freeze()  # what was imported is nobody's garbage, and its pages stay shared
    order = served()
    if order is not None:
        become(order)


def served() -> dict[str, Any] | None:
    """Fork for each order. In a child: its order; at the end of all: None."""
    over, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake)
    usual = signal.signal(signal.SIGCHLD, lambda *_: None)
    begun = b""
    while True:
        ready, _, _ = select.select([0, over], [], [])
        if over in ready:
            os.read(over, 4096)
            for pid, status in ended():
                print(pid, status, flush=True)
        if 0 in ready:
            read = os.read(0, 1 << 16)
            if not read:
                return None
            *lines, begun = (begun + read).split(b"\n")
            for line in lines:
                pid = os.fork()
                if pid == 0:
                    signal.set_wakeup_fd(-1)
                    signal.signal(signal.SIGCHLD, usual)
                    os.close(over)
                    os.close(wake)
                    return json.loads(line)
                with suppress(OSError):  # done by itself
                    os.setpgid(pid, pid)
                print(pid, flush=True)


def ended() -> Iterator[tuple[int, int]]:
    """Children that have ended, with their status."""
    with suppress(ChildProcessError):
        while (found := os.waitpid(-1, os.WNOHANG))[0]:
            yield found[0], os.waitstatus_to_exitcode(found[1])


def become(order: dict[str, Any]) -> None:
    """Run the command that was ordered, as a program that has just been started."""
    with suppress(OSError):
        os.setpgid(0, 0)
    gc.unfreeze()
    sink = os.open(order["log"], os.O_WRONLY)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for here, there in ((nothing, 0), (sink, 1), (sink, 2)):
        os.dup2(here, there)
    os.close(sink)
    os.close(nothing)
    os.environ.clear()
    os.environ.update(order["environment"])
    os.chdir(order["folder"])
    sys.argv[1:] = order["arguments"]
    runpy.run_module("artibot_sim.cli", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
