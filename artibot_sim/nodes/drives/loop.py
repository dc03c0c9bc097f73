"""Four simulated drives on a bus and the motors behind them, kept in step with real time. No ROS in here.

Frames are answered as they come, once the motors have turned up to then, in slices of motion of 2 ms or less; where
nothing comes nobody asks where they are, and they turn once a period. Nothing here has a thread: whoever owns a
:class:`DriveLoop` calls :meth:`DriveLoop.run_until` again and again. Frames and drives live in steady wall time. On a
machine that was held up drives have read what came in the meantime before they look for their master's heartbeat: one
that was there in time counts.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from artibot_driver.bus import Bus, BusState, open_bus
from artibot_driver.config import DriverConfig, load_config
from artibot_driver.frames import Frame
from artibot_driver.listener import interface_of
from artibot_driver.rig import Rig
from artibot_driver.simulated.drive import SimulatedDrive
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS
from artibot_sim.nodes.drives.motors import Plant

MOST_AT_ONCE: Final = 200
"""Frames that are read at most before the motors turn on: a flood of them must not stop these."""

CHECK_EVERY: Final = 500_000_000
"""Between two checks of the bus's health, ns."""


class DriveLoop:
    """Drives, bus and motors.

    Parameters
    ----------
    rig : Rig
    plant : Plant
        The motors.
    bus : Bus
        It is closed by :meth:`close`, and opened anew where it was lost.

    Attributes
    ----------
    drives : dict of str to SimulatedDrive
        By motor.
    """

    def __init__(self, rig: Rig, plant: Plant, bus: Bus) -> None:
        self.rig, self.plant, self.bus = rig, plant, bus
        self._unsent: list[Frame] = []
        self.drives = {motor: SimulatedDrive(rig, motor, plant.shafts[motor], self._unsent.append) for motor in MOTORS}
        self._check_at, self._lost = 0, False

    def _flush(self) -> None:
        """Send what the drives have to say, all at once."""
        if self._unsent:
            self.bus.send_all(self._unsent)
            self._unsent.clear()

    def switch_on(self) -> None:
        """Switch all drives' power on, or off and on again: they boot, motors without current."""
        now = time.monotonic_ns()
        for drive in self.drives.values():
            drive.power_on(now)
        self._flush()

    def run_until(self, deadline: int, slices: int) -> str:
        """Serve the bus until `deadline` (steady ns), and turn the motors by `slices`, the last of which ends then.

        Returns
        -------
        str
            What a person should know about the bus now, mostly nothing.

        Raises
        ------
        Diverged
            Where the motors are a model's and it cannot go on.
        """
        begin, done = deadline - slices * self.plant.slice_ns, 0
        while done < slices:
            come = self._wait(deadline)
            now = time.monotonic_ns()
            due = min(slices, (now - begin) // self.plant.slice_ns)
            if due > done:  # up to where the frames find them
                for drive in self.drives.values():
                    drive.run(begin + due * self.plant.slice_ns)
                self.plant.advance(due - done)
                done = due
            for can_id, data in come:
                for drive in self.drives.values():
                    drive.receive(can_id, data, now)
            for drive in self.drives.values():
                drive.watch(now)
            self._flush()
        return self._restore_bus()

    def close(self) -> None:
        """Close the bus."""
        self.bus.close()

    def _wait(self, until: int) -> list[tuple[int, bytes]]:
        """Wait for frames until then; what has come, but not more than can be answered in time."""
        now = time.monotonic_ns()
        message = self.bus.receive_any(max(0, until - now) * 1e-9)
        if message is None:
            left = until - time.monotonic_ns()
            if left > 0:
                time.sleep(min(left, 1_000_000) * 1e-9)  # a bus that is down says at once that nothing came
            return []
        come = []
        for _ in range(MOST_AT_ONCE):
            if not (message.is_error_frame or message.is_extended_id or message.is_remote_frame):
                come.append((message.arbitration_id, bytes(message.data)))
            if (message := self.bus.receive_any(0.0)) is None:
                break
        return come

    def _restore_bus(self) -> str:
        """Try to open a bus again that is lost; what there is to say of it."""
        now = time.monotonic_ns()
        if now < self._check_at:
            return ""
        self._check_at = now + CHECK_EVERY
        health = self.bus.health()
        if health.state is not BusState.LOST:
            return ""
        first, self._lost = not self._lost, True
        config = self.rig.config
        try:
            found = open_bus(config.interface, config.channel, config.bitrate)
        except ArtibotError:
            return f"bus {config.channel} is lost ({health.reason}): the drives receive nothing" if first else ""
        self.bus.close()
        self.bus, self._lost = found, False
        return f"bus {config.channel} is there again"


def drive_states(drives: Mapping[str, SimulatedDrive]) -> str:
    """Their states in words, those that agree together: ``all operation enabled``."""
    motors: dict[str, list[str]] = {}
    for motor, drive in drives.items():
        motors.setdefault(drive.state.name.lower().replace("_", " "), []).append(motor)
    if len(motors) == 1:
        return f"all {next(iter(motors))}"
    return "; ".join(f"{', '.join(names)} {state}" for state, names in motors.items())


def drive_config(robot: str, params: str = "driver", interface: str = "", channel: str = "") -> DriverConfig:
    """The driver's parameters as the simulated drives take them.

    Parameters
    ----------
    robot : str
        The simulated one, whatever stands in the parameters: its motors are those that the drives turn.
    params : str
        A shipped parameter file's name, or a path.
    interface, channel : str
        Instead of those in the file, where not empty; a channel alone says which interface it is of.
    """
    config = load_config(params)
    if channel:
        interface = interface_of(channel, interface)
    return replace(config, robot=robot, interface=interface or config.interface, channel=channel or config.channel)


def open_drive_loop(rig: Rig, plant: Plant) -> DriveLoop:
    """Open the rig's bus and put its drives there, not yet switched on.

    Raises
    ------
    ArtibotError
        When the bus cannot be opened, with the mend.
    """
    config = rig.config
    return DriveLoop(rig, plant, open_bus(config.interface, config.channel, config.bitrate))
