"""``artibot bench``: measure, print a table, write the file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from artibot_sim.report.files import OutputFile

if TYPE_CHECKING:
    from rich.console import Console

    from artibot_sim.bench.comparison import Earlier
    from artibot_sim.bench.results import Result, Skipped


@click.command("bench", context_settings={"max_content_width": 110})
@click.option("--json", "path", type=OutputFile(), help="Write the numbers to this file.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this benchmark or result; may be repeated.")
@click.option("--quick", is_flag=True, help="Seconds instead of minutes: few runs of the first 8 s, no processes.")
@click.option("--list", "show_list", is_flag=True, help="List the names and end.")
@click.option(
    "--compare", "old", type=click.Path(path_type=Path), metavar="OLD.json",
    help="Ratios against an earlier file of --json; exit status 1 where something got worse by a fifth.",
)  # fmt: skip
def command(path: Path | None, only: tuple[str, ...], quick: bool, show_list: bool, old: Path | None) -> int:
    """Measure the speed of the model and the commands on this machine.

    Speeds are those of the best run, because whatever else the machine does can only slow a run down; the spread
    of the runs is shown beside. Where MuJoCo is installed, the same trajectory runs in it as well.

    \b
    Examples:
      artibot bench
      artibot bench --json bench.json
      artibot bench --only rollout --only mujoco
      artibot bench --only batch --compare bench.json
    """
    from artibot_sim.bench.suite import SUITE, chosen

    if show_list:
        width = max(map(len, SUITE)) + 2
        for key, benchmark in SUITE.items():
            click.echo(f"{key:{width}}{', '.join(benchmark.names)}")
        return 0
    from artibot_sim.bench.comparison import read_earlier

    earlier = read_earlier(old) if old is not None else None  # before the minutes of measuring
    return _measure(chosen(only, quick), quick, path, earlier)


def _measure(keys: list[str], quick: bool, path: Path | None, earlier: Earlier | None) -> int:
    """Measure, print and write; 1 when a benchmark failed, or something got worse than it was."""
    from rich.console import Console

    from artibot_sim.bench.comparison import WIDTH, heading, notes, table
    from artibot_sim.bench.results import machine, write_json

    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = WIDTH  # a file or a pipe has no width of its own
    host = machine() | {"quick": quick}
    results, skipped = _with_progress(keys, quick)
    if path is not None:
        write_json(path, host, results, skipped)
    console.print(heading(host))
    console.print(table(results))
    for line in notes(results, skipped):
        console.print(line, style="dim")
    if path is not None:
        console.print(f"written to {path}", soft_wrap=True)
    worse = earlier is not None and _compare(console, earlier, results, host)
    return int(worse or any(skip.failed for skip in skipped))


def _compare(console: Console, earlier: Earlier, results: list[Result], host: dict[str, Any]) -> bool:
    """Print the ratios; whether something got worse."""
    from artibot_sim.bench.comparison import changes, comparison, is_worse, remarks

    found = changes(earlier, results)
    console.print()
    console.print(comparison(earlier, found))
    for line in remarks(earlier, results, host):
        console.print(line, style="dim")
    return is_worse(earlier, found, host)


def _with_progress(keys: list[str], quick: bool) -> tuple[list[Result], list[Skipped]]:
    """Run all with a bar on standard error that is gone afterwards."""
    import time

    from artibot_sim.bench.model import Scenario
    from artibot_sim.bench.suite import SUITE, run
    from artibot_sim.progress import Bar

    ends = {key: sum(SUITE[k].seconds for k in keys[: i + 1]) for i, key in enumerate(keys)}
    now: list[tuple[str, float]] = []
    with Bar(sum(SUITE[key].seconds for key in keys)) as bar:

        def begin(key: str) -> None:
            now[:] = [(key, time.monotonic())]
            bar.show(ends[key] - SUITE[key].seconds, key)

        def tick() -> None:
            key, since = now[0]
            share = min((time.monotonic() - since) / SUITE[key].seconds, 0.98)
            bar.show(ends[key] - (1 - share) * SUITE[key].seconds)

        return run(keys, Scenario(quick, tick), begin)
