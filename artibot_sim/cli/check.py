"""`artibot check`: what is wrong with recordings, before anything is fitted to them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from artibot_sim.cli.options import ReadingOptions, gathered, reading_options
from artibot_sim.exchange.own_effects import effects_option

if TYPE_CHECKING:
    from rich.console import Console

    from artibot_sim.estimation.checks.report import Check

MOST = 150_000
"""Messages that are read in seconds: eight minutes of three topics at 100 Hz."""
_PATH = click.Path(path_type=Path)


@click.command("check")
@click.argument("recordings", nargs=-1, required=True, metavar="BAG [BAG…]", type=_PATH)
@effects_option
@click.option("--robot", required=True, help="Robot name or file that the recordings are of.")
@reading_options
@click.option("--all", "whole", is_flag=True, help="Read all of a long recording, not pieces of it.")
@click.option("--json", "as_json", type=click.Path(path_type=Path, dir_okay=False), help="Everything as JSON.")
@gathered(ReadingOptions, "reading")
def command(
    reading: ReadingOptions, recordings: tuple[Path, ...], robot: str, whole: bool, as_json: Path | None
) -> int:
    """Say in seconds what is wrong with recordings: clocks, units, signs, sides, sensors, excitation.

    Streams are held against each other, no soil is fitted. Of a long recording ten pieces from its beginning to its end
    are read; identify and diagnose check all of it. Exit status 0 where all of them can be used as they are, 1
    where something has to be mended first, 2 for unusable input.

    \b
    Example:
      artibot check run0 run1 --robot husky_driven
    """
    from rich.console import Console

    from artibot_sim.estimation.checks.report import check
    from artibot_sim.model import load_robot
    from artibot_sim.progress import Bar
    from artibot_sim.report.files import json_bytes, write_files

    rover, most = load_robot(robot), None if whole else MOST
    with Bar() as bar:
        read = [reading.recording(path, bar, 1.0 / len(recordings), rover, most) for path in recordings]
    found = check(read, rover)
    console = Console(highlight=False)
    for one in found:
        _show(console, one)
    if as_json is not None:
        write_files({as_json: json_bytes([one.as_dict() for one in found])})
    return 0 if all(one.usable for one in found) else 1


def _show(console: Console, one: Check) -> None:
    """One recording: what has to be mended, what is wrong, what is doubtful, delays."""
    from rich.markup import escape
    from rich.table import Table

    from artibot_sim.estimation.checks.comparisons import AGREES

    verdict = "can be used" if one.usable else "has to be mended first"
    console.print(f"[bold]{escape(one.name)}[/bold]: {verdict}" if one.name != "all together" else one.name)
    if one.refused:
        console.print(f"  refused: {escape(one.refused)}", soft_wrap=True)
    for finding in one.findings:
        console.print(f"  {finding.name}: {escape(finding.text)}", style="red" if finding.serious else "yellow")
        console.print(f"    {escape(finding.evidence)}; {escape(finding.mend)}")
    for said in one.doubts:
        console.print(f"  {escape(said)}")
    if one.delays:
        table = Table("stream", "after", "s", "95 %", "agree", box=None, header_style="dim", pad_edge=False)
        for stream, after, delay in one.delays:
            low, high = delay.interval
            known = delay.agreement >= AGREES
            cells = (f"{delay.value:+.3f}", f"{_bound(low)} … {_bound(high)}") if known else ("unknown", "")
            table.add_row(f"  {stream}", after, *cells, f"{100 * delay.agreement:.0f} %")
        console.print(table)


def _bound(value: float) -> str:
    """An end of an interval, which may be open: windows too short show no longer delay."""
    return f"{value:+.3f}" if math.isfinite(value) else "?"
