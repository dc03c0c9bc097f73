"""``artibot driver`` and ``ros2 run artibot_sim driver``: the command line of the driver node."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import click

from artibot_sim.nodes.common.options import Optional, parameter_files
from artibot_sim.nodes.common.process import LoopNode, built, node_main, run_loop
from artibot_sim.resources import local_environment

OPTIONS = {
    "robot": "robot",
    "kappa": "kappa",
    "law": "law",
    "interface": "bus.interface",
    "channel": "bus.channel",
    "eds": "eds",
    "command_source": "command_source",
    "enable": "enable_on_start",
    "configure": "autoconfigure",
    "stats": "stats",
}
"""Option of the command line → parameter of the node."""


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option("--robot", help="Robot: agriq, epiq, or the path of a robot file.  [default: agriq]")
@click.option("--kappa", type=Optional(float), help="Front share of the traction torque, 0.622 to 1 for Agri.q.")
@click.option("--law", help="Torque-sharing law, see `artibot actuate --list`.  [default: constant, eq. 30]")
@click.option("--interface", help="python-can's interface: socketcan, remote, …  [default: by the channel]")
@click.option("--channel", help="Its channel: can0, vcan0, ws://127.0.0.1:PORT/.  [default: vcan0]")
@click.option("--eds", help="Object dictionary of the drives: drive, or the path of an EDS file.  [default: drive]")
@click.option("--command-source", help="auto, none, or some of live,profile,cmd_vel, the ruling one first.")
@click.option("--enable/--wait", default=None, help="Enable the drives as soon as they are there.  [default: wait]")
@click.option("--configure/--unconfigured", default=None, help="Open the bus at the start.  [default: configure]")
@click.option(
    "--params", multiple=True, metavar="FILE", help="Parameter file: a path, or a shipped one by name (driver)."
)
@click.option("--stats", type=click.Path(dir_okay=False), help="Write lateness and CPU share to this JSON file.")
@click.pass_obj
def command(ros_args: list[str] | None, params: tuple[str, ...], **given: Any) -> int:
    """Drive a rover, a real or a simulated one, over CAN.

    It listens to planned/front_velocity (with planned/odom as sign of life), motor_command_request and cmd_vel, leads
    four CiA 402 drives, and publishes odom, joint_states, motor_torques, motor_command and /diagnostics. Nothing moves
    before the drives were enabled: by the service ~/enable, the lifecycle's activate, or --enable. Every option is
    also a ROS parameter, and there are more of those: ros2 param describe, or config/driver.yaml.

    \b
    Examples:
      artibot driver --channel can0 --params my_rover.yaml
      artibot driver --kappa 0.8 --enable
      artibot driver --law by_curvature:turn=0.7
      artibot driver --channel ws://127.0.0.1:54701/     (a bus of `artibot can loopback`)
      ros2 service call /driver/enable std_srvs/srv/Trigger
    """
    overrides = {OPTIONS[name]: value for name, value in given.items() if value is not None}
    if given["channel"] and not given["interface"]:
        from artibot_driver.listener import interface_of

        overrides["bus.interface"] = interface_of(given["channel"])
    return run(overrides, [*parameter_files(params), *(ros_args or [])])


TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
"""Variable in which Fast DDS finds what it speaks over."""


def run(overrides: dict[str, Any], ros_args: Sequence[str] = ()) -> int:
    """Run the node until it ends; return the exit status.

    SIGINT and SIGTERM end it with status 0, after a ramp to standstill. Unless TRANSPORTS is set, the process speaks
    over UDP alone: a node that is killed leaves its part of shared memory in disorder, and whoever goes on reading it
    may end with corrupted memory. A driver must outlast any other node. With ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
    rmw_fastrtps would choose transports itself, shared memory among them; a profile that is as local stands in for it.

    Raises
    ------
    ArtibotError
        When a parameter, the robot or the bus is refused.
    """

    if not os.environ.get(TRANSPORTS):
        os.environ[TRANSPORTS] = "UDPv4"
        if os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST":
            os.environ.update(local_environment())

    def make(asked: list[int]) -> LoopNode:
        from artibot_sim.nodes.driver.node import DriverNode

        return built(DriverNode, overrides, asked)

    return run_loop("driver", ros_args, make)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (by default the process's own) and return the exit status."""
    return node_main(command, "driver", argv)


if __name__ == "__main__":
    sys.exit(main())
