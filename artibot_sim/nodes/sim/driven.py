"""A simulated rover whose motors drives on a CAN bus turn; apart, for only this needs the CAN libraries."""

from __future__ import annotations

import time

from rclpy.node import Node

from artibot_driver.cia402 import DriveState
from artibot_driver.rig import load_rig
from artibot_sim.model import Robot
from artibot_sim.nodes.drives.loop import drive_config, drive_states, open_drive_loop
from artibot_sim.nodes.drives.motors import RoverShafts
from artibot_sim.nodes.sim import parameters
from artibot_sim.nodes.sim.actuation import Settings
from artibot_sim.nodes.sim.engine import Periods, TrueState
from artibot_sim.nodes.sim.sensors import SimulatedSensors


class DrivenActuation:
    """Turned by four simulated drives on a CAN bus, which a driver commands."""

    runs_on = "its drives live in real time, like a real rover's"
    has_command = True

    def __init__(
        self, node: Node, robot: Robot, timing: Periods, settings: Settings, sensors: SimulatedSensors
    ) -> None:
        parameters.check_drives(settings)
        get = settings.__getitem__
        start, ground = parameters.start(settings), parameters.ground(settings)
        self._shafts = RoverShafts(robot, timing, start, get("integrator"), sensors, ground)
        self._shafts.warm_up()
        rig = load_rig(drive_config(get("robot"), get("driver_params"), get("bus.interface"), get("bus.channel")))
        self._loop = open_drive_loop(rig, self._shafts)
        self._slices = timing.period_ns // self._shafts.slice_ns
        self._log, self.t_ns = node.get_logger(), 0
        self._states: list[DriveState] = []

    def describe(self) -> str:
        """For the log."""
        config = self._loop.rig.config
        return f"for a driver, its drives on {config.interface} {config.channel}"

    def adopt(self, settings: Settings) -> None:
        """Nothing here is changed by the node's live parameters: they are for commands by topic."""

    def stop_time(self, stopped: bool) -> None:
        """Switch the drives on: once, for their time never stands."""
        if not stopped:
            self._loop.switch_on()

    def wait(self, seconds: float) -> None:
        """Serve the bus and turn the motors until the publication is due."""
        notice = self._loop.run_until(time.monotonic_ns() + round(seconds * 1e9), self._slices)
        if notice:
            self._log.warning(notice)
        states = [drive.state for drive in self._loop.drives.values()]
        if states != self._states:
            self._log.info(f"drives: {drive_states(self._loop.drives)}")
            self._states = states

    def step(self) -> TrueState:
        """The truth now."""
        return self._shafts.sample()

    def reset(self) -> None:
        """Back to the start, at rest, the drives' power off and on again."""
        self._loop.switch_on()
        self._shafts.reset()

    def close(self) -> None:
        """Leave the bus."""
        self._loop.close()
