"""`artibot export`: recordings as tables, robots as what other programs read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from artibot_sim.errors import ArtibotError

if TYPE_CHECKING:
    from artibot_sim.model import Robot
    from artibot_sim.progress import Report

    Writer = Callable[[Mapping[str, Robot], float | None, Report], str]

_TABLES = ("csv", "parquet")
_ROBOTS = {"diff_drive_controller": "yaml", "robot_localization": "yaml", "urdf": "urdf", "sdf": "sdf", "mjcf": "xml",
           "ros2_control": "urdf"}  # fmt: skip
"""Format of a robot → the suffix of its file."""
_SEVERAL = ("diff_drive_controller",)
"""Formats that hold several grounds."""


@click.command("export")
@click.argument("sources", nargs=-1, required=True, metavar="BAG | ROBOT…")
@click.option("--to", "form", required=True, type=click.Choice((*_TABLES, *_ROBOTS)), help="Format to write.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="File, or folder of a recording's tables [by the name]."
)
@click.option("--rate", type=float, help="Recordings: one table at so many rows a second, instead of one a topic.")
@click.option("--all", "everything", is_flag=True, help="Recordings: also topics that artibot does not read.")
@click.option(
    "--topic", "topics", multiple=True, metavar="WANTED=FOUND",
    help="Recordings: read topic FOUND as WANTED; repeatable.",
)  # fmt: skip
@click.option("--namespace", metavar="NAME", help="Recordings: rover whose topics to read, where there are several.")
@click.option("--speed", type=float, help="Robots: speed of the turns that are simulated, m/s [by the robot's size].")
def command(
    sources: tuple[str, ...], form: str, out: Path | None, rate: float | None, everything: bool,
    topics: tuple[str, ...], namespace: str | None, speed: float | None,
) -> None:  # fmt: skip
    """Write a recording as tables, or a robot as other programs read it.

    \b
    csv, parquet           of a recording: one table a topic with its own stamps, or one joined at --rate.
                           SI units, said in the header or the columns' metadata. `artibot import` makes a
                           recording of the former again, by the columns.yaml beside them.
    diff_drive_controller  of robot files: effective track and radii, a section for each ground, with intervals
    robot_localization     of a robot file: parameters of its ekf_node
    ros2_control           of a robot file: URDF with the motors as joints, and beside it the controllers' parameters
    mjcf                   of a robot file: for MuJoCo, friction and softness fitted so that it turns as the model
    urdf, sdf              of a robot file: bodies, joints, and the wheels' friction as Gazebo takes it

    \b
    Examples:
      artibot export run7 --to csv                      # run7_csv/motor_torques.csv, …
      artibot export run7 --to parquet --rate 50 -o run7.parquet
      artibot export husky.db3 --to csv --all --topic /ground_truth/odom=/lidar/odom
      artibot export grass.yaml --to sdf                # grass.sdf
      artibot export grass.yaml --to mjcf               # grass.xml
      artibot export agriq --to ros2_control            # agriq_ros2_control.urdf, agriq_ros2_control.yaml
      artibot export grass.yaml gravel.yaml --to diff_drive_controller -o controllers.yaml
    """
    if form in _TABLES:
        if len(sources) > 1 or speed is not None:
            raise ArtibotError(f"--to {form}: expected one recording, and no --speed")
        _export_recording(Path(sources[0]), form, out, rate, everything, topics, namespace)
        return
    if rate is not None or everything or topics or namespace:
        raise ArtibotError(
            f"--to {form}: is made of a robot; --rate, --all, --topic and --namespace are for recordings"
        )
    _export_robots(sources, form, out, speed)


def _export_robots(sources: tuple[str, ...], form: str, out: Path | None, speed: float | None) -> None:
    from artibot_sim.model import load_robot
    from artibot_sim.progress import Bar
    from artibot_sim.report.files import fault, write_files

    if len(sources) > 1 and form not in _SEVERAL:
        raise ArtibotError(f"--to {form}: expected one robot, found {len(sources)}")
    if speed is not None and not 0.0 < speed < 100.0:
        raise ArtibotError(f"--speed {speed:g}: expected a speed in m/s, greater than 0")
    names = [Path(source).stem for source in sources]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ArtibotError(f"{', '.join(sorted(twice))}: two robot files of one name; rename one, it names the ground")
    grounds = {name: load_robot(source) for name, source in zip(names, sources, strict=True)}
    plain = _ROBOTS[form] != "yaml" and form != "ros2_control"
    target = out or Path(f"{names[0]}.{_ROBOTS[form]}" if plain else f"{names[0]}_{form}.{_ROBOTS[form]}")
    if why := fault(target):
        raise ArtibotError(f"{target}: cannot be written: {why}")
    if form == "ros2_control" and target.suffix == ".yaml":
        raise ArtibotError(f"{target}: is the name of the controllers' file beside the URDF; call the URDF .urdf")
    with Bar() as bar:
        files = {target: _writer(form)(grounds, speed, bar.stage("simulating turns", 1.0))}
    if form == "ros2_control":
        from artibot_sim.exchange.ros2_control import description

        files = {target: description(next(iter(grounds.values()))), target.with_suffix(".yaml"): files[target]}
    write_files({path: text.encode() for path, text in files.items()})
    for path in files:
        click.echo(f"wrote {path}")


def _writer(form: str) -> Writer:
    """Return what makes the text of a format, with only what it needs imported."""
    if form == "urdf":
        from artibot_sim.exchange.urdf import urdf

        return lambda grounds, _, __: urdf(next(iter(grounds.values())), gazebo=True)
    if form == "sdf":
        from artibot_sim.exchange.sdf import sdf

        return lambda grounds, _, __: sdf(next(iter(grounds.values())))
    if form == "mjcf":
        return _mjcf
    if form == "ros2_control":
        from artibot_sim.exchange.ros2_control import controllers as motors

        return motors
    from artibot_sim.exchange import controllers

    if form == "diff_drive_controller":
        return controllers.diff_drive_controller
    return lambda grounds, speed, progress: controllers.robot_localization(
        next(iter(grounds.values())), speed, progress
    )


def _mjcf(grounds: Mapping[str, Robot], speed: float | None, progress: Report) -> str:
    """Fit MuJoCo's friction to the turns of a robot, and describe it."""
    from artibot_sim.exchange.mjcf import fitted, mjcf

    robot = next(iter(grounds.values()))
    return mjcf(robot, fitted(robot, speed, progress))


def _export_recording(
    path: Path, form: str, out: Path | None, rate: float | None, everything: bool, topics: tuple[str, ...],
    namespace: str | None,
) -> None:  # fmt: skip
    from artibot_sim.exchange.tables import joined_table, raw_channels, tables_of_topics
    from artibot_sim.experiment import parse_renames, read_bag
    from artibot_sim.experiment.storage import recording_name
    from artibot_sim.experiment.writer import whole_folder
    from artibot_sim.progress import Bar
    from artibot_sim.report.files import fault, write_files

    if rate is not None and everything:
        raise ArtibotError("--rate and --all: a joined table has only topics that artibot reads; leave one out")
    target = out or Path(f"{recording_name(path)}.{form}" if rate is not None else f"{recording_name(path)}_{form}")
    if rate is not None and (why := fault(target)):
        raise ArtibotError(f"{target}: cannot be written: {why}")
    with Bar() as bar:
        stage = bar.stage(f"reading {path.name}", 1.0)
        experiment = read_bag(path, parse_renames(topics), namespace=namespace, progress=stage)
    if rate is not None:
        write_files({target: joined_table(experiment, form, rate)})
        click.echo(f"wrote {target}")
        return
    read = {channel.topic for channel in experiment.channels.values()}
    others = raw_channels(path, set(experiment.topics) - read) if everything else []
    files = tables_of_topics(experiment, form, others)
    with whole_folder(target) as partial:
        partial.mkdir()
        for name, content in files.items():
            (partial / name).write_bytes(content)
    for name in files:
        click.echo(f"wrote {target / name}")
