"""A node that commands a driver and listens to it, and drives on a bus for it, for the tests."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from sim_probe import Probe
from std_srvs.srv import Trigger

from artibot_driver.bus import open_bus
from artibot_driver.pdo import Codec
from artibot_driver.priority import take_priority

MEASURED = ("odom", "joint_states", "motor_torques", "motor_command")


TIMEOUTS = ("command_timeout", "heartbeat.drive_timeout", "heartbeat.driver_timeout")
PATIENT = ("--ros-args", *(word for name in TIMEOUTS for word in ("-p", f"{name}:=0.5")))
"""Parameters of a driver where a machine that does other things too may hold somebody up; how soon silence is noticed
is tested by :mod:`node_faults`."""

PRIORITY = 0 if "IN_UML" in os.environ else 45
"""Real-time priority of what looks at the bus. An emulated machine has one processor, on which the kernel's own thread
that hands frames over would starve behind it."""


class DriverProbe(Probe):
    """Commands a driver, and keeps what it publishes; ``diagnostics`` are all that came.

    Parameters
    ----------
    context : rclpy Context
    topics : sequence of str
        What it listens to beside /diagnostics.
    """

    def __init__(self, context: Context, topics: Sequence[str] = MEASURED) -> None:
        super().__init__(context, topics)
        self.diagnostics: list[DiagnosticArray] = []
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)

    def listened(self, timeout: float = 60.0) -> None:
        """Wait until the driver hears commands and tells how the drives are."""
        mine = (self.planned, self.request, self.twist)
        self.until(lambda: all(p.get_subscription_count() for p in mine), "the driver to listen", timeout)
        self.until(lambda: all(self.got[topic] for topic in self.got), "its topics", timeout)

    def call_driver(self, name: str) -> Trigger.Response:
        return self.call(Trigger, f"driver/{name}", Trigger.Request())

    def enabled(self) -> None:
        """Enable the drives; they must become it."""
        self.until(lambda: self.part("driver")["phase"] == "READY", "drives that are set up")
        answer = self.call_driver("enable")
        assert answer.success, answer.message

    def status(self, name: str) -> DiagnosticStatus | None:
        """The newest status of a part: driver, bus, or a motor."""
        found = self.diagnostics[-1].status if self.diagnostics else ()
        return next((each for each in found if each.name == f"artibot driver: {name}"), None)

    def part(self, name: str) -> dict[str, str]:
        """Its values."""
        status = self.status(name)
        return {} if status is None else {each.key: each.value for each in status.values} | {"message": status.message}

    def is_stopped_by(self, reason: str) -> bool:
        """Whether /diagnostics names the reason of a stop, and the drives are disabled."""
        driver = self.part("driver")
        return driver.get("stop reason") == reason and driver["phase"] not in ("ENABLED", "STOPPING", "ENABLING")

    def commanded(self) -> tuple[float, float]:
        """Newest front velocities that were sent; NaN where none are."""
        return tuple(self.last("motor_command").velocity[:2])

    def turning(self) -> float:
        """Newest speed of the faster front motor, rad/s."""
        return max(map(abs, self.last("motor_torques").velocity[:2]))


class Drives:
    """Four simulated drives with flywheels, in a process of their own.

    Parameters
    ----------
    interface, channel : str
    """

    def __init__(self, interface: str, channel: str) -> None:
        script = str(Path(__file__).with_name("drive_bench_process.py"))
        command = [sys.executable, script, interface, channel]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._ask("state")

    def _ask(self, line: str) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def states(self) -> dict[str, dict[str, Any]]:
        """Of each motor: state, velocity (rad/s), and whether it is without current."""
        return self._ask("state")

    def fail(self, motor: str, code: int) -> None:
        """Have a drive detect a fault."""
        self._ask(f"fail {motor} {code}")

    def unplug(self, motor: str) -> None:
        """Have a drive neither hear nor say anything from now on."""
        self._ask(f"unplug {motor}")

    def plug(self, motor: str) -> None:
        """Connect it again, switched off and on."""
        self._ask(f"plug {motor}")

    def renew(self) -> None:
        """Put four others in their place, at rest and as they come from the factory."""
        self._ask("renew")
        assert self._ask("state")

    def end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextlib.contextmanager
def prompt() -> Iterator[None]:
    """Have this thread preferred where the system allows it: a test that is late is itself the silence it looks for."""
    before = os.sched_getscheduler(0)
    with contextlib.suppress(OSError):
        if PRIORITY:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(40))
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, before, os.sched_param(0))


@contextlib.contextmanager
def drives_on(interface: str, channel: str) -> Iterator[Drives]:
    """Drives for the length of a block."""
    drives = Drives(interface, channel)
    try:
        yield drives
    finally:
        drives.end()


class Sniffer:
    """Keeps every frame on a bus with the steady time it was read at.

    Parameters
    ----------
    interface, channel : str
    identifiers : sequence of int
        Only frames with these; none: all.

    Attributes
    ----------
    frames : list of (float, int, bytes)
        Steady time (s), identifier, data.
    """

    def __init__(self, interface: str, channel: str, identifiers: Sequence[int] = ()) -> None:
        self._bus = open_bus(interface, channel)
        if identifiers:
            self._bus.raw.set_filters([{"can_id": each, "can_mask": 0x7FF, "extended": False} for each in identifiers])
        self.frames: list[tuple[float, int, bytes]] = []
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sniffer")
        self._thread.start()

    def _run(self) -> None:
        take_priority(PRIORITY)  # a frame's time is when it was read
        while not self._finished.is_set():
            message = self._bus.receive(0.05)
            if message is not None:
                self.frames.append((time.monotonic(), message.arbitration_id, bytes(message.data)))

    def __enter__(self) -> Sniffer:
        return self

    def __exit__(self, *_: object) -> None:
        self._finished.set()
        self._thread.join()
        self._bus.close()

    def decoded(self, codec: Codec, since: float = 0.0) -> Iterator[tuple[float, Any]]:
        """What was read after `since`, decoded, with its time."""
        for at, can_id, data in list(self.frames):
            if at >= since:
                yield at, codec.decode(can_id, data)
