"""What moves the simulated rover: commands heard on topics, or drives on a CAN bus."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Protocol

from rclpy.node import Node

from artibot_driver.priority import take_priority
from artibot_driver.rig import load_rig
from artibot_sim.model import Robot
from artibot_sim.nodes import sim_settings
from artibot_sim.nodes.drives.loop import drive_config, drive_states, open_drive_loop
from artibot_sim.nodes.drives.motors import RoverShafts
from artibot_sim.nodes.inputs import Inputs
from artibot_sim.nodes.sim_engine import Engine, Sample, Timing
from artibot_sim.nodes.sim_sensors import Sensors

Settings = Mapping[str, Any]


class Mover(Protocol):
    """A rover that goes on by a publish period at a time."""

    t_ns: int
    """What the time is, in that of the stamps; the node sets it."""
    runs_on: str
    """Why its time cannot be stopped, or empty."""

    @property
    def heard(self) -> bool:
        """Whether a command has been accepted since the start or the last reset."""

    def describe(self) -> str:
        """For the log, what it waits for."""

    def adopt(self, settings: Settings) -> None:
        """Go by these parameters from now on."""

    def stop_time(self, stopped: bool) -> None:
        """The simulation stands still from now on, or goes on."""

    def wait(self, seconds: float) -> None:
        """Until the next publication is due; at once where that is over."""

    def step(self) -> Sample:
        """The truth now; raises Diverged."""

    def reset(self) -> None:
        """Back to the start, at rest, all commands forgotten."""

    def close(self) -> None:
        """The end."""


class CommandedMover:
    """Moved by commands on topics: a rollout a period."""

    runs_on = ""

    def __init__(self, node: Node, robot: Robot, timing: Timing, settings: Settings) -> None:
        self._robot, self._timing, self._kappa = robot, timing, float(settings["kappa"])
        driven = settings["front_mode"] == "driven"
        self._engine = Engine(robot, timing, sim_settings.start(settings), settings["integrator"], driven)
        self._engine.warm_up()  # before anybody can see a subscription and send what would then be late
        self._inputs = Inputs(node, sim_settings.rules(settings, robot), settings["cmd_vel_stamped"])

    @property
    def t_ns(self) -> int:
        """What the time is."""
        return self._inputs.t_ns

    @t_ns.setter
    def t_ns(self, t_ns: int) -> None:
        self._inputs.t_ns = t_ns

    @property
    def heard(self) -> bool:
        """Whether a command has been accepted."""
        return self._inputs.heard

    def describe(self) -> str:
        """For the log."""
        return f"at kappa {self._kappa:g}"

    def adopt(self, settings: Settings) -> None:
        """Go by these parameters from now on."""
        self._kappa, self._inputs.rules = settings["kappa"], sim_settings.rules(settings, self._robot)

    def stop_time(self, stopped: bool) -> None:
        """Silence does not count while the simulation stands still."""
        self._inputs.stop_time(stopped)

    def wait(self, seconds: float) -> None:
        """Sleep, then hear what has come."""
        time.sleep(max(0.0, seconds))
        self._inputs.take()

    def step(self) -> Sample:
        """The truth now, under the commands for the period that begins."""
        return self._engine.step(self._inputs.decide(self._timing.knot_ns, self._timing.knots), self._kappa)

    def reset(self) -> None:
        """Back to the start, all commands forgotten."""
        self._engine.reset()
        self._inputs.drop(self._engine.front_position)

    def close(self) -> None:
        """Nothing to close."""


class DrivenMover:
    """Turned by four simulated drives on a CAN bus, which a driver commands."""

    runs_on = "its drives live in real time, like a real rover's"
    heard = True

    def __init__(self, node: Node, robot: Robot, timing: Timing, settings: Settings, sensors: Sensors) -> None:
        sim_settings.check_drives(settings)
        get = settings.__getitem__
        self._shafts = RoverShafts(robot, timing, sim_settings.start(settings), get("integrator"), sensors)
        self._shafts.warm_up()
        rig = load_rig(drive_config(get("robot"), get("driver_params"), get("bus.interface"), get("bus.channel")))
        self._loop = open_drive_loop(rig, self._shafts)
        self._priority = get("realtime_priority")
        self._slices = timing.period_ns // self._shafts.slice_ns
        self._log, self._said, self.t_ns = node.get_logger(), "", 0

    def describe(self) -> str:
        """For the log."""
        config = self._loop.rig.config
        return f"for a driver, its drives on {config.interface} {config.channel}"

    def adopt(self, settings: Settings) -> None:
        """Nothing here is changed by the node's live parameters: they are for commands by topic."""

    def stop_time(self, stopped: bool) -> None:
        """Switch the drives on: once, for their time never stands."""
        if stopped:
            return
        if reason := take_priority(self._priority):
            self._log.info(f"no real-time priority ({reason}): a busy machine may delay the drives")
        self._loop.switch_on()

    def wait(self, seconds: float) -> None:
        """Serve the bus and turn the motors until the publication is due."""
        notice = self._loop.run_until(time.monotonic_ns() + round(seconds * 1e9), self._slices)
        if notice:
            self._log.warning(notice)
        states = drive_states(self._loop.drives)
        if states != self._said:
            self._log.info(f"drives: {states}")
            self._said = states

    def step(self) -> Sample:
        """The truth now."""
        return self._shafts.sample()

    def reset(self) -> None:
        """Back to the start, at rest, the drives' power off and on again."""
        self._loop.switch_on()
        self._shafts.reset()

    def close(self) -> None:
        """Leave the bus."""
        self._loop.close()
