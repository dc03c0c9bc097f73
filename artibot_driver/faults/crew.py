"""The four simulated drives of a trial, each with a flywheel, a cable and a supply that can be taken away."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from artibot_driver.cia402 import State
from artibot_driver.frames import Frame
from artibot_driver.master.traffic import AnyBus
from artibot_driver.rig import Rig
from artibot_driver.simulated.drive import SimulatedDrive
from artibot_driver.simulated.shaft import FREE, InertialShaft, ShaftCommand
from artibot_sim.model import MOTORS


class Seen(NamedTuple):
    """What the four drives do at one moment, in the order of ``MOTORS``; `velocity` is the motors', rad/s."""

    state: tuple[State, ...]
    asked: tuple[ShaftCommand, ...]
    velocity: tuple[float, ...]


class Crew:
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

    def seen(self) -> Seen:
        """What the drives do now."""
        return Seen(
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

    def restart_unheard(self, motor: str, now: int) -> None:
        """Have a drive start anew, and its boot-up message get lost."""
        self.unplug(motor)
        self.drives[motor].power_on(now)
        self.plug(motor)
