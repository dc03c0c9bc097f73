"""A closed loop to try faults in: a master, a bus, four simulated drives with flywheels, and somebody who commands.

:class:`VirtualLoop` runs in time of its own, as fast as it goes, on a bus in memory; ``LiveLoop`` in real time on a
real bus.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final, NamedTuple

from artibot_driver.bus import BusState
from artibot_driver.cia402 import DriveState
from artibot_driver.faults.simulated_bus import MemoryBus, UnreliableBus, memory_buses
from artibot_driver.frames import Frame
from artibot_driver.master import Master, MasterCycle, Phase, Setpoints
from artibot_driver.master.traffic import AnyBus
from artibot_driver.rig import Rig, motor_per_metre
from artibot_driver.simulated.drive import SimulatedDrive
from artibot_driver.simulated.motion import FREE, InertialShaft, ShaftCommand
from artibot_sim.model import MOTORS

# ----------------------------------------------------------------------
# The four simulated drives of a trial, each with a flywheel, a cable and a supply that can be taken away.
# ----------------------------------------------------------------------


class DriveStates(NamedTuple):
    """What the four drives do at one moment, in the order of ``MOTORS``; `velocity` is the motors', rad/s."""

    state: tuple[DriveState, ...]
    asked: tuple[ShaftCommand, ...]
    velocity: tuple[float, ...]


class DriveSet:
    """Four drives on one end of a bus. For one thread at a time."""

    def __init__(self, rig: Rig, bus: AnyBus) -> None:
        self._bus = bus
        self.shafts = {motor: InertialShaft() for motor in MOTORS}
        self.drives = {
            motor: SimulatedDrive(rig, motor, shaft, self._sender(motor)) for motor, shaft in self.shafts.items()
        }
        self._unplugged: set[str] = set()
        self._unpowered: set[str] = set()
        self._last: int | None = None

    def _sender(self, motor: str) -> Callable[[Frame], None]:
        def send(frame: Frame) -> None:
            if motor not in self._unplugged:
                self._bus.send(frame)

        return send

    def use_bus(self, bus: AnyBus) -> None:
        """Go on with another bus."""
        self._bus = bus

    def step(self, now: int) -> None:
        """Take in what has come, turn the motors, let the drives act."""
        if self._last is None:
            self._last = now
            for drive in self.drives.values():
                drive.power_on(now)
        while (message := self._bus.receive()) is not None:
            if not (message.is_extended_id or message.is_remote_frame):
                for motor, drive in self.drives.items():
                    if motor not in self._unplugged | self._unpowered:
                        drive.receive(message.arbitration_id, bytes(message.data), now)
        for motor, drive in self.drives.items():
            self.shafts[motor].advance(1e-9 * (now - self._last))
            if motor not in self._unpowered:
                drive.step(now)
        self._last = now

    def states(self) -> DriveStates:
        """What the drives do now."""
        return DriveStates(
            tuple(drive.state for drive in self.drives.values()),
            tuple(shaft.asked for shaft in self.shafts.values()),
            tuple(shaft.state().velocity for shaft in self.shafts.values()),
        )

    def unplug(self, motor: str) -> None:
        """Take a drive off the bus; it goes on as it is."""
        self._unplugged.add(motor)

    def plug(self, motor: str) -> None:
        """Put it back."""
        self._unplugged.discard(motor)

    def cut_power(self, motor: str) -> None:
        """Take a drive's supply away: it is dead, and its motor free."""
        self._unpowered.add(motor)
        self.shafts[motor].command(FREE)

    def power(self, motor: str, now: int) -> None:
        """Give it back: the drive starts anew."""
        if motor in self._unpowered:
            self._unpowered.discard(motor)
            self.drives[motor].power_on(now)

    def restart_unnoticed(self, motor: str, now: int) -> None:
        """Have a drive start anew, and its boot-up message get lost."""
        self.unplug(motor)
        self.drives[motor].power_on(now)
        self.plug(motor)


# ----------------------------------------------------------------------
# A closed loop to try faults in: a master, a bus, four simulated drives with flywheels, and somebody who
# commands.
# ----------------------------------------------------------------------


DRIVE_STEP: Final = 2_000_000
"""Between two steps of the drives, ns."""

NOISE_FRAMES: Final = 10
"""Frames in a period from nodes that are none of ours, where there is a noise."""

QUEUE: Final = (10, 100)
"""Frames that may wait in an interface: what Linux gives it by default, and what docs/field.md does."""

_FLOOD_FRAME = Frame(0x7F0, bytes(8))


class PeriodSample(NamedTuple):
    """One period: time (ns), the master's cycle (None while its loop hangs), what the drives do."""

    now: int
    cycle: MasterCycle | None
    drives: DriveStates


class ClosedLoop(ABC):
    """What faults and trials are written against.

    Attributes
    ----------
    command : callable
        Takes the time, gives the set-points of a period, or None.
    hung : bool
        Whether the master's loop stands still.
    flood : float
        Foreign frames, as a share of what the bus can carry.
    noise : int
        Random frames in every period, from nodes that are none of ours.
    noise_frames : int
        Frames in a period that make a noise.
    full : float
        The flood that fills the bus.
    trace : list of PeriodSample
        All periods so far.
    """

    def __init__(self, rig: Rig, rng: random.Random) -> None:
        self.rig, self.rng = rig, rng
        self.command: Callable[[int], Setpoints | None] = lambda now: None
        self.hung = False
        self.flood = 0.0
        self.noise = 0
        self.noise_frames = NOISE_FRAMES
        self.full = 1.0
        self.trace: list[PeriodSample] = []
        self.period = 1000 * rig.config.sync_period_us
        self.turn = motor_per_metre(rig.robot, "front_right")
        self.unreliable: UnreliableBus
        self.master: Master

    @property
    @abstractmethod
    def now(self) -> int:
        """Steady time, ns."""

    @abstractmethod
    def run(self, seconds: float) -> None:
        """Let so much time pass."""

    @abstractmethod
    def with_drives(self, what: Callable[[DriveSet], object]) -> None:
        """Do something to the drives."""

    @abstractmethod
    def inject(self, frames: list[Frame]) -> None:
        """Have somebody else send frames, received by master and drives."""

    @abstractmethod
    def bus_down(self) -> None:
        """Have the bus carry nothing any more."""

    @abstractmethod
    def bus_up(self) -> None:
        """Have it carry frames again."""

    @abstractmethod
    def bus_off(self) -> None:
        """Have the master's controller leave the bus after too many errors, and say so."""

    @abstractmethod
    def bus_on(self) -> None:
        """Have it come back, and say so."""

    def cable_off(self) -> None:
        """Take the cable off the master's adapter: nobody confirms a frame, and so they wait, as many as there may."""
        self.unreliable.cut, self.unreliable.room = True, self.rng.randint(*QUEUE)

    def cable_on(self) -> None:
        """Put it back: what has waited goes out."""
        self.unreliable.join()

    @property
    def last(self) -> MasterCycle:
        """The master's last cycle."""
        return next(sample.cycle for sample in reversed(self.trace) if sample.cycle is not None)

    def run_until(self, phase: Phase, seconds: float) -> bool:
        """Let time pass until the master is in a phase, at most so long."""
        end = self.now + round(1e9 * seconds)
        while self.now < end:
            self.run(1e-9 * self.period)
            if self.last.status.phase is phase:
                return True
        return False

    @abstractmethod
    def new_master(self) -> None:
        """Have another master take the place of this one, which is gone without a word."""

    def foreign_frames(self) -> list[Frame]:
        """What others put on the bus in one period."""
        most = self.rig.config.bitrate * 1e-9 * self.period / 111  # eight bytes, without stuff bits
        return [_FLOOD_FRAME] * round(self.flood * most) + [self._noise_frame() for _ in range(self.noise)]

    def _noise_frame(self) -> Frame:
        """A service of a node that is none of ours, or an identifier that is nobody's."""
        ours = (*self.rig.codec.nodes.values(), self.rig.config.driver_id, 0)
        node = self.rng.choice([each for each in range(128) if each not in ours])
        base = self.rng.choice((0x80, 0x180, 0x200, 0x280, 0x300, 0x400, 0x580, 0x600, 0x700))
        return Frame(base + node, self.rng.randbytes(self.rng.randrange(9)))


class VirtualLoop(ClosedLoop):
    """In time of its own, on a bus in memory: the same seed gives the same trial."""

    def __init__(self, rig: Rig, rng: random.Random) -> None:
        super().__init__(rig, rng)
        self._now = 1_000_000_000
        self._near, self._far = memory_buses()
        self.unreliable = UnreliableBus(self._near, rng)
        self.drive_set = DriveSet(rig, self._far)
        self.master = Master(self.unreliable, rig, clock=lambda: self._now)

    @property
    def now(self) -> int:
        """Steady time, ns."""
        return self._now

    def run(self, seconds: float) -> None:
        """Let so much time pass, in whole periods."""
        for _ in range(max(1, round(seconds * 1e9 / self.period))):
            self.inject(self.foreign_frames())
            cycle = None if self.hung else self.master.cycle(self._now, self.command(self._now))
            for _ in range(self.period // DRIVE_STEP):
                self.drive_set.step(self._now)
                self._now += DRIVE_STEP
            self.trace.append(PeriodSample(self._now, cycle, self.drive_set.states()))

    def new_master(self) -> None:
        """Have another master take the place of this one."""
        self.master = Master(self.unreliable, self.rig, clock=lambda: self._now)

    def with_drives(self, what: Callable[[DriveSet], object]) -> None:
        """Do something to the drives."""
        what(self.drive_set)

    def inject(self, frames: list[Frame]) -> None:
        """Have somebody else send frames."""
        for end in (self._near, self._far):
            if end.state.carries_frames:
                end.inbox.extend(frames)

    def bus_down(self) -> None:
        """Have the bus carry nothing any more."""
        self._set(BusState.DOWN, self._near, self._far)

    def bus_up(self) -> None:
        """Have it carry frames again."""
        self._set(BusState.ACTIVE, self._near, self._far)

    def bus_off(self) -> None:
        """Have the master's controller leave the bus."""
        self._set(BusState.BUS_OFF, self._near)

    def bus_on(self) -> None:
        """Have it come back."""
        self._set(BusState.ACTIVE, self._near)

    def _set(self, state: BusState, *ends: MemoryBus) -> None:
        for end in ends:
            end.state = state
            end.inbox.clear()
