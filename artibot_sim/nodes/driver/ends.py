"""How driver processes end: ``python -m artibot_sim.nodes.driver.ends COUNT``, so many times in each situation.

Nodes nearby come and go meanwhile, some of them killed, and call the driver's services: an end then meets what makes
the middleware's threads go on in memory that is being given back. ``--checkout FOLDER`` ends drivers of another state
of the code, ``--heap-checks`` lets glibc check and overwrite what is freed (its libc_malloc_debug.so.0), ``--memcheck``
runs drivers under valgrind, a minute and more each, ``--shared`` lets drivers speak over shared memory too, beside
killed nodes. Prints a line of JSON for each situation: ends by exit status or signal. Of those by a signal that was not
sent, or with a status out of order, it has what was said last, and the innermost functions of the thread that met the
signal, where there are core files and gdb.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from artibot_driver.loopback import channel_of, loopback_bus, start_server
from artibot_sim.resources import local_environment

PATIENCE = 300.0
"""A driver that has not ended so long after it should is counted as one that hangs, s."""

NEIGHBOUR = 15
"""A neighbour that has not ended after so long is ended, s."""

STARTUP = 2.5
"""A signal during set-up comes once the process has used so much of a processor's time at most, s."""

SETTLED = 0.6
"""A signal after something has happened comes within so long, s."""

FRAMES = 12
"""Innermost functions that are shown."""

HEAP_CHECKS = {"LD_PRELOAD": "libc_malloc_debug.so.0", "MALLOC_CHECK_": "3", "MALLOC_PERTURB_": "165"}
"""What makes glibc check the heap at each call, and overwrite what is freed."""

FOUND = 99
"""Exit status of a driver in which memcheck found something."""

MEMCHECK = (
    "valgrind", "--trace-children=yes", "--undef-value-errors=no", "--fair-sched=yes", "--num-callers=30",
    f"--error-exitcode={FOUND}",
)  # fmt: skip
"""The wheels of rclpy execute the interpreter anew, which is a child to valgrind."""

SLOWNESS = 30
"""How much longer a driver takes to start under memcheck."""

LOADER = """{
  the loader compares words of 8 bytes
  Memcheck:Addr8
  fun:strncmp
  fun:is_dst
  ...
}
"""
"""What memcheck is wrong about."""

SHARED = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
"""With it a driver uses shared memory, too."""

IN_ORDER = (0, 2, 130)
"""Statuses with which a driver ends: asked to, because it refuses something, or interrupted before it takes signals."""

SAID = 30
"""Lines that are shown of what was said before an end that was not in order."""

BY_US = (signal.SIGINT, signal.SIGTERM)
"""Signals that are sent; one that comes before Python has a handler ends the process as the system does."""


# ----------------------------------------------------------------------
# Neighbours: participants that come and go beside a driver, and call its services.
# ----------------------------------------------------------------------


def neighbours(namespaces: Sequence[str], seed: int) -> None:
    """Begin participants one after the other, two at a time, until the standard input ends; a third of them is killed.

    Each is a process that has imported rclpy by being forked, so that it is there at once.
    """
    import rclpy  # noqa: F401  (for the children)
    from sensor_msgs.msg import JointState  # noqa: F401
    from std_srvs.srv import Trigger  # noqa: F401

    over: list[bool] = []
    threading.Thread(target=lambda: over.append(bool(sys.stdin.read()) or True), daemon=True).start()
    chance, running = random.Random(seed), 0
    while True:
        while running < 2 and not over:
            life, killed = chance.uniform(0.2, 2.0), chance.random() < 1 / 3
            if not os.fork():
                _be_neighbour(chance.choice(namespaces), life, killed)
            running += 1
        if not running:
            return
        os.wait()
        running -= 1


def _be_neighbour(namespace: str, life: float, killed: bool) -> None:
    """Live, and leave without exit handlers: those of rclpy's libraries look for threads that a fork does not have."""
    status = 1
    try:
        _neighbour(namespace, life, killed)
        status = 0
    finally:
        os._exit(status)


def _neighbour(namespace: str, life: float, killed: bool) -> None:
    """Subscribe to what the driver says, command it and call its services for `life` s."""
    import rclpy
    from lifecycle_msgs.srv import GetState
    from rcl_interfaces.srv import ListParameters
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    until = time.monotonic() + life
    signal.alarm(NEIGHBOUR)  # one that hangs would load the machine to the end
    rclpy.init(args=["neighbour", "--ros-args", "-r", f"__ns:={namespace}"])
    node = rclpy.create_node(f"neighbour_{os.getpid()}", start_parameter_services=False)
    for topic in ("motor_torques", "joint_states"):
        node.create_subscription(JointState, topic, lambda _: None, 10)
    commands = node.create_publisher(JointState, "motor_command_request", qos_profile_sensor_data)
    kinds = {"get_state": GetState, "list_parameters": ListParameters, "enable": Trigger, "disable": Trigger}
    clients = [(kind, node.create_client(kind, f"driver/{name}")) for name, kind in kinds.items()]
    turn = 0
    while time.monotonic() < until:
        commands.publish(JointState(name=["front_right", "front_left"], velocity=[20.0, 16.0]))
        kind, client = clients[turn % len(clients)]
        if client.service_is_ready():
            client.call_async(kind.Request())
        rclpy.spin_once(node, timeout_sec=0.02)
        turn += 1
    if killed:
        os.kill(os.getpid(), signal.SIGKILL)
    node.destroy_node()
    rclpy.shutdown()


# ----------------------------------------------------------------------
# Situations: what the driver is started with, and what is done until it ends.
# ----------------------------------------------------------------------


@dataclass
class End:
    """One driver, from its start to its end.

    Attributes
    ----------
    process : of the driver.
    log : Path
        What it has said so far.
    chance : random.Random
    namespace : str
    bus : Popen or None
        The bus's server, where there is one of its own.
    slowness : float
        How much longer than usual it takes to start.
    """

    process: Process
    log: Path
    chance: random.Random
    namespace: str
    bus: subprocess.Popen[str] | None = None
    slowness: float = 1.0

    @property
    def used(self) -> float:
        """Time that it has had a processor, s."""
        with suppress(FileNotFoundError, ProcessLookupError):
            ticks = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
            return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
        return 0.0

    def within(self, seconds: float) -> None:
        """Let a random time pass, unless the driver ends before."""
        until = time.monotonic() + self.chance.uniform(0.0, seconds)
        while time.monotonic() < until and self.process.wait(0.0) is None:
            time.sleep(0.005)

    def until(self, words: str) -> None:
        """Wait until it has said something."""
        until = time.monotonic() + PATIENCE
        while words not in self.log.read_text(errors="replace") and self.process.wait(0.0) is None:
            if time.monotonic() > until:
                return
            time.sleep(0.02)

    def signal(self) -> None:
        """Ask it to end, sometimes twice."""
        for _ in range(self.chance.choice((1, 1, 1, 2))):
            self.process.signal(self.chance.choice(BY_US))


def _nothing(_end: End) -> None:
    """It ends by itself."""


def _setting_up(end: End) -> None:
    at = end.chance.uniform(0.0, end.slowness * STARTUP)
    while end.process.wait(0.0) is None and end.used < at:
        time.sleep(0.005)
    end.signal()


def _running(end: End) -> None:
    end.until("driver on")
    end.within(SETTLED)
    end.signal()


def _enabled(end: End) -> None:
    end.until("enabled")
    end.within(SETTLED)
    end.signal()


def _bus_gone(end: End) -> None:
    end.until("driver on")
    assert end.bus is not None
    end.bus.kill()
    end.within(SETTLED)
    end.signal()


def _transition(end: End) -> None:
    """The lifecycle's shutdown, by a client that comes and goes for it; a signal where the client finds no driver."""
    end.until("driver on")
    command = [sys.executable, "-m", __spec__.name, "--shutdown", end.namespace]
    with suppress(subprocess.TimeoutExpired):
        quiet = subprocess.DEVNULL
        subprocess.run(command, stdout=quiet, stderr=quiet, timeout=PATIENCE, check=False)
    if end.process.wait(0.0) is None:
        end.signal()


@dataclass(frozen=True)
class Situation:
    """How a driver is brought to its end.

    Attributes
    ----------
    do : callable
        Does it.
    words : tuple of str
        Options of the driver.
    bus : str
        ``none``, ``idle``, ``drives`` or ``own``: none answers; one without drives; one with simulated drives; one
        without drives that is there for this end alone.
    """

    do: Callable[[End], None]
    words: tuple[str, ...] = ()
    bus: str = "idle"


SITUATIONS = {
    "parameter refused": Situation(_nothing, ("--kappa", "0.3"), "none"),
    "no bus": Situation(_nothing, (), "none"),
    "signal during set-up": Situation(_setting_up),
    "signal while it waits for drives": Situation(_running),
    "signal while the drives are enabled": Situation(_enabled, ("--enable",), "drives"),
    "signal after the bus was lost": Situation(_bus_gone, bus="own"),
    "the lifecycle's shutdown": Situation(_transition),
}
"""By what is said of them."""


def shut_down(namespace: str) -> None:
    """Call the lifecycle's shutdown of a driver."""
    import rclpy
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    from artibot_sim.nodes.common.process import destroyed, ros_process

    with ros_process("client", ()), destroyed(rclpy.create_node("client")) as node:
        client = node.create_client(ChangeState, f"{namespace}/driver/change_state")
        client.wait_for_service(PATIENCE / 2)
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_INACTIVE_SHUTDOWN))
        rclpy.spin_until_future_complete(node, client.call_async(request), timeout_sec=1.0)


# ----------------------------------------------------------------------
# Ends, counted.
# ----------------------------------------------------------------------


@dataclass
class Ends:
    """What was seen in one situation.

    Attributes
    ----------
    outcomes : Counter
        By exit status, signal, or ``hangs``.
    crashes : list of dict
        What is known of those by another signal than was sent, with a status out of order, and of those that hang.
    """

    outcomes: collections.Counter[str] = field(default_factory=collections.Counter)
    crashes: list[dict[str, Any]] = field(default_factory=list)

    def add(self, end: End, folder: Path) -> None:
        """Count an end; `folder` may have its core file."""
        status = end.process.wait(PATIENCE)
        if status is None:
            threads = frames(["-p", str(end.process.pid)])
            end.process.signal(signal.SIGKILL)
            end.process.wait(PATIENCE)
        name = "hangs" if status is None else signal.Signals(-status).name if status < 0 else f"status {status}"
        self.outcomes[name] += 1
        if status is None or (status not in IN_ORDER if status >= 0 else -status not in BY_US):
            core = next(iter(sorted(folder.glob("core*"))), None)
            last = end.log.read_text(errors="replace").splitlines()[-SAID:]
            found = threads if status is None else frames(["-c", str(core)]) if core else first_finding(folder)
            self.crashes.append({"end": name, "said": last, "frames": found})


def frames(of: Sequence[str]) -> list[str]:
    """The innermost functions of a core file's or a process's current thread; none without gdb."""
    if shutil.which("gdb") is None:
        return []
    command = ["gdb", "-batch", "-nx", "-ex", f"bt {FRAMES}", sys.executable, *of]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return [line[:150] for line in said.splitlines() if line.startswith("#")]


def first_finding(folder: Path) -> list[str]:
    """The first thing that memcheck found, with its innermost functions; nothing without memcheck."""
    said = [
        line.partition("== ")[2] for log in sorted(folder.glob("memcheck.*")) for line in log.open(errors="replace")
    ]
    begin = next((i for i, line in enumerate(said) if line.startswith(("Invalid", "Mismatched"))), len(said))
    return [line.strip()[:150] for line in said[begin : begin + FRAMES]]


class Process:
    """A driver. No `child_processes.Child`: that runs code between fork and exec, and here several threads fork.

    Parameters
    ----------
    words : sequence of str
        What follows ``artibot``.
    folder : Path
        Where it runs; gets its log.
    environment : dict
    memcheck : bool
    """

    def __init__(self, words: Sequence[str], folder: Path, environment: dict[str, str], memcheck: bool) -> None:
        under: list[str] = []
        if memcheck:
            (folder / "loader").write_text(LOADER)
            under = [*MEMCHECK, f"--suppressions={folder / 'loader'}", f"--log-file={folder / 'memcheck.%p'}"]
        with (folder / "log").open("wb") as sink:
            self._popen = subprocess.Popen(
                [*under, sys.executable, "-m", "artibot_sim.cli", *words],
                stdin=subprocess.DEVNULL, stdout=sink, stderr=subprocess.STDOUT, cwd=folder, env=environment,
            )  # fmt: skip
        self.pid = self._popen.pid

    def wait(self, timeout: float) -> int | None:
        """The exit status as subprocess has it, None when it has not ended within `timeout` s."""
        with suppress(subprocess.TimeoutExpired):
            return self._popen.wait(timeout)
        return None

    def signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        self._popen.send_signal(number)


class Worker:
    """Ends one driver after the other, in a namespace of its own.

    Parameters
    ----------
    number : int
    environment : dict
        Of the drivers.
    seed : int
    memcheck : bool
        Whether they run under valgrind.
    """

    def __init__(self, number: int, environment: dict[str, str], seed: int, memcheck: bool) -> None:
        self.namespace = f"/ends_{number}"
        self._environment, self._memcheck = environment, memcheck
        self._chance = random.Random(f"{seed} {number}")
        self._ended = 0

    def end(self, situation: Situation, channel: str, folder: Path, ends: Ends) -> None:
        """Start a driver, do what ends it, and count how it ended."""
        self._ended += 1
        own = folder / f"{self.namespace[1:]}_{self._ended}"
        own.mkdir()
        bus = None
        if situation.bus == "own":
            bus = start_server()
            channel = channel_of(bus)
        words = ["driver", "--channel", channel, *situation.words, "--ros-args", "-r", f"__ns:={self.namespace}"]
        process = Process(words, own, self._environment, self._memcheck)
        slowness = SLOWNESS if self._memcheck else 1.0
        end = End(process, own / "log", self._chance, self.namespace, bus, slowness)
        situation.do(end)
        ends.add(end, own)
        if bus is not None:
            bus.kill()
            bus.communicate()
        shutil.rmtree(own)

    @contextmanager
    def bus(self, kind: str, folder: Path) -> Iterator[str]:
        """A bus of this kind for all ends; yields its channel."""
        with ExitStack() as stack:
            channel = "ws://127.0.0.1:1/"  # nobody answers there
            if kind in ("idle", "drives"):
                channel = stack.enter_context(loopback_bus())
            if kind == "drives":
                command = [sys.executable, "-m", "artibot_sim.cli", "drives", "--bench", "--channel", channel]
                with (folder / f"{self.namespace[1:]}_drives").open("wb") as sink:
                    drives = subprocess.Popen(command, stdout=sink, stderr=subprocess.STDOUT)
                stack.callback(drives.wait)
                stack.callback(drives.terminate)
            yield channel


def count_ends(situation: Situation, count: int, workers: Sequence[Worker]) -> Ends:
    """End so many drivers, by all workers at once."""
    ends, left, lock = Ends(), [count], threading.Lock()

    def work(worker: Worker, folder: Path) -> None:
        with worker.bus(situation.bus, folder) as channel:
            while True:
                with lock:
                    if not left[0]:
                        return
                    left[0] -= 1
                worker.end(situation, channel, folder, ends)

    command = [sys.executable, "-m", __spec__.name, "--neighbours", *(worker.namespace for worker in workers)]
    with tempfile.TemporaryDirectory(prefix="artibot-ends-") as name, ThreadPoolExecutor(len(workers)) as pool:
        others = subprocess.Popen(command, stdin=subprocess.PIPE)
        try:
            for done in [pool.submit(work, worker, Path(name)) for worker in workers]:
                done.result()
        finally:
            others.communicate()  # closes its standard input, which ends it
    return ends


def main(argv: Sequence[str] | None = None) -> int:
    """End drivers, and print how they ended; the status is 1 where one did not end in order."""
    parser = argparse.ArgumentParser(prog=f"python -m {__spec__.name}", description=str(__doc__).splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=100, help="ends in each situation [100]")
    parser.add_argument("--situation", action="append", choices=list(SITUATIONS), help="only this; repeatable")
    parser.add_argument("--at-once", type=int, default=2, help="drivers that run at the same time [2]")
    parser.add_argument("--seed", type=int, default=1, help="of the random times [1]")
    parser.add_argument("--checkout", type=Path, help="folder with another state of artibot")
    parser.add_argument("--heap-checks", action="store_true", help="let glibc check and overwrite the heap")
    parser.add_argument(
        "--memcheck", action="store_true", help=f"run them under valgrind; status {FOUND}: it found some"
    )
    parser.add_argument("--shared", action="store_true", help="the drivers use shared memory too")
    parser.add_argument("--neighbours", nargs="+", metavar="NAMESPACE", help=argparse.SUPPRESS)
    parser.add_argument("--shutdown", metavar="NAMESPACE", help=argparse.SUPPRESS)
    given = parser.parse_args(argv)
    if given.neighbours:
        neighbours(given.neighbours, given.seed)
        return 0
    if given.shutdown:
        shut_down(given.shutdown)
        return 0
    resource.setrlimit(resource.RLIMIT_CORE, (resource.getrlimit(resource.RLIMIT_CORE)[1],) * 2)
    os.environ.update(SHARED if given.shared else local_environment())
    environment = os.environ | (HEAP_CHECKS if given.heap_checks else {})
    if given.memcheck:
        environment["PYTHONMALLOC"] = "malloc"  # Python's own allocator hides what is freed from memcheck
    if given.checkout:
        environment["PYTHONPATH"] = str(given.checkout.resolve())
    workers = [Worker(number, environment, given.seed, given.memcheck) for number in range(given.at_once)]
    crashed = False
    for name in given.situation or SITUATIONS:
        ends = count_ends(SITUATIONS[name], given.count, workers)
        crashed = crashed or bool(ends.crashes)
        print(json.dumps({"situation": name, "ends": dict(sorted(ends.outcomes.items())), "crashes": ends.crashes}))
        sys.stdout.flush()
    return int(crashed)


if __name__ == "__main__":
    sys.exit(main())
