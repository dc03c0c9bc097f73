"""``artibot sim`` and ``ros2 run artibot_sim sim``: the command line of the simulation node."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import click

from artibot_sim.exchange.own_effects import effects_option
from artibot_sim.nodes.common.options import Optional, parameter_files
from artibot_sim.nodes.common.process import node_main
from artibot_sim.nodes.plain import run_sim

OPTIONS = {
    "robot": "robot",
    "kappa": "kappa",
    "rate": "rate",
    "integrator": "integrator",
    "dt": "dt",
    "publish_rate": "publish_rate",
    "seed": "seed",
    "ground": "ground",
    "duration": "duration",
    "front_mode": "front_mode",
    "command_source": "command_source",
    "wait_for_profile": "wait_for_profile",
    "with_driver": "with_driver",
    "driver_params": "driver_params",
    "interface": "bus.interface",
    "channel": "bus.channel",
    "stats": "stats",
}
"""Option of the command line → parameter of the node."""


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@effects_option
@click.option("--robot", type=Optional(str), help="Robot: agriq, epiq, husky, or a robot file.  [default: agriq]")
@click.option(
    "--kappa", type=Optional(float), help="Front share of the traction torque, in (0, 1].  [default: robot's]"
)
@click.option("--rate", type=Optional(float), help="Simulated over real time; 0: as fast as it goes.  [default: 1]")
@click.option("--integrator", help="rk4 or semi_implicit.  [default: rk4]")
@click.option("--dt", type=float, help="Integration step, s.  [default: 0.001]")
@click.option("--publish-rate", type=float, help="Publications per simulated second, Hz.  [default: 100]")
@click.option("--seed", type=int, help="Seed of the sensor noise.  [default: 0]")
@click.option(
    "--ground", metavar="FILE|random:SEED", help="Uneven ground: .yaml, .npy, .tif, or drawn.  [default: flat]"
)
@click.option("--start", type=float, nargs=3, metavar="X Y YAW", help="Pose at the start, m m rad.  [default: 0 0 0]")
@click.option("--duration", type=float, help="End after so much simulated time, s.  [default: never]")
@click.option("--front-mode", help="prescribed or driven.  [default: prescribed]")
@click.option("--command-source", help="auto, none, or some of live,profile,cmd_vel, the ruling one first.")
@click.option("--wait-for-profile/--no-wait-for-profile", default=None, help="Hold the time until a command comes.")
@click.option("--with-driver/--without-driver", default=None, help="Let drives on a CAN bus turn the rover.")
@click.option("--driver-params", metavar="FILE", help="The driver's parameters: a path, or a name.  [default: driver]")
@click.option("--interface", help="python-can's name of the CAN interface.  [default: by the channel]")
@click.option("--channel", help="CAN channel: vcan0, can0, ws://….  [default: that in the driver's parameters]")
@click.option(
    "--params", multiple=True, metavar="FILE", help="Parameter file: a path, or a shipped one by name (sim_noisy)."
)
@click.option("--stats", type=click.Path(dir_okay=False), help="Write lateness and CPU share to this JSON file.")
@click.pass_obj
def command(
    ros_args: list[str] | None, start: tuple[float, float, float] | None, params: tuple[str, ...], **given: Any
) -> int:
    """Simulate a rover as a ROS 2 node.

    It listens to planned/front_velocity (with planned/odom as sign of life), motor_command_request and cmd_vel,
    and publishes odom, ground_truth/odom, joint_states, motor_torques, motor_command and more. With --with-driver
    four simulated CiA 402 drives on a CAN bus turn it, and a driver node commands them. Every option is also a ROS
    parameter, and there are more of those: ros2 param describe, or config/sim.yaml.

    \b
    Examples:
      artibot sim --robot agriq
      artibot sim --rate 0 --wait-for-profile --duration 60
      artibot sim --robot epiq --params sim_noisy --ros-args -r __ns:=/rover1
      artibot sim --ground random:7
      artibot sim --with-driver --channel vcan0
    """
    overrides = {OPTIONS[name]: value for name, value in given.items() if value is not None}
    if start is not None:
        overrides |= dict(zip(("start.x", "start.y", "start.yaw"), start, strict=True))
    return run_sim(overrides, [*parameter_files(params), *(ros_args or [])])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (by default the process's own) and return the exit status."""
    return node_main(command, "sim", argv)


if __name__ == "__main__":
    sys.exit(main())
