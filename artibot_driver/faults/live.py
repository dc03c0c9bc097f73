"""The closed loop in real time on a real bus: the drives in a thread and on a socket of their own."""

from __future__ import annotations

import os
import random
import threading
import time
from collections.abc import Callable
from typing import Final

import can
from can.typechecking import CanFilters

from artibot_driver.bus import Bus
from artibot_driver.faults.crew import Crew
from artibot_driver.faults.place import Place
from artibot_driver.faults.wire import UnreliableBus
from artibot_driver.faults.world import DRIVE_STEP, Sample, World
from artibot_driver.frames import Frame
from artibot_driver.master import Master
from artibot_driver.rig import Rig

STRANGERS_OF_ONE: Final = 2
"""The same where a single processor carries bus, drives, driver and whoever makes the noise."""

_BUS_OFF, _RESTARTED = 0x040, 0x100  # classes of error frames

_NOTHING: Final[CanFilters] = [{"can_id": 0x1FFFFFFF, "can_mask": 0x1FFFFFFF, "extended": True}]
"""Filter for one who only talks."""


class LiveWorld(World):
    """On a real bus; a context manager, for the thread of the drives ends with it."""

    def __init__(self, rig: Rig, rng: random.Random, place: Place) -> None:
        super().__init__(rig, rng)
        self._place = place
        self._buses = self._open()
        self.unreliable = UnreliableBus(self._buses[0], rng)
        self._crew = Crew(rig, self._buses[1])
        self.master = Master(self.unreliable, rig)
        self._lock = threading.Lock()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._drives, name="drives")
        self._next = self.now
        if os.cpu_count() == 1:
            self.strangers = STRANGERS_OF_ONE
            self.full = 1.0 - rig.bus_load  # beside the drives' own frames; elsewhere more than a bus could carry

    def _open(self) -> list[Bus]:
        """Ends of the bus for the master, the drives, and others who do not listen."""
        buses = [self._place.open() for _ in range(3)]
        buses[2].raw.set_filters(_NOTHING)
        return buses

    def __enter__(self) -> LiveWorld:
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
                self._crew.step(self.now)

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
                seen = self._crew.seen()
            self.trace.append(Sample(self.now, cycle, seen))

    def with_crew(self, what: Callable[[Crew], object]) -> None:
        """Do something to the drives."""
        with self._lock:
            what(self._crew)

    def new_master(self) -> None:
        """Have another master take the place of this one."""
        self.master = Master(self.unreliable, self.rig)

    def inject(self, frames: list[Frame]) -> None:
        """Have somebody else send frames."""
        for frame in frames:
            self._buses[2].send(frame)

    def bus_down(self) -> None:
        """Have the bus carry nothing any more."""
        self._place.down()
        self._next = self.now

    def bus_up(self) -> None:
        """Have it carry frames again."""
        if self._place.up():
            for bus in self._buses:
                bus.close()
            with self._lock:
                self._buses = self._open()
                self._crew.use_bus(self._buses[1])
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
