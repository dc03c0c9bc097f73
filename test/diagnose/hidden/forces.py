"""How often the force that is described is the hidden one: from the soil's fit alone, no effect is tried.

`PYTHONPATH=.:test python -m diagnose.hidden.forces --seeds 1,2 --severity 1,0.3` hides all that is on no list, or
nothing. A force's nats count where a fit leaves more than noise; where nothing is hidden, they say what chance brings.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from diagnose.hidden.cases import case
from diagnose.hidden.score import is_described
from diagnose.hidden.unlisted import LAWS, UNLISTED

from artibot_sim.cluster import map_tasks
from artibot_sim.diagnose.pipeline import baseline
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.unlisted.finding import unexplained, unexplained_of
from artibot_sim.diagnose.words import force_words
from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot
from artibot_sim.progress import Bar

NOTHING = "nothing"


class Task(NamedTuple):
    """What to hide."""

    name: str
    severity: float
    seed: int


class Seen(NamedTuple):
    """What came of a task: whether more than noise was left, the force in words, its nats, and whether it is right."""

    task: Task
    more: bool
    said: str
    nats: float
    right: bool


def seen(task: Task, runs: int, duration: float) -> Seen:
    """One case."""
    effects = () if task.name == NOTHING else (task.name,)
    hidden = case(effects, task.severity, task.seed, runs=runs, duration=duration)
    problem, fit = baseline(hidden.recordings, load_robot("agriq"), Options(workers=1))
    more = leaves_more_than_noise(remains(problem, fit.point))
    found = unexplained(problem, fit.point.coordinates)
    if found is None:
        return Seen(task, more, "", 0.0, False)
    what = unexplained_of(found)
    right = is_described(vars(what), hidden.truth.unlisted)
    return Seen(task, more, force_words(what), found.chosen[0].worth, right)


def tasks(seeds: Sequence[int], severities: Sequence[float], clean: int, names: Sequence[str]) -> list[Task]:
    """Everything on no list, and so many with nothing hidden."""
    found = [Task(name, severity, seed) for seed in seeds for severity in severities for name in names]
    return found + [Task(NOTHING, 0.0, seed) for seed in range(1, clean + 1)]


def table(results: Sequence[Seen]) -> list[str]:
    """A line a case, and the counts."""
    lines = []
    for one in sorted(results, key=lambda one: one.task):
        said = f"{one.nats:8.1f}  {one.said}" if one.said else "       –  no force"
        mark = " " if one.task.name == NOTHING or not one.said else "+" if one.right else "!"
        noise = "" if one.more else "  (no more than noise is left: not asked for)"
        lines.append(f"{one.task.name:<20}{one.task.severity:<5g}{one.task.seed:<4}{mark} {said}{noise}")
    acting = [one for one in results if one.task.name != NOTHING and one.more]
    counts = Counter("right" if one.right else "otherwise" if one.said else "none" for one in acting)
    lines.append(
        f"{len(acting)} with more than noise left: described rightly {counts['right']}, otherwise "
        f"{counts['otherwise']}, not at all {counts['none']}"
    )
    clean = [one for one in results if one.task.name == NOTHING]
    if clean:
        told = sum(bool(one.said) for one in clean)
        asked = sum(one.more for one in clean)
        lines.append(
            f"{len(clean)} with nothing hidden: a force would have been found in {told}, was asked for in {asked}"
        )
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run all and print the table."""
    parser = argparse.ArgumentParser(prog="python -m diagnose.hidden.forces", description=__doc__)
    parser.add_argument("--seeds", default="1,2", help="by comma [1,2]")
    parser.add_argument("--severity", default="1,0.3", help="one or several, by comma [1,0.3]")
    parser.add_argument("--clean", type=int, default=24, help="cases with nothing hidden, of seeds 1 to so many [24]")
    parser.add_argument("--laws", action="store_true", help="hide what nothing was tuned on: products, thresholds, …")
    parser.add_argument("--runs", type=int, default=2, help="recordings [2]")
    parser.add_argument("--duration", type=float, default=30.0, help="of each, s [30]")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes [all cores]")
    options = parser.parse_args(argv)
    try:
        seeds = [int(part) for part in options.seeds.split(",")]
        severities = [float(part) for part in options.severity.split(",")]
        todo = tasks(seeds, severities, options.clean, tuple(LAWS if options.laws else UNLISTED))
        results = []
        with Bar(total=float(len(todo))) as bar:
            work = partial(seen, runs=options.runs, duration=options.duration)
            for _, result in map_tasks(work, todo, workers=options.workers):
                results.append(result)
                bar.show(len(results), f"case {len(results)} of {len(todo)}")
    except (ArtibotError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(table(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
