"""`artibot urdf`: a robot file as URDF, for robot_state_publisher, RViz and Foxglove."""

from __future__ import annotations

from pathlib import Path

import click

from artibot_sim.report.files import OutputFile, write_files


@click.command("urdf")
@click.argument("robot")
@click.option("-o", "--out", type=OutputFile(), help="File to write.  [default: print it]")
def command(robot: str, out: Path | None) -> None:
    """Write a ROBOT (a name or a robot file) as URDF.

    Links and joints are called as in /joint_states and on /tf. Simulator and driver publish the same text as
    robot_description.

    \b
    Examples:
      artibot urdf agriq
      artibot urdf field.yaml --out field.urdf
    """
    from artibot_sim.exchange.urdf import urdf
    from artibot_sim.model import load_robot

    text = urdf(load_robot(robot))
    if out is None:
        click.echo(text, nl=False)
    else:
        write_files({out: text.encode()})
