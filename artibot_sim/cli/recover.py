"""`artibot recover`: make a recording that was cut short readable again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from artibot_sim.experiment.recover import RecoverReport


@click.command("recover")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder to write [<name>_recovered beside it].")
def command(recording: Path, out: Path | None) -> None:
    """Save what can be read of a RECORDING (folder or .mcap) that was cut short.

    The recording itself is never changed: a new folder is written beside it, and its name printed.

    \b
    Example:
      artibot recover run7            # writes run7_recovered
      artibot recover run7/run7_0.mcap --out saved
    """
    from artibot_sim.experiment.recover import recover
    from artibot_sim.progress import Bar

    with Bar() as bar:
        report = recover(recording, out, progress=bar.stage("recovering", 1.0))
    _show(report)


def _show(report: RecoverReport) -> None:
    """Print how much was saved, and where."""
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    table = Table("topic", "messages", box=None, header_style="bold")
    table.columns[1].justify = "right"
    for topic, count in sorted(report.topics.items()):
        table.add_row(topic, str(count))
    if report.topics:
        console.print(table)
    console.print(f"saved {report.messages} messages, {report.seconds:.2f} s, {len(report.topics)} topics in", end=" ")
    console.print(str(report.out), style="bold", soft_wrap=True)
    if report.complete and not report.garbage_bytes:
        console.print("the recording was complete: nothing was lost")
    for amount, what in (
        (report.lost_bytes, "B at the end belonged to no complete record"),
        (report.gap_bytes, f"B in {report.gaps} damaged place(s) were passed over; what comes after is saved"),
        (report.garbage_bytes, "B after the recording's end were left out"),
        (report.bad_chunks, "chunk(s) cut off or damaged; what was whole in them is saved"),
        (report.missing, "message(s) fewer than the recording's own summary counts"),
        (report.unknown, "message(s) left out: the record that says what they are is lost"),
    ):
        if amount:
            console.print(f"{amount} {what}")
