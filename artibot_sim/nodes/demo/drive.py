"""The demo's drive: over CAN, with a driver and simulated drives, or by topics for a robot without drives' data."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.child_processes import Child, ChildFailed, ChildProcesses
from artibot_sim.resources import local_environment

if TYPE_CHECKING:
    from artibot_sim.model import Robot
    from artibot_sim.nodes.demo.echo import Steps
    from artibot_sim.planning import Plan

START: Final = 60.0
"""How long a node may take until it is ready, s: compiling the model the first time is most of it."""
DRIVE: Final = 180.0
"""How long the drive may take, s of real time."""
SIM_OPTIONS: Final = ("--rate", "3", "--wait-for-profile", "--params", "sim_patient")
"""Three times real time, for at full speed the planner's pose (50 Hz of simulated time) could not keep up."""
DRIVER_OPTIONS: Final = ("--ros-args", "-p", "command_timeout:=1.0")
"""A busy machine may hold the planner up; ordinarily a driver waits 0.1 s for its sign of life."""
READY: Final = "is ready "
ENABLED: Final = "[driver]: enabled"
VCAN: Final = "vcan0"
LISTEN: Final = 0.2
"""A bus on which nothing is sent for so long is free, s: drives and drivers send heartbeats more often."""
SIMULATED: Final = ("/ground_truth/odom", "/odom", "/joint_states", "/motor_torques", "/motor_command")


class DemoSettings(NamedTuple):
    """What is to be shown."""

    robot: Robot
    robot_name: str
    kappa: float
    manoeuvre: str
    plan: Plan
    out: Path
    domain: int

    @property
    def recording(self) -> Path:
        """The drive's recording."""
        return self.out / self.manoeuvre

    @property
    def environment(self) -> dict[str, str]:
        """What keeps the demo's nodes among themselves."""
        return {"ROS_DOMAIN_ID": str(self.domain), **local_environment()}

    @property
    def about(self) -> list[str]:
        """Options that most commands take."""
        return ["--robot", self.robot_name, "--kappa", f"{self.kappa:g}"]


def has_drives(robot: Robot) -> bool:
    """Whether a robot's file says enough of its motors for four CiA 402 drives."""
    back = robot.drive.back
    return back is not None and math.isfinite(robot.drive.front.rated_torque) and math.isfinite(back.rated_torque)


def is_free(channel: str) -> bool:
    """Whether a SocketCAN interface is there, up, and silent."""
    from artibot_driver.bus import open_bus

    try:
        with open_bus("socketcan", channel) as bus:
            return bus.receive(LISTEN) is None
    except ArtibotError:
        return False


def begin(
    children: ChildProcesses,
    steps: Steps,
    name: str,
    words: Sequence[str],
    *,
    stays: bool = False,
    note: Callable[[], str] = str,
) -> Child:
    """Begin a step that is an ``artibot`` command."""
    steps.begin(name, shlex.join(["artibot", *words]), note)
    return children.start(*words, stays=stays)


def drive_over_can(settings: DemoSettings, children: ChildProcesses, steps: Steps, channel: str) -> None:
    """Planner, driver, CAN bus, drives, model and back: a process each, as in a terminal each.

    Parameters
    ----------
    channel : str
        A bus that is there; empty to begin with one between processes.
    """
    bus = None
    if not channel:
        bus = begin(children, steps, "CAN bus", ["can", "loopback"], stays=True)
        children.wait(bus, lambda: "ws://" in bus.output, START, "listening", steps.tick)
        channel = next(word for word in bus.output.split() if word.startswith("ws://"))
        steps.done(f"between processes, for this kernel has no {VCAN} that is free")

    words = ["sim", "--robot", settings.robot_name, "--with-driver", "--channel", channel]
    sim = begin(children, steps, "Simulator, with four CiA 402 drives", words, stays=True)
    children.wait(sim, lambda: READY in sim.output, START, "ready", steps.tick)
    steps.done("the drives are on the bus; their shafts are the model's motors")

    words = ["driver", *settings.about, "--channel", channel, "--enable", *DRIVER_OPTIONS]
    driver = begin(children, steps, "Driver", words, stays=True)
    children.wait(driver, lambda: ENABLED in driver.output, START, "driving", steps.tick)
    steps.done("has set the drives up and enabled them")

    record = _record(settings, children, steps)
    words = ["planner", settings.manoeuvre, "--robot", settings.robot_name, "--start-delay", "2"]
    planner = begin(children, steps, "Planner", words, note=lambda: _how_far(planner))
    children.wait_for_end(planner, START + DRIVE, steps.tick)
    for child in (record, driver, sim, *([bus] if bus else [])):
        children.stop(child)
    _say_recorded(record, steps)


def drive_by_topics(settings: DemoSettings, children: ChildProcesses, steps: Steps) -> None:
    """Planner and simulator alone, at three times real time."""
    words = ["sim", *settings.about, *SIM_OPTIONS]
    sim = begin(children, steps, "Simulator", words, stays=True)
    children.wait(sim, lambda: READY in sim.output, START, "ready", steps.tick)
    steps.done("waits for a profile; time will run at three times its pace")

    record = _record(settings, children, steps)
    words = ["planner", settings.manoeuvre, "--robot", settings.robot_name, "--use-sim-time", "--start-delay", "3"]
    planner = begin(children, steps, "Planner", words, note=lambda: _how_far(planner))
    children.wait_for_end(planner, START + DRIVE, steps.tick)
    children.stop(sim)
    children.stop(record)
    _say_recorded(record, steps)


def _record(settings: DemoSettings, children: ChildProcesses, steps: Steps) -> Child:
    words = ["record", "--robot", settings.robot.name, *settings.about[2:], "--out", str(settings.recording)]
    record = begin(children, steps, "Recorder", words, stays=True)
    children.wait(record, lambda: _records(record), START, f"recording {', '.join(SIMULATED)}", steps.tick)
    steps.done("has found the rover's topics")
    return record


def _say_recorded(record: Child, steps: Steps) -> None:
    messages = re.findall(r"(\d+) messages of (\d+) topics", record.output)
    if not messages:
        raise ChildFailed(record, "did not say what it recorded")
    steps.done(f"the rover has driven; {messages[-1][0]} messages of {messages[-1][1]} topics are recorded")


def _records(record: Child) -> bool:
    """Whether the recorder has found all that the rover publishes."""
    output = record.output
    return all(f"recording {topic} [" in output for topic in SIMULATED)


def _how_far(planner: Child) -> str:
    """Return how far the drive is, from the planner's log."""
    said = re.findall(r"\d+ of \d+ s$", planner.output, re.MULTILINE)
    return str(said[-1]) if said else ""
