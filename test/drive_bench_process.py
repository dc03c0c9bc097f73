"""Four simulated drives with flywheels on a bus, told what to do by lines of standard input (see driver_probe.py)."""

from __future__ import annotations

import json
import os
import sys
import time

from drive_bench import running_drives

from artibot_driver.bus import Bus, open_bus
from artibot_driver.config import config_from_parameters
from artibot_driver.priority import take_priority
from artibot_driver.rig import Rig, load_rig
from artibot_driver.simulated.drive import SimulatedDrive


class Cable:
    """What a drive is connected by: unplugged, nothing passes."""

    def __init__(self, drive: SimulatedDrive) -> None:
        self._drive, self._send, self._receive = drive, drive._send, drive.receive

    def unplug(self) -> None:
        self._drive._send = lambda frame: False
        self._drive.receive = lambda *_: None  # type: ignore[method-assign]

    def plug(self) -> None:
        self._drive._send, self._drive.receive = self._send, self._receive  # type: ignore[method-assign]
        self._drive.power_on(time.monotonic_ns())


def main(interface: str, channel: str) -> None:
    take_priority(0 if "IN_UML" in os.environ else 55)
    rig = load_rig(config_from_parameters({}))
    with open_bus(interface, channel) as bus:
        while served(bus, rig):
            pass


def served(bus: Bus, rig: Rig) -> bool:
    """Have four drives do what they are told, until others are to take their place or nothing more comes."""
    with running_drives(bus, rig) as drives:
        cables = {motor: Cable(drive) for motor, drive in drives.items()}
        for line in sys.stdin:
            word, *rest = line.split()
            if word == "fail":
                drives[rest[0]].fail(int(rest[1]))
            elif word in ("plug", "unplug"):
                getattr(cables[rest[0]], word)()
            print(json.dumps({motor: state(drive) for motor, drive in drives.items()}), flush=True)
            if word == "renew":
                return True
    return False


def state(drive: SimulatedDrive) -> dict[str, object]:
    """What a drive is at."""
    shaft = drive._shaft
    return {"state": str(drive.state), "velocity": shaft.state().velocity, "free": shaft.asked.is_free}


if __name__ == "__main__":
    main(*sys.argv[1:])
