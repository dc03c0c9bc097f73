"""The closed loop in real time on a real bus that can be taken away and given back."""

from __future__ import annotations

import fcntl
import os
import random
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Final, Protocol

import can
from can.typechecking import CanFilters

from artibot_driver.bus import Bus, open_bus
from artibot_driver.faults.closed_loop import DRIVE_STEP, ClosedLoop, DriveSet, PeriodSample
from artibot_driver.faults.simulated_bus import UnreliableBus
from artibot_driver.frames import Frame
from artibot_driver.loopback import channel_of, start_server
from artibot_driver.master import Master
from artibot_driver.rig import Rig
from artibot_sim.errors import ArtibotError

# ----------------------------------------------------------------------
# Real buses to try faults on, which can be taken away and given back.
# ----------------------------------------------------------------------


_REOPEN: Final = 10.0
"""A loopback bus is tried to be started again on its port for so long, s."""


_SIOCGIFFLAGS, _SIOCSIFFLAGS, _IFF_UP = 0x8913, 0x8914, 1


class SwitchableBus(Protocol):
    """A bus that trials can take down."""

    def open(self) -> Bus:
        """Another end of it."""

    def down(self) -> None:
        """Have it carry nothing any more."""

    def up(self) -> bool:
        """Have it carry frames again; whether its ends have to be opened anew."""

    def close(self) -> None:
        """Leave nothing behind."""


class SwitchableLoopback:
    """The loopback bus; to take it down is to kill its server, to give it back to start another on the same port."""

    def __init__(self) -> None:
        self._server = start_server()
        self.channel = channel_of(self._server)

    def open(self) -> Bus:
        """Another end of it."""
        return open_bus("remote", self.channel)

    def down(self) -> None:
        """Kill the server."""
        self._server.kill()
        self._server.communicate()

    def up(self) -> bool:
        """Start another server."""
        port, until = int(self.channel.rstrip("/").rpartition(":")[2]), time.monotonic() + _REOPEN
        while True:
            self._server = start_server(port)
            try:
                self.channel = channel_of(self._server)
                return True
            except ArtibotError:  # the port is not free yet
                if time.monotonic() > until:
                    raise
                time.sleep(0.1)

    def close(self) -> None:
        """Leave no server behind."""
        self.down()


class SwitchableSocketCan:
    """An interface of this kernel; to put it down and up takes the right to do so."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        open_bus("socketcan", channel).close()  # says at once what is missing

    def open(self) -> Bus:
        """Another end of it."""
        return open_bus("socketcan", self.channel)

    def down(self) -> None:
        """Put the interface down."""
        self._set(False)

    def up(self) -> bool:
        """Put it up; open sockets go on."""
        self._set(True)
        return False

    def close(self) -> None:
        """The interface stays."""

    def _set(self, up: bool) -> None:
        """By ioctl, as `ip link set` does, but in microseconds: whoever calls keeps a loop going."""
        name = self.channel.encode()
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
                answer = fcntl.ioctl(control, _SIOCGIFFLAGS, struct.pack("16sH14x", name, 0))
                _, flags = struct.unpack("16sH14x", answer)
                flags = flags | _IFF_UP if up else flags & ~_IFF_UP
                fcntl.ioctl(control, _SIOCSIFFLAGS, struct.pack("16sH14x", name, flags))
        except OSError as error:
            state = "up" if up else "down"
            raise ArtibotError(f"bus {self.channel}: cannot be put {state}: {error.strerror}; run as root") from None


# ----------------------------------------------------------------------
# The closed loop in real time on a real bus: the drives in a thread and on a socket of their own.
# ----------------------------------------------------------------------


NOISE_FRAMES_ONE_CORE: Final = 2
"""Frames of noise in a period where a single processor carries bus, drives, driver and whoever sends them."""

_BUS_OFF, _RESTARTED = 0x040, 0x100  # classes of error frames

_NOTHING: Final[CanFilters] = [{"can_id": 0x1FFFFFFF, "can_mask": 0x1FFFFFFF, "extended": True}]
"""Filter for one who only talks."""


class LiveLoop(ClosedLoop):
    """On a real bus; a context manager, for the thread of the drives ends with it."""

    def __init__(self, rig: Rig, rng: random.Random, bus: SwitchableBus) -> None:
        super().__init__(rig, rng)
        self._switchable = bus
        self._buses = self._open()
        self.unreliable = UnreliableBus(self._buses[0], rng)
        self._drive_set = DriveSet(rig, self._buses[1])
        self.master = Master(self.unreliable, rig)
        self._lock = threading.Lock()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._drives, name="drives")
        self._next = self.now
        if os.cpu_count() == 1:
            self.noise_frames = NOISE_FRAMES_ONE_CORE
            self.full = 1.0 - rig.bus_load  # beside the drives' own frames; elsewhere more than a bus could carry

    def _open(self) -> list[Bus]:
        """Ends of the bus for the master, the drives, and others who do not listen."""
        buses = [self._switchable.open() for _ in range(3)]
        buses[2].raw.set_filters(_NOTHING)
        return buses

    def __enter__(self) -> LiveLoop:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._finished.set()
        self._thread.join()
        for bus in self._buses:
            bus.close()

    def _drives(self) -> None:
        while not self._finished.wait(1e-9 * DRIVE_STEP):
            with self._lock:
                self._drive_set.step(self.now)

    @property
    def now(self) -> int:
        """Steady time, ns."""
        return time.monotonic_ns()

    def run(self, seconds: float) -> None:
        """Let so much time pass."""
        for _ in range(max(1, round(seconds * 1e9 / self.period))):
            self.inject(self.foreign_frames())
            cycle = None if self.hung else self.master.cycle(self.now, self.command(self.now))
            self._next += self.period
            wait = self._next - self.now
            if wait > 0:
                time.sleep(1e-9 * wait)
            else:
                self._next = self.now
            with self._lock:
                drives = self._drive_set.states()
            self.trace.append(PeriodSample(self.now, cycle, drives))

    def with_drives(self, what: Callable[[DriveSet], object]) -> None:
        """Do something to the drives."""
        with self._lock:
            what(self._drive_set)

    def new_master(self) -> None:
        """Have another master take the place of this one."""
        self.master = Master(self.unreliable, self.rig)

    def inject(self, frames: list[Frame]) -> None:
        """Have somebody else send frames."""
        for frame in frames:
            self._buses[2].send(frame)

    def bus_down(self) -> None:
        """Have the bus carry nothing any more."""
        self._switchable.down()
        self._next = self.now

    def bus_up(self) -> None:
        """Have it carry frames again."""
        if self._switchable.up():
            for bus in self._buses:
                bus.close()
            with self._lock:
                self._buses = self._open()
                self._drive_set.use_bus(self._buses[1])
            self.unreliable.bus = self._buses[0]
            self.master.use_bus(self.unreliable)
        self._next = self.now

    def bus_off(self) -> None:
        """Have the master's controller leave the bus: its driver sends an error frame, and nothing else passes."""
        self._report(_BUS_OFF)
        self.unreliable.cut = True

    def bus_on(self) -> None:
        """Have it come back, as with `restart-ms`."""
        self._report(_RESTARTED)
        self.unreliable.cut = False

    def _report(self, classes: int) -> None:
        self._buses[2].send_message(can.Message(arbitration_id=classes, is_error_frame=True, data=bytes(8)))
