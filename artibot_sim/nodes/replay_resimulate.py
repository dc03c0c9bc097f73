"""`artibot replay BAG --resimulate …`: the command around `experiment.resimulate`, without ROS."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from artibot_sim.experiment import parse_renames, read_bag
from artibot_sim.experiment.resimulate import Resimulation, resimulate, robot_of


def run_resimulation(
    bag: Path, drive: str, out: Path, *, robot: str | None = None, horizon: float | None = None, back: str = "auto",
    renames: Sequence[str] = (),
) -> int:  # fmt: skip
    """Simulate a recording again, write and print the results; return the exit status 0.

    Parameters
    ----------
    bag : folder or file.
    drive : `rotations` or `commands`.
    out : folder for `simulated` and `metrics.json`.
    robot : name or file; the recording's own if None.
    horizon : s; None for free runs.
    back : `auto`, `kappa` or `effort`.
    renames : `WANTED=FOUND` texts.

    Raises
    ------
    ArtibotError
        If the recording or the robot cannot be used, or results exist.
    """
    experiment = read_bag(bag, topics=parse_renames(tuple(renames)))
    found = robot_of(experiment, robot)
    with _progress(experiment.duration) as progress:
        result = resimulate(experiment, found, drive, horizon=horizon, back=back, progress=progress)
    result.write(out)
    _print(result)
    for remark in (*experiment.remarks, *result.remarks):
        click.echo(f"note: {remark}", err=True)
    click.echo(f"wrote {out}/simulated, {out}/metrics.json, {_draw(result, out)}")
    return 0


def _draw(result: Resimulation, out: Path) -> Path:
    """Draw the recording and its simulation on top of each other."""
    from artibot_sim.report.figures import experiment_figure
    from artibot_sim.report.output import write_files
    from artibot_sim.report.png import render_png

    figure = experiment_figure([result.experiment, read_bag(out / "simulated")], [result.robot, result.robot])
    write_files({out / "compared.png": render_png(figure)})
    return out / "compared.png"


@contextmanager
def _progress(total: float) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal while it lasts; gives the function to call with simulated seconds."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("simulating", total=total)
        yield lambda seconds: bar.advance(task, seconds)


def _print(result: Resimulation) -> None:
    from rich.console import Console
    from rich.table import Table

    how = "free run" if result.horizon is None else f"windows of {result.horizon:g} s"
    title = f"{result.experiment.name}, {result.robot.name} by its {result.drive}: {how}, {result.windows} starts"
    table = Table(title=title, title_justify="left")
    for column in ("channel", "unit", "rmse", "median", "p90", "noise"):
        table.add_column(column, justify="left" if column in ("channel", "unit") else "right")
    for channel, metric in result.metrics.items():
        numbers: Any = (f"{x:.4g}" for x in (metric.rmse, metric.median, metric.p90, metric.noise))
        table.add_row(channel, metric.unit, *numbers)
    Console().print(table)
