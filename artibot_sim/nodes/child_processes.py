"""Child processes that always end: started together, watched together, stopped in good order."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from artibot_sim.nodes.common.process import asked_to_end

PATIENCE = 10.0
"""How long a child may take to end after SIGINT, s; then it is ended by force."""
POLL = 0.03
_LIBC = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(Exception):
    """A signal asked for the end."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class ChildFailed(Exception):
    """A child ended with an error, or too early, or did not do in time what was waited for."""

    def __init__(self, child: Child, what: str) -> None:
        super().__init__(f"{child.command}: {what}")
        self.child = child


def _nothing() -> None:
    """Do nothing while waiting."""


class Child:
    """An ``artibot`` command in a process group of its own, with its output in a file.

    Parameters
    ----------
    words : sequence of str
        What follows ``artibot``.
    log : Path
        Takes standard output and standard error.
    env : mapping
        The whole environment.
    stays : bool
        Whether it is to run until it is stopped; its end before that is a failure.
    """

    def __init__(self, words: Sequence[str], log: Path, env: Mapping[str, str], stays: bool) -> None:
        self.command = shlex.join(["artibot", *words])
        self.log = log
        self.stays = stays
        self.started = time.monotonic()
        parent = os.getpid()

        def die_with_parent() -> None:
            _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
            if os.getppid() != parent:  # it was killed before the call
                os._exit(1)

        with open(log, "wb") as sink:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "artibot_sim.cli", *words],
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                env=dict(env),
                start_new_session=True,  # Ctrl-C in the terminal is for us: we stop them in order
                preexec_fn=die_with_parent,
            )

    @property
    def output(self) -> str:
        """All that was printed so far."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    @property
    def status(self) -> int | None:
        """Exit status; None while it runs."""
        return self.process.poll()

    def last_lines(self) -> str:
        """Return the last 15 lines of what was printed."""
        return "\n".join(self.output.rstrip().splitlines()[-15:])

    def send(self, number: int) -> None:
        """Send a signal to the child and to whatever it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)


class ChildProcesses:
    """The children of one program.

    Parameters
    ----------
    logs : Path
        Folder for their output.
    env : mapping
        Their environment.
    asked : list of int
        Grows by the number of each signal received (see :func:`noted_signals`).
    """

    def __init__(self, logs: Path, env: Mapping[str, str], asked: list[int]) -> None:
        self.logs = logs
        self.env = env
        self._asked = asked
        self._children: list[Child] = []

    def start(self, *words: str, stays: bool = False) -> Child:
        """Start ``artibot WORDS…``."""
        self._check()
        log = self.logs / f"{len(self._children) + 1}-{words[0]}.log"
        child = Child(words, log, self.env, stays)
        self._children.append(child)
        return child

    def wait(
        self, child: Child, done: Callable[[], bool], timeout: float, what: str, each: Callable[[], None] = _nothing
    ) -> None:
        """Wait until a child that runs has ``done()`` something; call `each` meanwhile.

        Raises
        ------
        Interrupted
            At a signal.
        ChildFailed
            When any child ends with an error or too early, or `child` needs longer than `timeout` (s).
        """
        deadline = time.monotonic() + timeout
        while True:
            self._check()
            ended = child.status is not None  # looked at before: its last words count
            if done():
                return
            if ended:
                raise ChildFailed(child, f"ended before {what}")
            if time.monotonic() > deadline:
                raise ChildFailed(child, f"not {what} within {timeout:g} s")
            each()
            time.sleep(POLL)

    def pause(self, done: Callable[[], bool], timeout: float, each: Callable[[], None] = _nothing) -> None:
        """Wait until ``done()``, at most for `timeout` (s), whatever a child that has ended well would have done.

        Raises
        ------
        Interrupted, ChildFailed
        """
        deadline = time.monotonic() + timeout
        while not done() and time.monotonic() < deadline:
            self._check()
            each()
            time.sleep(POLL)

    def wait_for_end(self, child: Child, timeout: float, each: Callable[[], None] = _nothing) -> None:
        """Wait until a child has ended by itself with status 0; raises as :meth:`wait`."""
        self.wait(child, lambda: child.status is not None, timeout, "finished", each)
        self._check()

    def stop(self, child: Child) -> None:
        """End a child as Ctrl-C does.

        Raises
        ------
        ChildFailed
            When it does not end in time, or not with status 0.
        """
        child.stays = False
        child.send(signal.SIGINT)
        self.wait(child, lambda: child.status is not None, PATIENCE, "ended after Ctrl-C")
        self._check()

    def _check(self) -> None:
        """Raise if there was a signal, or a child has failed."""
        if self._asked:
            raise Interrupted(self._asked[0])
        for child in self._children:
            status = child.status
            if status is not None and (status or child.stays):
                raise ChildFailed(child, f"ended {_reason(status)}")

    def end(self) -> None:
        """End every child that runs, all at once, and wait until they are gone: within `PATIENCE`, or by force."""
        for child in self._children:
            if child.status is None:
                child.send(signal.SIGINT)
        deadline, before = time.monotonic() + PATIENCE, len(self._asked)
        while any(child.status is None for child in self._children):
            if time.monotonic() > deadline or len(self._asked) > before:  # asked again: at once
                break
            time.sleep(POLL)
        for child in self._children:
            if child.status is None:  # else its number may be another's by now
                child.send(signal.SIGKILL)
            child.process.wait()


def _reason(status: int) -> str:
    return f"by {signal.Signals(-status).name}" if status < 0 else f"with status {status}"


@contextlib.contextmanager
def noted_signals() -> Iterator[list[int]]:
    """Take note of SIGINT, SIGTERM and SIGHUP (not under nohup) instead of being thrown out at an arbitrary place."""
    with asked_to_end(
        [n for n in SIGNALS if not (n == signal.SIGHUP and signal.getsignal(n) == signal.SIG_IGN)]
    ) as asked:
        yield asked
