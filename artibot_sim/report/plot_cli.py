"""`artibot plot`: draw recordings, and say how well the plan was followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.report.output import OutputFile, fault

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment
    from artibot_sim.model import Robot
    from artibot_sim.progress import Report
    from artibot_sim.report.measures import Measures
    from artibot_sim.report.panels import Figure

_DRAWING = 0.15
"""Drawing takes about this share of the time that reading takes."""
_FILE = OutputFile()


@click.command("plot", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("recordings", nargs=-1, required=True, metavar="BAG [BAG…]", type=click.Path(path_type=Path))
@click.option("--png", type=_FILE, help="Picture to write [<bag name>.png here, unless --html or --json is given].")
@click.option("--html", type=_FILE, help="Page to write: interactive, one file, needs no network.")
@click.option("--json", "as_json", type=_FILE, help="Figures of merit for scripts, in SI units.")
@click.option("--robot", help="Robot name or file, for outlines and limits [what the recording names].")
@click.option(
    "--topic", "topics", multiple=True, metavar="WANTED=FOUND", help="Read topic FOUND as WANTED; repeatable."
)
@click.option("--namespace", metavar="NAME", help="Rover whose topics to read, where there are several: /rover1.")
@click.option("--start", type=float, help="Draw from here on, s since the recording's start.")
@click.option("--end", type=float, help="Draw up to here, s.")
def command(
    recordings: tuple[Path, ...], png: Path | None, html: Path | None, as_json: Path | None, robot: str | None,
    topics: tuple[str, ...], namespace: str | None, start: float | None, end: float | None,
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
    from artibot_sim.experiment.storage import recording_name
    from artibot_sim.progress import Bar
    from artibot_sim.report.figures import check_count

    check_count(len(recordings))
    sizes = [_bytes_of(path) for path in recordings]
    with Bar((1.0 + _DRAWING) * sum(sizes)) as bar:
        if png is None and html is None and as_json is None:
            png = Path(f"{recording_name(recordings[0])}.png")
            if why := fault(png):
                raise ArtibotError(f"{png}: cannot be written: {why}; name another file with --png")
        experiments = [
            _read(path, topics, namespace, (start, end), bar.stage(f"reading {path.name}", size))
            for path, size in zip(recordings, sizes, strict=True)
        ]
        robots = [_robot(robot, experiment) for experiment in experiments]
        told = bar.stage("drawing", _DRAWING * sum(sizes))
        drawn = draw(experiments, robots, png=png, html=html, json=as_json, progress=told)
    _print(drawn, experiments)


class Drawn(NamedTuple):
    """What came of drawing: the figure, what the recordings are called in it, their measures, the files written."""

    figure: Figure
    names: Sequence[str]
    measured: Sequence[Measures]
    files: Sequence[Path]


def draw(
    experiments: Sequence[Experiment],
    robots: Sequence[Robot | None],
    *,
    png: Path | None = None,
    html: Path | None = None,
    json: Path | None = None,
    progress: Report | None = None,
) -> Drawn:
    """Write the files asked for; `progress` hears the share that is done.

    Raises
    ------
    ArtibotError
        If there is nothing to draw, or a file cannot be written; then none is.
    """
    from artibot_sim.report.figures import experiment_figure, labels
    from artibot_sim.report.measures import measure
    from artibot_sim.report.output import write_files

    figure = experiment_figure(experiments, robots)
    measured = [measure(experiment) for experiment in experiments]
    names = labels(experiments)
    files: dict[Path, bytes] = {}
    tell = progress or (lambda _: None)
    for path, render in ((png, _png), (html, _page), (json, _json)):
        tell(len(files) / 3)
        if path is not None:
            if path in files:
                raise ArtibotError(f"{path}: asked for twice; give each output its own name")
            files[path] = render(figure, experiments, names, measured)
    write_files(files)
    tell(1.0)
    return Drawn(figure, names, measured, list(files))


def page_of_recordings(experiments: Sequence[Experiment]) -> bytes:
    """The page (UTF-8) of recordings on top of each other, with the robots that they name.

    Raises
    ------
    ArtibotError
        If there is nothing to draw.
    """
    from artibot_sim.report.figures import experiment_figure, labels
    from artibot_sim.report.measures import measure

    figure = experiment_figure(experiments, [_robot(None, experiment) for experiment in experiments])
    return _page(figure, experiments, labels(experiments), [measure(experiment) for experiment in experiments])


def _bytes_of(path: Path) -> int:
    """Return the size of a recording."""
    from artibot_sim.experiment.storage import storage_files

    return sum(file.stat().st_size for file in storage_files(path))


def _read(
    path: Path, topics: Sequence[str], namespace: str | None, span: tuple[float | None, float | None], progress: Report
) -> Experiment:
    """Return a recording, or the part of it that was asked for."""
    start, end = span
    from artibot_sim.experiment import parse_renames, read_bag

    experiment = read_bag(path, parse_renames(tuple(topics)), namespace=namespace, progress=progress)
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


def _print(drawn: Drawn, experiments: Sequence[Experiment]) -> None:
    """Print the table, what is missing and what was written."""
    from rich.console import Console

    from artibot_sim.report.table import rows, terminal_table

    console = Console(highlight=False, markup=False)
    if any(rows(measures) for measures in drawn.measured):
        console.print(terminal_table(drawn.names, drawn.measured))
    for remark in _remarks(drawn.names, experiments, drawn.measured):
        console.print(remark, style="dim")
    for what, why in drawn.figure.missing.items():
        console.print(f"not drawn: {what} ({why})", style="dim")
    for path in drawn.files:
        console.print(f"wrote {path}", soft_wrap=True)
