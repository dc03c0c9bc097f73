"""What tests of ROS nodes share: a domain of their own, and processes that always end.

The fixtures that hand these out are in ``conftest.py``: ``ros_domain``, ``start_node`` and ``ros_context``.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest
from preloaded import Forked, Preloaded

from artibot_sim.resources import local_environment

if TYPE_CHECKING:
    from rclpy.context import Context
    from rclpy.node import Node

ROOT = Path(__file__).resolve().parents[1]
"""The checkout."""

DOMAINS = range(1, 102)
"""Domain ids whose ports lie below Linux's ephemeral range; 0 is left to whatever else runs on the machine."""


def in_ci() -> bool:
    """Whether ``CI`` is set to anything but a way of saying no."""
    return os.environ.get("CI", "").lower() not in ("", "0", "false", "no")


def skip(reason: str) -> NoReturn:
    """Skip the test with `reason` on a laptop; in CI, where nothing may be missing, fail it."""
    if in_ci():
        pytest.fail(f"in CI nothing may be skipped: {reason}", pytrace=False)
    pytest.skip(reason)


@contextlib.contextmanager
def reserved_domain(seed: str) -> Iterator[int]:
    """Hold a ROS domain id that no other test of artibot on this machine holds.

    Parameters
    ----------
    seed : str
        Where to begin the search (the test's name): runs side by side rarely try the same id first.
    """
    start = int.from_bytes(hashlib.sha256(f"{os.getpid()} {seed}".encode()).digest()[:4], "big")
    for k in range(len(DOMAINS)):
        domain = DOMAINS[(start + k) % len(DOMAINS)]
        path = Path(tempfile.gettempdir()) / f"artibot-{os.getuid()}-ros-domain-{domain}.lock"
        with open(path, "w", encoding="ascii") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain
            return
    raise RuntimeError(f"all {len(DOMAINS)} ROS domains are in use by other tests")


def ros_environment(domain: int, log_dir: Path) -> dict[str, str]:
    """Variables that keep a ROS process to its own domain, this machine and `log_dir`."""
    return {
        **local_environment(),
        "ROS_DOMAIN_ID": str(domain),
        "ROS_LOG_DIR": str(log_dir),
        "PYTHONUNBUFFERED": "1",
    }


def started(command: list[str], environment: dict[str, str], log: Path) -> subprocess.Popen[bytes]:
    """A new process."""
    with open(log, "wb") as sink:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=sink,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,  # so that its children end with it, and nothing else does
        )


Begin = Callable[[list[str], dict[str, str], Path], "subprocess.Popen[bytes] | Forked"]

PRELOADED = ("sim", "planner", "driver", "record", "replay")
"""Words that many tests start."""
AT_RUN_TIME = ("ROS_DOMAIN_ID", "ROS_LOG_DIR")
"""Of the environment, what is not read before a node begins: all else is looked at while modules are imported, too."""
_servers: dict[frozenset[tuple[str, str]], Preloaded] = {}
_begun: set[tuple[str, frozenset[tuple[str, str]]]] = set()


def forked(command: list[str], environment: dict[str, str], log: Path) -> subprocess.Popen[bytes] | Forked:
    """``artibot WORD …`` without the time for its imports; the first of a word in an environment is a new process.

    A machine that is emulated has no memory for a process that only waits.
    """
    words = command[command.index("artibot_sim.cli") + 1 :]
    setting = frozenset((key, value) for key, value in environment.items() if key not in AT_RUN_TIME)
    if "IN_UML" in os.environ or words[0] not in PRELOADED or (words[0], setting) not in _begun:
        _begun.add((words[0], setting))
        return started(command, environment, log)
    if setting not in _servers:
        _servers[setting] = Preloaded(dict(setting))
    return _servers[setting].start(words, environment, log)


class NodeProcess:
    """A command in a process group of its own, with its output kept in a file.

    Parameters
    ----------
    command : list of str
        Program and arguments.
    log : path
        File that takes standard output and standard error together.
    env : mapping, optional
        Added to this process's environment.
    begin : callable
        What starts it with its environment and log.
    """

    def __init__(
        self, command: list[str], log: Path, env: Mapping[str, str] | None = None, begin: Begin | None = None
    ) -> None:
        self.command = command
        self.log = log
        environment = {**os.environ, **(env or {})}
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), environment.get("PYTHONPATH")]))
        environment.pop("PYTEST_CURRENT_TEST", None)
        self.process = (begin or started)(command, environment, log)

    @property
    def pid(self) -> int:
        """Process id, and id of the process group."""
        return self.process.pid

    @property
    def running(self) -> bool:
        """Whether the process has not ended."""
        return self.process.poll() is None

    @property
    def output(self) -> str:
        """All that was printed so far."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def wait_for(self, text: str, timeout: float = 30.0) -> str:
        """Wait until `text` was printed; return the output. Fails when the process ends first or time is up."""
        deadline = time.monotonic() + timeout
        while text not in self.output:
            if not self.running and text not in self.output:
                pytest.fail(f"{self} ended with status {self.process.returncode} before '{text}':\n{self.output}")
            if time.monotonic() > deadline:
                pytest.fail(f"{self} did not print '{text}' within {timeout} s:\n{self.output}")
            time.sleep(0.02)
        return self.output

    def wait(self, timeout: float = 60.0) -> int:
        """Wait for the end; return the exit status. Fails when it is still running after `timeout` seconds."""
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self} was still running after {timeout} s:\n{self.output}")

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def stop(self, timeout: float = 10.0) -> int:
        """End it as Ctrl-C does, and after `timeout` seconds by SIGKILL; return the exit status."""
        if self.running:
            self.send(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout)
        self.send(signal.SIGKILL)  # what is left of the group: the process itself, or children it forgot
        return self.process.wait()

    def __str__(self) -> str:
        return " ".join(self.command)


class NodeStarter:
    """Starts ``artibot`` commands for one test; ``end`` ends all of them."""

    def __init__(self, folder: Path, env: Mapping[str, str]) -> None:
        self.folder = folder
        self.env = dict(env)
        self.nodes: list[NodeProcess] = []

    def __call__(self, word: str, *args: object, env: Mapping[str, str] | None = None) -> NodeProcess:
        """Start ``artibot WORD ARGS…``, as ``start_node("sim", "--robot", "agriq", "--ros-args", "-p", "rate:=0")``."""
        return self.run([sys.executable, "-m", "artibot_sim.cli", word, *map(str, args)], word, env, forked)

    def run(
        self, command: list[str], name: str = "process", env: Mapping[str, str] | None = None, begin: Begin = started
    ) -> NodeProcess:
        """Start any program under the same care."""
        log = self.folder / f"{len(self.nodes):02d}-{name}.log"
        node = NodeProcess(command, log, {**self.env, **(env or {})}, begin)
        self.nodes.append(node)
        return node

    def end(self) -> None:
        """End what runs, last started first, and print what each said (pytest shows it when the test failed)."""
        for node in reversed(self.nodes):
            status = node.stop()
            print(f"--- {node} (status {status})\n{node.output}")


def spin_until(node: Node, done: Callable[[], bool], timeout: float = 30.0, what: str = "the condition") -> None:
    """Spin `node` until ``done()``; the test fails after `timeout` seconds.

    The node must belong to the ``ros_context`` fixture.
    """
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    deadline = time.monotonic() + timeout
    try:
        while not done():
            if time.monotonic() > deadline:
                pytest.fail(f"{what} was not met within {timeout} s")
            executor.spin_once(timeout_sec=0.05)
    finally:
        executor.remove_node(node)
        executor.shutdown()


@contextlib.contextmanager
def rclpy_context(domain: int) -> Iterator[Context]:
    """An rclpy context of its own in `domain`, shut down at the end, and all its nodes destroyed.

    A node that a failed test's traceback or a cycle keeps would go on being seen in a domain that is another test's by
    then.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node

    context, nodes, begin = Context(), [], Node.__init__

    def begun(self: Node, *args: object, **named: object) -> None:
        begin(self, *args, **named)
        nodes.append(self)

    rclpy.init(context=context, domain_id=domain)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Node, "__init__", begun)
            yield context
    finally:
        for node in nodes:
            if node.context is context:
                node.destroy_node()
        rclpy.try_shutdown(context=context)


@contextlib.contextmanager
def ros_processes(name: str, folder: Path) -> Iterator[tuple[NodeStarter, Context]]:
    """What the fixtures `start_node` and `ros_context` give, for several tests together that `name` stands for."""
    with reserved_domain(name) as domain, pytest.MonkeyPatch.context() as patch:
        environment = ros_environment(domain, folder / "ros_log")
        for key, value in environment.items():
            patch.setenv(key, value)
        starter = NodeStarter(folder, environment)
        try:
            with rclpy_context(domain) as context:
                yield starter, context
        finally:
            starter.end()
