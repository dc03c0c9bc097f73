"""What moves the simulated rover: the interface, and commands on topics. Drives on a CAN bus are in `driven`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Protocol

from rclpy.node import Node

from artibot_sim.model import Robot
from artibot_sim.nodes.common.inputs import CommandInputs
from artibot_sim.nodes.sim import parameters
from artibot_sim.nodes.sim.engine import Engine, Periods, TrueState

Settings = Mapping[str, Any]


class Actuation(Protocol):
    """A rover that goes on by a publish period at a time."""

    t_ns: int
    """What the time is, in that of the stamps; the node sets it."""
    runs_on: str
    """Why its time cannot be stopped, or empty."""

    @property
    def has_command(self) -> bool:
        """Whether a command has been accepted since the start or the last reset."""

    def describe(self) -> str:
        """For the log, what it waits for."""

    def adopt(self, settings: Settings) -> None:
        """Go by these parameters from now on."""

    def stop_time(self, stopped: bool) -> None:
        """The simulation stands still from now on, or goes on."""

    def wait(self, seconds: float) -> None:
        """Until the next publication is due; at once where that is over."""

    def step(self) -> TrueState:
        """The truth now; raises Diverged."""

    def reset(self) -> None:
        """Back to the start, at rest, all commands forgotten."""

    def close(self) -> None:
        """The end."""


class CommandedActuation:
    """Moved by commands on topics: a rollout a period."""

    runs_on = ""

    def __init__(self, node: Node, robot: Robot, timing: Periods, settings: Settings) -> None:
        self._robot, self._timing, self._kappa = robot, timing, float(settings["kappa"])
        driven = settings["front_mode"] == "driven"
        start, ground = parameters.start(settings), parameters.ground(settings)
        self._engine = Engine(robot, timing, start, settings["integrator"], driven, ground)
        self._engine.warm_up()  # before anybody can see a subscription and send what would then be late
        self._inputs = CommandInputs(node, parameters.rules(settings, robot), settings["cmd_vel_stamped"])

    @property
    def t_ns(self) -> int:
        """What the time is."""
        return self._inputs.t_ns

    @t_ns.setter
    def t_ns(self, t_ns: int) -> None:
        self._inputs.t_ns = t_ns

    @property
    def has_command(self) -> bool:
        """Whether a command has been accepted."""
        return self._inputs.has_command

    def describe(self) -> str:
        """For the log."""
        ground = self._engine.ground
        return f"at kappa {self._kappa:g}" + (f" on the ground {ground.name}" if ground is not None else "")

    def adopt(self, settings: Settings) -> None:
        """Go by these parameters from now on."""
        self._kappa, self._inputs.rules = settings["kappa"], parameters.rules(settings, self._robot)

    def stop_time(self, stopped: bool) -> None:
        """Silence does not count while the simulation stands still."""
        self._inputs.stop_time(stopped)

    def wait(self, seconds: float) -> None:
        """Sleep, then take what has come."""
        time.sleep(max(0.0, seconds))
        self._inputs.take()

    def step(self) -> TrueState:
        """The truth now, under the commands for the period that begins."""
        return self._engine.step(self._inputs.decide(self._timing.knot_ns, self._timing.knots), self._kappa)

    def reset(self) -> None:
        """Back to the start, all commands forgotten."""
        self._engine.reset()
        self._inputs.drop(self._engine.front_position)

    def close(self) -> None:
        """Nothing to close."""
