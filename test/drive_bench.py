"""Simulated drives on a bench: flywheels, a bus in memory, a master that knows frames only, and time that tests set.

:func:`running_drives` puts all four on a real bus and lets them run in real time.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

from artibot_driver.bus import Bus
from artibot_driver.cia402 import DriveState, controlword_for, state_of
from artibot_driver.config import config_from_parameters
from artibot_driver.frames import Emcy, Frame, NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.pdo import Decoded, Pdo
from artibot_driver.rig import Rig, load_rig
from artibot_driver.simulated.drive import SimulatedDrive
from artibot_driver.simulated.motion import InertialShaft

STEP = 2_000_000
"""Between two steps of a drive, ns."""


class Bench:
    """One drive, its motor and a master.

    Attributes
    ----------
    received : list
        What the drive has sent, decoded.
    beating : bool
        Whether the master sends its heartbeat.
    """

    def __init__(self, motor: str = "front_left", rig: Rig | None = None, **given: object) -> None:
        self.rig = rig or load_rig(config_from_parameters({k.replace("__", "."): v for k, v in given.items()}))
        self.motor, self.node = motor, self.rig.config.node_ids[motor]
        self.scaling = self.rig.scaling[motor]
        self.received: list[Decoded] = []
        self.shaft = InertialShaft()
        self.drive = SimulatedDrive(self.rig, motor, self.shaft, self._receive)
        self.now = 1_000_000_000
        self.beating = True
        self.controlword = 0
        self._cycles = 0

    def _receive(self, frame: Frame) -> None:
        decoded = self.rig.codec.decode(*frame)
        assert isinstance(decoded, Decoded.__args__), decoded
        self.received.append(decoded)

    def send(self, frame: Frame) -> None:
        """Send a frame to the drive."""
        self.drive.receive(*frame, self.now)

    def advance(self, seconds: float) -> None:
        """Let time pass for motor and drive, nothing else."""
        for _ in range(round(seconds * 1e9 / STEP)):
            self.now += STEP
            self.shaft.advance(STEP * 1e-9)
            self.drive.step(self.now)

    def set_up(self) -> None:
        """Power on, write the rig's settings by SDO, start."""
        self.drive.power_on(self.now)
        for each in self.rig.settings(self.motor):
            if each.written:
                self.write(each.index, each.value, each.subindex)
        self.send(nmt(NmtCommand.START))
        self.beat()

    def write(self, index: int, value: int, subindex: int = 0) -> None:
        """Write an object as an SDO does; it must be taken."""
        self.received.clear()
        size = len(self.drive.objects.read((index, subindex)))
        head = bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex))
        self.send(Frame(0x600 + self.node, head + (value & 0xFFFFFFFF).to_bytes(4, "little")))
        assert any(getattr(each, "service", "") == "download" for each in self.received), (hex(index), self.received)

    def beat(self) -> None:
        """The master's heartbeat."""
        self.send(heartbeat(self.rig.config.driver_id, NmtState.OPERATIONAL))

    def cycle(self, velocity: int = 0, torque: int = 0) -> None:
        """One SYNC period: set-points, SYNC, 10 ms, and the master's heartbeat when due."""
        self.send(self.rig.codec.pdo("RPDO1", self.node, (self.controlword, velocity, torque)))
        self.send(self.rig.codec.sync())
        self.advance(0.01)
        self._cycles += 1
        if self.beating and self._cycles % 5 == 0:
            self.beat()

    def run(self, seconds: float, velocity: int = 0, torque: int = 0) -> None:
        """Cycles for so long."""
        for _ in range(round(seconds / 0.01)):
            self.cycle(velocity, torque)

    def lead_to(self, target: DriveState, velocity: int = 0, torque: int = 0, reset_faults: bool = False) -> None:
        """What a driver does to bring the drive to a state, from statuswords alone."""
        for _ in range(40):
            self.cycle(velocity, torque)
            state = state_of(self.feedback("statusword"))
            if state is target:
                return
            assert state is not None
            self.controlword = controlword_for(state, target, self.controlword, reset_faults=reset_faults)
        raise AssertionError(f"stayed in {self.drive.state} on the way to {target}")

    def feedback(self, name: str) -> int:
        """A field of the last PDO that has it."""
        for each in reversed(self.received):
            if isinstance(each, Pdo) and name in each.map.position:
                return each.value(name)
        raise AssertionError(f"no {name} heard")

    def emergencies(self) -> list[int]:
        """Error codes heard, in order."""
        return [each.code for each in self.received if isinstance(each, Emcy)]

    def enabled(self) -> Bench:
        """Set up and enabled."""
        self.set_up()
        self.controlword = 0x06
        self.lead_to(DriveState.OPERATION_ENABLED)
        self.controlword = 0x0F
        return self


@contextlib.contextmanager
def running_drives(bus: Bus, rig: Rig, step: int = STEP) -> Iterator[dict[str, SimulatedDrive]]:
    """All drives of a rig, each with a flywheel, on a bus that they share, in a thread of their own.

    Parameters
    ----------
    step : int
        At most so long between two steps of a drive, ns.
    """
    shafts = {motor: InertialShaft() for motor in rig.codec.nodes}
    drives = {motor: SimulatedDrive(rig, motor, shaft, bus.send) for motor, shaft in shafts.items()}
    finished = threading.Event()

    def run() -> None:
        last = time.monotonic_ns()
        for drive in drives.values():
            drive.power_on(last)
        while not finished.is_set():
            message = bus.receive(1e-9 * step)
            while message is not None:
                if not (message.is_extended_id or message.is_remote_frame):
                    for drive in drives.values():
                        drive.receive(message.arbitration_id, bytes(message.data), time.monotonic_ns())
                message = bus.receive()
            now = time.monotonic_ns()
            for motor, drive in drives.items():
                shafts[motor].advance(1e-9 * (now - last))
                drive.step(now)
            last = now

    thread = threading.Thread(target=run, name="drives")
    thread.start()
    try:
        yield drives
    finally:
        finished.set()
        thread.join()
