"""How often the force that is described is the hidden one, and what it predicts: no effect on the list is tried.

`PYTHONPATH=.:test python -m diagnose.hidden.forces --seeds 1,2 --severity 1,0.3` hides all that is on no list, or
nothing, fits the soil and then laws, as a diagnosis does, and holds their predictions of another recording against the
true model's. A force's nats count where a fit leaves more than noise; where nothing is hidden, they say what chance
brings.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

from diagnose.hidden.cases import Case, case
from diagnose.hidden.score import MOST_OF_IT, is_described, relative_gain
from diagnose.hidden.table import with_interval
from diagnose.hidden.unlisted import LAWS, UNLISTED
from diagnose.hidden.work import reference
from diagnose.searches import baseline

from artibot_sim.cluster import map_tasks
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.remains import leaves_more_than_noise, remains
from artibot_sim.diagnose.unlisted.finding import unexplained, unexplained_of
from artibot_sim.diagnose.unlisted.fitting import fitted_laws
from artibot_sim.diagnose.words import force_words
from artibot_sim.errors import ArtibotError
from artibot_sim.identify.validation import hold_out
from artibot_sim.model import Robot, load_robot

NOTHING = "nothing"


class Task(NamedTuple):
    """What to hide."""

    name: str
    severity: float
    seed: int


class Seen(NamedTuple):
    """What came of a task.

    Attributes
    ----------
    task : Task
    more : bool
        Whether the soil's fit leaves more than noise.
    said : str
        The force in words; empty where there is none.
    nats : float
        What the regression says of it.
    right : bool
        Whether force and variable are the hidden one's.
    gain : float or None
        Share of the true model's gain on what is held out that the model with laws brings.
    seconds : float
        Of processor time, the soil's fit apart.
    """

    task: Task
    more: bool
    said: str = ""
    nats: float = 0.0
    right: bool = False
    gain: float | None = None
    seconds: float = 0.0


def seen(task: Task, runs: int, duration: float) -> Seen:
    """One case."""
    effects = () if task.name == NOTHING else (task.name,)
    hidden = case(effects, task.severity, task.seed, runs=runs, duration=duration)
    problem, fit = baseline(hidden.recordings, load_robot("agriq"), Options(workers=1))
    more, begun = leaves_more_than_noise(remains(problem, fit.point)), time.process_time()
    found = unexplained(problem, fit.point.coordinates)
    laws = None if found is None or not more else fitted_laws(problem, fit, found)
    took = time.process_time() - begun
    gain = None
    if hidden.truth.unlisted and more:
        without = case((), task.severity, task.seed, runs=runs, duration=duration)
        last = (problem, fit) if laws is None else (laws.problem, laws.fit)
        gain = _share(
            without, hidden, *(one.parameters.robot_at(at.point.coordinates) for one, at in ((problem, fit), last))
        )
    force = laws.force if laws is not None else found
    if force is None or not force.chosen:
        return Seen(task, more, gain=gain, seconds=took)
    what = unexplained_of(force)
    said = force_words(what) + ("" if laws is not None else " (no law)")
    right = is_described(vars(what), hidden.truth.unlisted)
    return Seen(task, more, said, force.chosen[0].worth, right, gain, took)


def _share(without: Case, hidden: Case, before: Robot, after: Robot) -> float | None:
    """Of the true model's gain on what is held out; `without` is the same case with nothing hidden."""
    ends = [
        {name: fit.rmse for name, fit in hold_out(hidden.holdout[0], robot, hidden.horizon, 1).summary.channels.items()}
        for robot in (before, after)
    ]
    gain = {name: {"before": ends[0][name], "after": ends[1][name]} for name in ends[0]}
    return relative_gain(gain, reference(without))


def tasks(seeds: Sequence[int], severities: Sequence[float], clean: int, names: Sequence[str]) -> list[Task]:
    """Everything on no list, and so many with nothing hidden."""
    found = [Task(name, severity, seed) for seed in seeds for severity in severities for name in names]
    return found + [Task(NOTHING, 0.0, seed) for seed in range(1, clean + 1)]


def line(one: Seen) -> str:
    """A case in a line."""
    said = f"{one.nats:8.1f}  {one.said}" if one.said else "       –  no force"
    mark = " " if one.task.name == NOTHING or not one.said else "+" if one.right else "!"
    noise = "" if one.more else "  (no more than noise is left: not asked for)"
    gain = "    –" if one.gain is None else f"{100 * one.gain:4.0f} %"
    return f"{one.task.name:<20}{one.task.severity:<5g}{one.task.seed:<6}{mark} {gain}{said}{noise} {one.seconds:.0f} s"


def counts(results: Sequence[Seen]) -> Iterator[str]:
    """How many are right, with binomial intervals."""
    for severity in sorted({one.task.severity for one in results if one.task.name != NOTHING}, reverse=True):
        acting = [one for one in results if one.task.severity == severity and one.task.name != NOTHING]
        asked = [one for one in acting if one.more]
        gains = [one.gain for one in asked if one.gain is not None]
        equal = [one.right or (one.gain is not None and one.gain >= MOST_OF_IT) for one in asked]
        yield f"severity {severity:g}: more than noise left in {with_interval(len(asked), len(acting))}; of these"
        yield f"  described rightly {with_interval(sum(one.right for one in asked), len(asked))}"
        yield f"  that, or as good in prediction {with_interval(sum(equal), len(asked))}"
        most = sum(one >= MOST_OF_IT for one in gains)
        yield f"  {MOST_OF_IT:.0%} of the true model's gain {with_interval(most, len(gains))}"
    clean = [one for one in results if one.task.name == NOTHING]
    if clean:
        found = sum(bool(one.said) for one in clean)
        yield f"nothing hidden: a force would be found in {with_interval(found, len(clean))}"
        yield f"  is asked for in {with_interval(sum(one.more for one in clean), len(clean))}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run all and print the table."""
    parser = argparse.ArgumentParser(prog="python -m diagnose.hidden.forces", description=__doc__)
    parser.add_argument("--seeds", default="1,2", help="by comma [1,2]")
    parser.add_argument("--severity", default="1,0.3", help="one or several, by comma [1,0.3]")
    parser.add_argument("--clean", type=int, default=24, help="cases with nothing hidden, of seeds 1 to so many [24]")
    parser.add_argument("--names", help="what to hide, by comma [all that is on no list]")
    parser.add_argument("--runs", type=int, default=2, help="recordings [2]")
    parser.add_argument("--duration", type=float, default=30.0, help="of each, s [30]")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes [all cores]")
    options = parser.parse_args(argv)
    try:
        seeds = [int(part) for part in options.seeds.split(",")]
        severities = [float(part) for part in options.severity.split(",")]
        todo = tasks(
            seeds, severities, options.clean, options.names.split(",") if options.names else (*UNLISTED, *LAWS)
        )
        results = []
        work = partial(seen, runs=options.runs, duration=options.duration)
        for _, result in map_tasks(work, todo, workers=options.workers):
            results.append(result)
            print(line(result), flush=True)
    except (ArtibotError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(counts(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
