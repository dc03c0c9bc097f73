"""`artibot plot`: draw recordings, and say how well the plan was followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from artibot_sim.errors import ArtibotError

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment
    from artibot_sim.model import Robot
    from artibot_sim.report.measures import Measures
    from artibot_sim.report.panels import Figure

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.command("plot", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("recordings", nargs=-1, required=True, metavar="BAG [BAG…]", type=click.Path(path_type=Path))
@click.option("--png", type=_FILE, help="Picture to write [<bag name>.png here, unless --html or --json is given].")
@click.option("--html", type=_FILE, help="Page to write: interactive, one file, needs no network.")
@click.option("--json", "as_json", type=_FILE, help="Figures of merit for scripts, in SI units.")
@click.option("--robot", help="Robot name or file, for outlines and limits [what the recording names].")
@click.option(
    "--topic", "topics", multiple=True, metavar="WANTED=FOUND", help="Read topic FOUND as WANTED; repeatable."
)
@click.option("--start", type=float, help="Draw from here on, s since the recording's start.")
@click.option("--end", type=float, help="Draw up to here, s.")
def command(
    recordings: tuple[Path, ...], png: Path | None, html: Path | None, as_json: Path | None, robot: str | None,
    topics: tuple[str, ...], start: float | None, end: float | None,
) -> None:  # fmt: skip
    """Draw recordings (folders or files): path, yaw, speed, motor velocities and torques, articulation.

    What a recording does not have is named and left out. Several recordings are drawn on top of each other. The
    table has eqs 31 and 32 of the paper and the radii of arcs.

    \b
    Examples:
      artibot plot run7                                  # writes run7.png
      artibot plot run7 replayed/simulated --html both.html
      artibot plot husky_a --start 0 --end 30 --png start.png
      artibot plot run7 --json run7.json                 # figures of merit only
    """
    from rich.console import Console

    with Console(stderr=True).status("reading"):
        experiments = [_read(path, topics, start, end) for path in recordings]
        robots = [_robot(robot, experiment) for experiment in experiments]
        if png is None and html is None and as_json is None:
            png = Path(f"{experiments[0].name}.png")
    draw(experiments, robots, png=png, html=html, json=as_json)


def draw(
    experiments: Sequence[Experiment],
    robots: Sequence[Robot | None],
    *,
    png: Path | None = None,
    html: Path | None = None,
    json: Path | None = None,
) -> None:
    """Write the files asked for, and print the table.

    Raises
    ------
    ArtibotError
        If there is nothing to draw, or a file cannot be written; then none is.
    """
    from rich.console import Console

    from artibot_sim.report.figures import experiment_figure, labels
    from artibot_sim.report.measures import measure
    from artibot_sim.report.output import write_files

    figure = experiment_figure(experiments, robots)
    measured = [measure(experiment) for experiment in experiments]
    names = labels(experiments)
    files: dict[Path, bytes] = {}
    with Console(stderr=True).status("drawing"):
        for path, render in ((png, _png), (html, _page), (json, _json)):
            if path is not None:
                if path in files:
                    raise ArtibotError(f"{path}: asked for twice; give each output its own name")
                files[path] = render(figure, experiments, names, measured)
        write_files(files)
    _print(figure, names, experiments, measured, list(files))


def _read(path: Path, topics: Sequence[str], start: float | None, end: float | None) -> Experiment:
    """Return a recording, or the part of it that was asked for."""
    from artibot_sim.experiment import parse_renames, read_bag

    experiment = read_bag(path, parse_renames(tuple(topics)))
    if start is None and end is None:
        return experiment
    first, last = -math.inf if start is None else start, math.inf if end is None else end
    if not first < last:
        raise ArtibotError(f"--start {first:g} --end {last:g}: expected the start before the end")
    part = experiment.between(first, last)
    if not part.segments:
        raise ArtibotError(
            f"{path}: nothing was recorded between {first:g} and {last:g} s; it is {experiment.duration:.1f} s long"
        )
    return part


def _robot(wanted: str | None, experiment: Experiment) -> Robot | None:
    """Return the robot that was asked for, else the one the recording names if it is known."""
    from artibot_sim.model import load_robot

    if wanted is not None:
        return load_robot(wanted)
    named = experiment.metadata.get("robot")
    if not named:
        return None
    try:
        return load_robot(named)
    except ArtibotError:
        return None  # a robot from elsewhere: the figure says that the outline is missing


def _png(figure: Figure, *_: object) -> bytes:
    from artibot_sim.report.png import render_png

    return render_png(figure)


def _page(
    figure: Figure, experiments: Sequence[Experiment], names: Sequence[str], measured: Sequence[Measures]
) -> bytes:
    from artibot_sim.report.page import render_page
    from artibot_sim.report.table import KINDS, rows

    table = [(name, rows(measures)) for name, measures in zip(names, measured, strict=True)]
    return render_page(figure, table, KINDS, _remarks(names, experiments, measured))


def _json(
    figure: Figure, experiments: Sequence[Experiment], names: Sequence[str], measured: Sequence[Measures]
) -> bytes:
    import json

    from artibot_sim.report.table import summary

    content = summary(experiments, measured, figure.missing)
    return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _remarks(names: Sequence[str], experiments: Sequence[Experiment], measured: Sequence[Measures]) -> list[str]:
    """Return what there is to say about recordings, each sentence once, with whom it is about."""
    about: dict[str, list[str]] = {}
    for name, experiment, measures in zip(names, experiments, measured, strict=True):
        for remark in (*measures.remarks, *experiment.remarks):
            about.setdefault(remark, []).append(name)
    return [f"{', '.join(who)}: {remark}" for remark, who in about.items()]


def _print(
    figure: Figure,
    names: Sequence[str],
    experiments: Sequence[Experiment],
    measured: Sequence[Measures],
    files: Sequence[Path],
) -> None:
    """Print the table, what is missing and what was written."""
    from rich.console import Console

    from artibot_sim.report.table import rows, terminal_table

    console = Console(highlight=False, markup=False)
    if any(rows(measures) for measures in measured):
        console.print(terminal_table(names, measured))
    for remark in _remarks(names, experiments, measured):
        console.print(remark, style="dim")
    for what, why in figure.missing.items():
        console.print(f"not drawn: {what} ({why})", style="dim")
    for path in files:
        console.print(f"wrote {path}", soft_wrap=True)
