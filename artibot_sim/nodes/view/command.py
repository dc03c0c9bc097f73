"""``artibot view`` and ``ros2 run artibot_sim view``: a recording or a running rover in 3D, in a browser."""

from __future__ import annotations

import signal
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.common.process import node_main
from artibot_sim.report.files import OutputFile

if TYPE_CHECKING:
    from artibot_sim.diagnose.result import Diagnosis
    from artibot_sim.experiment import Experiment
    from artibot_sim.model import Robot
    from artibot_sim.progress import Bar, Report
    from artibot_sim.view.frames import Film

PORT = 8080


@click.command("view", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.argument("bag", required=False, type=click.Path(path_type=Path))
@click.option("--live", is_flag=True, help="Show the rover whose topics are published now.")
@click.option("--robot", help="Robot: a name or a robot file.  [default: the recording's; live: agriq]")
@click.option("--diagnosis", type=click.Path(path_type=Path), help="With BAG: also as a diagnosis' models predict it.")
@click.option("--save", type=OutputFile(), help="With BAG: write one HTML file that plays by itself, and end.")
@click.option("--port", type=click.IntRange(0, 65535), default=PORT, help="Of the page; 0: a free one.  [8080]")
@click.option("--browser/--no-browser", default=True, help="Open the page.  [default: yes]")
@click.option("--topic", "renames", multiple=True, metavar="WANTED=FOUND", help="With BAG: the name of a topic in it.")
@click.option("--namespace", metavar="NAME", help="With BAG: of the rover, where there are several.")
@click.pass_obj
def command(ros_args: list[str] | None, bag: Path | None, live: bool, **given: Any) -> int:
    """See a rover with its modules and wheels, its planned, odometric and true path, and the force on each wheel.

    The page is on this machine alone (http://127.0.0.1:8080). Of a recording it has a time slider. The line at each
    wheel is the force of the ground by the model, red where the wheel slides.

    \b
    Examples:
      artibot view run7
      artibot view run7 --save run7.html
      artibot view run7 --diagnosis found
      artibot view --live --robot epiq
    """
    if live == (bag is not None):
        raise click.UsageError("expected a recording or --live: artibot view run7, or artibot view --live")
    if live:
        used = [name for name in ("diagnosis", "save", "renames", "namespace") if given[name] not in (None, ())]
        if used:
            option = {"renames": "topic"}.get(used[0], used[0])
            raise click.UsageError(f"--{option} needs a recording: artibot view BAG --{option} …")
    import viser  # noqa: F401 -- says what is missing before any work

    if live:
        from artibot_sim.nodes.view.live import run

        return run(given["robot"] or "agriq", given["port"], given["browser"], ros_args or [])
    assert bag is not None
    return show(bag, given)


def read(bag: Path, given: dict[str, Any], bar: Bar) -> tuple[Experiment, Robot, Diagnosis | None]:
    """The recording, the robot that it is shown as, and the diagnosis that is shown with it."""
    from artibot_sim.experiment import parse_renames, read_bag
    from artibot_sim.experiment.resimulate import robot_of

    found = None
    if given["diagnosis"] is not None:
        from artibot_sim.report.diagnosis.files import load  # 1 s, with all that a diagnosis is made of

        found = load(given["diagnosis"])
    stage = bar.stage(f"reading {bag.name}", 0.3)
    experiment = read_bag(bag, parse_renames(given["renames"]), namespace=given["namespace"], progress=stage)
    robot = found.robot if found is not None and given["robot"] is None else robot_of(experiment, given["robot"])
    return experiment, robot, found


def show(bag: Path, given: dict[str, Any]) -> int:
    """Write the file, or serve the page until the process is asked to end."""
    from artibot_sim.progress import Bar
    from artibot_sim.view.frames import film_of, measured_film
    from artibot_sim.view.server import FilmPlayer, announced, started, stopped

    with Bar() as bar:
        experiment, robot, found = read(bag, given, bar)
        if given["save"] is not None:
            return save(film_of(experiment, robot, found, bar.stage("simulating", 0.4)), given["save"], bar)
        film = measured_film(experiment, robot)

    def simulated(report: Report) -> Film:
        whole = film_of(experiment, robot, found, report)
        for note in whole.notes:
            click.echo(note, err=True)
        return whole

    server = _served(started, given["port"])
    asked = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.set())
    try:
        player = FilmPlayer(server, film, simulated)
        click.echo(announced(server, given["browser"]))
        player.run(asked.is_set)
    finally:
        stopped(server)
    return 0


def save(film: Film, path: Path, bar: Bar) -> int:
    """Write a film as one file."""
    from artibot_sim.report.files import write_files
    from artibot_sim.view.server import saved

    page = saved(film, bar.stage("writing", 0.3))
    write_files({path: page})
    click.echo(f"wrote {path}")
    return 0


def _served(start: Any, port: int) -> Any:
    try:
        return start(port)
    except OSError as error:
        raise ArtibotError(f"port {port}: {error.strerror or error}; give another with --port, or 0") from error


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``artibot view`` and ``ros2 run artibot_sim view``."""
    return node_main(command, "view", argv)
