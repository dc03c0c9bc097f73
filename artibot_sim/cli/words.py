"""The words of the command line: what ``artibot --help`` lists and which executables ``ros2 run`` finds.

Plain data that imports nothing: ``setup.py`` reads it before anything is installed.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Word(NamedTuple):
    """One command: where it lives, as ``module:name``, and its line in the help."""

    target: str
    help: str


COMMANDS: Final[dict[str, Word]] = {
    "sim": Word("artibot_sim.nodes.sim.command:main", "Simulate a rover as a ROS 2 node."),
    "planner": Word("artibot_sim.nodes.planner.command:main", "Plan a manoeuvre, publish its path and wheel speeds."),
    "driver": Word("artibot_sim.nodes.driver.command:main", "Drive a rover, real or simulated, over CAN."),
    "drives": Word("artibot_sim.nodes.drives.command:main", "Simulate four CiA 402 drives on a CAN bus, without ROS."),
    "odometry": Word("artibot_sim.nodes.odometry.command:main", "Say where a rover is, through its model."),
    "record": Word("artibot_sim.nodes.record.command:main", "Record topics to a bag that survives a crash."),
    "replay": Word("artibot_sim.nodes.replay.command:main", "Publish a recording again, or feed it to the model."),
    "recover": Word("artibot_sim.cli.recover:command", "Mend a recording that was cut off."),
    "inspect": Word("artibot_sim.cli.inspect:command", "Show what is in a recording and what it is good for."),
    "export": Word("artibot_sim.cli.export:command", "Write a recording as tables, or a robot for other programs."),
    "import": Word("artibot_sim.cli.import_:command", "Make a recording of CSV files, or of a bag with other names."),
    "can": Word("artibot_sim.cli.can:command", "Decode recorded CAN frames; a DBC, a loopback bus."),
    "plot": Word("artibot_sim.cli.plot:command", "Draw a recording, to PNG or an HTML page."),
    "view": Word("artibot_sim.nodes.view.command:main", "See a recording or a running rover in 3D, in the browser."),
    "robot": Word("artibot_sim.cli.robot:command", "Write a robot file from what a data sheet says."),
    "effects": Word("artibot_sim.cli.effects:command", "List effects; give a law that was found a name."),
    "urdf": Word("artibot_sim.cli.urdf:command", "Write a robot file as URDF, for viewers."),
    "check": Word("artibot_sim.cli.check:command", "Say what is wrong with recordings, in seconds."),
    "identify": Word("artibot_sim.cli.identify:command", "Identify soil and geometry from recordings."),
    "diagnose": Word("artibot_sim.cli.diagnose:command", "Find what the simulation gets wrong, and why."),
    "sweep": Word("artibot_sim.cli.sweep:command", "Simulate a grid or hypercube of parameters."),
    "report": Word("artibot_sim.cli.report:command", "Draw a page from results that exist."),
    "reproduce": Word("artibot_sim.cli.reproduce:command", "Reproduce the paper's figures and tables, as a page."),
    "actuate": Word("artibot_sim.cli.actuate:command", "Compare laws that share the torque between the modules."),
    "bench": Word("artibot_sim.cli.bench:command", "Measure the speed of the model and the commands."),
    "demo": Word("artibot_sim.nodes.demo.command:main", "Plan, drive, record, replay and plot the paper's trajectory."),
}
"""Word → :class:`Word`. A target is a click command, or a ``main(argv) -> int`` for what also takes ``--ros-args``."""
