"""Many cases with something hidden: ``python -m diagnose.hidden --kinds none:12,single:27 --out FOLDER``.

Every case is diagnosed from its recordings alone, and scored against a truth that only the scorer reads. Results go
into ``FOLDER/cases.jsonl`` one by one: a campaign that is stopped, even killed, goes on with the same command.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from diagnose.hidden.jobs import KINDS, Job, jobs, kinds_of
from diagnose.hidden.journal import Journal
from diagnose.hidden.table import failures, laws, names, picture, table
from diagnose.hidden.work import WAYS, do

from artibot_sim.cluster import map_tasks
from artibot_sim.diagnose.policy import FALSE_ALARM_RATE
from artibot_sim.errors import ArtibotError
from artibot_sim.progress import Bar


def results_of(todo: Sequence[Job], workers: int, way: str, scheduler: str | None = None) -> Iterator[dict[str, Any]]:
    """Results as they come, each from a process of its own where there are several workers, or from a cluster's."""
    for _, result in map_tasks(partial(do, way=way), todo, workers=workers, scheduler=scheduler):
        yield result


def counts_of(text: str, cases: int) -> dict[str, int]:
    """From ``none:12,single`` to numbers of cases; `cases` where none is given."""
    counts = {}
    for part in text.split(","):
        kind, _, number = part.partition(":")
        if kind not in KINDS or not (number or str(cases)).isdigit():
            raise ArtibotError(
                f"--kinds: found '{part}', expected some of {', '.join(KINDS)}, each with :NUMBER or not"
            )
        counts[kind] = int(number or cases)
    return counts


def main(argv: Sequence[str] | None = None) -> int:
    """Run a campaign and print its table; status 1 where a case could not be diagnosed."""
    options = _parser().parse_args(argv)
    folder = Path(options.out)
    try:
        severities = tuple(float(part) for part in options.severity.split(","))
        kinds = options.kinds or ",".join(kinds_of(options.robot, options.torques))
        counts = counts_of(kinds, options.cases)
        todo = jobs(
            options.seed, counts, severities, options.noise, options.runs, options.duration, options.robot,
            options.false_alarms, options.torques,
        )  # fmt: skip
        with Journal(folder / "cases.jsonl") as journal:
            _carry_out(todo, journal, options)
            wanted = {job.key for job in todo}
            results = [result for result in journal.results if result["key"] in wanted]
    except (ArtibotError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        return 130
    print("\n".join([*failures(results), "", *table(results), "", *names(results), "", *laws(results)]))
    (folder / "confusion.png").write_bytes(picture(results))
    print(f"{len(results)} cases, seed {options.seed}; {folder / 'confusion.png'}")
    return 1 if any("error" in result for result in results) else 0


def _carry_out(todo: Sequence[Job], journal: Journal, options: argparse.Namespace) -> None:
    """Do what is not done yet."""
    done = journal.done
    left, commit = [job for job in todo if job.key not in done], commit_of(Path(__file__).parent)
    with Bar(total=float(len(todo))) as bar:
        ready = len(todo) - len(left)
        bar.show(ready, f"case {ready} of {len(todo)}")
        for result in results_of(left, options.workers, options.way, options.scheduler):
            journal.add(result | {"commit": commit})
            ready += 1
            bar.show(ready, f"case {ready} of {len(todo)}")


def commit_of(folder: Path) -> str:
    """The commit of the code in a folder, with + where files have changed since; nothing outside of a repository."""
    try:
        said = [
            subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True).stdout
            for words in (("rev-parse", "--short", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
        ]
    except (OSError, subprocess.CalledProcessError):
        return ""
    return said[0].strip() + ("+" if said[1].strip() else "")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m diagnose.hidden",
        description="Diagnoses of recordings in which something is hidden, scored.",
        epilog="Example: make diagnose-campaign KINDS=none:12,single:27 SEVERITY=1,0.3 WORKERS=2",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--severity", default="1", help="one or several, by comma [1]")
    parser.add_argument("--cases", type=int, default=27, help="cases of each kind and severity [27]")
    parser.add_argument("--noise", type=float, default=1.0, help="factor of the sensors' noise [1]")
    parser.add_argument("--runs", type=int, default=3, help="recordings to diagnose, one more is held out [3]")
    parser.add_argument("--duration", type=float, default=45.0, help="of each, s [45]")
    parser.add_argument("--robot", default="agriq", help="name or file of a robot [agriq]")
    parser.add_argument(
        "--false-alarms", type=float, default=float(FALSE_ALARM_RATE),
        help=f"share of them that diagnoses are asked for [{float(FALSE_ALARM_RATE):g}]",
    )  # fmt: skip
    parser.add_argument("--torques", action="store_true", help="of a rigid robot, which is recorded without else")
    parser.add_argument("--kinds", help="which [all of the robot's], each with its number or not: none:300,single")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes [all cores]")
    parser.add_argument(
        "--scheduler", help="address of a Dask scheduler; its workers need this checkout and test/ on PYTHONPATH"
    )
    parser.add_argument("--way", choices=sorted(WAYS), default="memory", help="recordings in memory, or real bags")
    parser.add_argument("--out", default="campaign", help="folder of the results [campaign]")
    return parser
