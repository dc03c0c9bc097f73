"""`artibot plot`: draw recordings, and say how well the plan was followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from artibot_sim.cli.options import ReadingOptions, gathered, reading_options
from artibot_sim.errors import ArtibotError
from artibot_sim.report.files import OutputFile, fault

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment
    from artibot_sim.report.recordings import Drawn

_DRAWING = 0.15
"""Drawing takes about this share of the time that reading takes."""
_FILE = OutputFile()


@click.command("plot")
@click.argument("recordings", nargs=-1, required=True, metavar="BAG [BAG…]", type=click.Path(path_type=Path))
@click.option("--png", type=_FILE, help="Picture to write [<bag name>.png here, unless --html or --json is given].")
@click.option("--html", type=_FILE, help="Page to write: interactive, one file, needs no network.")
@click.option("--json", "as_json", type=_FILE, help="Figures of merit for scripts, in SI units.")
@click.option("--robot", help="Robot name or file, for outlines and limits [what the recording names].")
@reading_options
@click.option("--start", type=float, help="Draw from here on, s since the recording's start.")
@click.option("--end", type=float, help="Draw up to here, s.")
@gathered(ReadingOptions, "reading")
def command(
    reading: ReadingOptions, recordings: tuple[Path, ...], png: Path | None, html: Path | None, as_json: Path | None,
    robot: str | None, start: float | None, end: float | None,
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
    from artibot_sim.report.recordings import draw, robot_of_recording

    check_count(len(recordings))
    sizes = [_bytes_of(path) for path in recordings]
    with Bar((1.0 + _DRAWING) * sum(sizes)) as bar:
        if png is None and html is None and as_json is None:
            png = Path(f"{recording_name(recordings[0])}.png")
            if why := fault(png):
                raise ArtibotError(f"{png}: cannot be written: {why}; name another file with --png")
        experiments = []
        for path, size in zip(recordings, sizes, strict=True):
            experiments.append(_part(reading.recording(path, bar, size), start, end))
        robots = [robot_of_recording(robot, experiment) for experiment in experiments]
        drawing = bar.stage("drawing", _DRAWING * sum(sizes))
        drawn = draw(experiments, robots, png=png, html=html, json=as_json, progress=drawing)
    _print(drawn, experiments)


def _bytes_of(path: Path) -> int:
    """Return the size of a recording."""
    from artibot_sim.experiment.storage import storage_files

    return sum(file.stat().st_size for file in storage_files(path))


def _part(experiment: Experiment, start: float | None, end: float | None) -> Experiment:
    """Return a recording, or the part of it that was asked for (s)."""
    if start is None and end is None:
        return experiment
    first, last = -math.inf if start is None else start, math.inf if end is None else end
    if not first < last:
        raise ArtibotError(f"--start {first:g} --end {last:g}: expected the start before the end")
    part = experiment.between(first, last)
    if not part.segments:
        raise ArtibotError(
            f"{experiment.path}: nothing was recorded between {first:g} and {last:g} s; "
            f"it is {experiment.duration:.1f} s long"
        )
    return part


def _print(drawn: Drawn, experiments: Sequence[Experiment]) -> None:
    """Print the table, what is missing and what was written."""
    from rich.console import Console

    from artibot_sim.report.measures import rows, terminal_table
    from artibot_sim.report.recordings import remarks_of

    console = Console(highlight=False, markup=False)
    if any(rows(measures) for measures in drawn.measured):
        console.print(terminal_table(drawn.names, drawn.measured))
    for remark in remarks_of(drawn.names, experiments, drawn.measured):
        console.print(remark, style="dim")
    for what, why in drawn.figure.missing.items():
        console.print(f"not drawn: {what} ({why})", style="dim")
    for path in drawn.files:
        console.print(f"wrote {path}", soft_wrap=True)
