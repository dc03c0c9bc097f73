"""`artibot robot`: robot files from what a data sheet says."""

from __future__ import annotations

from pathlib import Path

import click


@click.group("robot")
def command() -> None:
    """Robot files: write one for another robot from what its data sheet says.

    \b
    Example:
      artibot robot new warthog --like husky --mass 260 --radius 0.30 --track 1.136 --wheelbase 0.915
    """


@command.command("new")
@click.argument("name")
@click.option("--like", required=True, metavar="ROBOT", help="Robot that it is most like: a name or a robot file.")
@click.option("--mass", type=float, help="Of the whole robot with its wheels, kg.")
@click.option("--radius", type=float, help="Of a wheel, m.")
@click.option("--track", type=float, help="From the middle of the left wheels to that of the right ones, m.")
@click.option("--wheelbase", type=float, help="From a module's front axle to its rear axle, m.")
@click.option("--wheel-mass", type=float, help="Of one wheel, kg [a share of the mass as in the other robot].")
@click.option("--ratio", type=float, help="Speed of the wheels over that of the motors; 1 if wheels were recorded.")
@click.option(
    "--stall-torque", type=float, help="Of a motor at rest at full supply, N m; falls to none at --no-load-speed."
)
@click.option("--no-load-speed", type=float, help="Of a motor without a load at full supply, rad/s.")
@click.option("--no-load-torque", type=float, help="That a gear takes of its motor whatever it carries, N m.")
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), help="File to write [NAME.yaml].")
@click.option("--force", is_flag=True, help="Replace a file that exists.")
def new(name: str, like: str, out: Path | None, force: bool, **sheet: float | None) -> None:
    """Write a robot file NAME.yaml: what is given, and the rest scaled from another robot with wide intervals.

    `identify` and `diagnose` take the intervals as what is known beforehand. A number that you know better goes into
    the file by hand, with its source and its ci95.
    """
    from rich.console import Console
    from rich.table import Column, Table

    from artibot_sim.errors import ArtibotError
    from artibot_sim.model import load_robot, save_robot
    from artibot_sim.model.robot.similar import DataSheet, similar, uncertain

    path = out or Path(f"{name}.yaml")
    if path.exists() and not force:
        raise ArtibotError(f"{path}: exists already; give another --out, or --force to replace it")
    robot = similar(load_robot(like), name, DataSheet(**sheet))
    save_robot(robot, path)
    load_robot(path)  # what was written can be read
    table = Table(Column("least known", no_wrap=True), "value", "95 %", "unit", box=None, header_style="bold")
    for key, spec, value, (low, high) in uncertain(robot)[:8]:
        table.add_row(key, f"{value:.3g}", f"{low:.3g} … {high:.3g}", spec.unit)
    console = Console(highlight=False)
    console.print(table)
    console.print(f"wrote {path}", soft_wrap=True)
