"""``artibot planner`` and ``ros2 run artibot_sim planner``: the command line of the planner node."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import click

from artibot_sim.nodes.common.process import node_main
from artibot_sim.nodes.plain import run_planner


def _show_list(context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    """Print the shipped manoeuvres and end."""
    if not wanted:
        return
    from artibot_sim.planning import load_manoeuvre, manoeuvre_names

    for name in manoeuvre_names():
        click.echo(click.wrap_text(f"{name:14}{load_manoeuvre(name).description}", 100, subsequent_indent=" " * 14))
    context.exit(0)


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.argument("name", metavar="[MANOEUVRE]", required=False)
@click.option("--manoeuvre", help="A shipped manoeuvre by name, or the path of a YAML file.  [default: table6_agriq]")
@click.option("--robot", help="Robot: agriq, epiq, husky, or the path of a robot file.  [default: agriq]")
@click.option("--start", type=float, nargs=3, metavar="X Y YAW", help="Pose at the start, m m rad.  [default: 0 0 0]")
@click.option("--start-delay", type=float, help="How long after its publication the profile starts, s.  [default: 1]")
@click.option("--rate", type=float, help="Rate of planned/odom, Hz.  [default: 50]")
@click.option("--wait-for", help="follower: a simulator or driver; anyone: a recorder, too.  [default: follower]")
@click.option("--subscriber-timeout", type=float, help="Wait so long for them, s; 0: do not wait.  [default: 120]")
@click.option("--tail", type=float, help="How long planned/odom goes on after the end, s.  [default: 0.5]")
@click.option(
    "--keep/--end", default=None, help="Stay after the end, so that late subscribers still get path and profile."
)
@click.option("--use-sim-time/--use-wall-time", default=None, help="Take the time from /clock.  [default: wall time]")
@click.option("--list", is_flag=True, callback=_show_list, expose_value=False, help="List the shipped manoeuvres.")
@click.pass_obj
def command(
    ros_args: list[str] | None, name: str | None, start: tuple[float, float, float] | None, **given: Any
) -> int:
    """Plan a manoeuvre and publish its path and front motor velocities.

    It waits for a simulator or driver that listens to planned/front_velocity, publishes the profile with its start
    a little ahead, and planned/odom until it is over. Every option is also a ROS parameter, and there are more of
    those: ros2 param describe.

    \b
    Examples:
      artibot planner table6_agriq
      artibot planner --manoeuvre my_test.yaml --robot epiq --keep
      artibot planner slalom --use-sim-time --ros-args -r __ns:=/rover1
    """
    if name is not None:
        if given["manoeuvre"] is not None:
            raise click.UsageError("the manoeuvre stands twice; give it as argument or with --manoeuvre")
        given["manoeuvre"] = name
    overrides = {key: value for key, value in given.items() if value is not None}
    if start is not None:
        overrides |= dict(zip(("start.x", "start.y", "start.yaw"), start, strict=True))
    return run_planner(overrides, ros_args or [])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (by default the process's own) and return the exit status."""
    return node_main(command, "planner", argv)


if __name__ == "__main__":
    sys.exit(main())
