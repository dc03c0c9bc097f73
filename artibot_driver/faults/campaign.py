"""Many trials with random faults: ``python -m artibot_driver.faults 1000 1`` (trials, seed).

In time of its own on a bus in memory, unless a channel is named: ``--channel loopback`` or, in a kernel with CAN,
``--channel vcan0`` try the same in real time on a real bus. The faults take turns; speed, direction, moment, drive and
duration are drawn from the seed, so that ``--only K`` does trial K again.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from artibot_driver.config import config_from_parameters
from artibot_driver.faults.catalogue import BY_NAME, CATALOGUE, Fault
from artibot_driver.faults.combined import CAN_PASS, briefly, two
from artibot_driver.faults.live import LiveWorld
from artibot_driver.faults.place import LoopbackPlace, Place, SocketCanPlace
from artibot_driver.faults.trial import NotReady, Outcome, Trial
from artibot_driver.faults.world import VirtualWorld
from artibot_driver.rig import Rig, load_rig
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS

LIVE_TRIES = 5
"""So often a trial in real time is made again where the machine held it up."""


def draw(number: int, seed: int, faults: Sequence[Fault]) -> tuple[random.Random, Fault, str]:
    """What trial `number` is about, and where its other numbers come from.

    The faults take turns; where there are several, every eighth is one of them that soon passes by, or two at once.
    """
    rng = random.Random(f"{seed}/{number}")
    fault, kind = faults[number % len(faults)], rng.random()
    passing = [each for each in CAN_PASS if each in faults]
    if len(faults) > 1 and kind < 0.125:
        fault = two(fault, rng.choice(faults), rng.uniform(0.0, 0.3))
    elif passing and len(faults) > 1 and kind < 0.25:
        fault = briefly(rng.choice(passing), rng.uniform(0.01, 0.15))
    return rng, fault, rng.choice(MOTORS)


def virtual_trial(number: int, seed: int, names: Sequence[str]) -> Outcome:
    """One trial in time of its own."""
    rng, fault, motor = draw(number, seed, [BY_NAME[name] for name in names])
    return Trial(VirtualWorld(load_rig(config_from_parameters({})), rng), fault, motor).run()


def live_trial(number: int, seed: int, faults: Sequence[Fault], rig: Rig, place: Place) -> Outcome:
    """One trial on a real bus; made again where the machine held the loop or the drives up.

    The last is judged with so much more time as it was held up for.
    """
    for k in range(LIVE_TRIES):
        rng, fault, motor = draw(number, seed, faults)
        with LiveWorld(rig, rng, place) as world:
            try:
                outcome = Trial(world, fault, motor).run()
            except NotReady as error:
                complaint = f"could not be tried: {error}"
                outcome = Outcome(fault.name, fault.group or fault.name, motor, complaints=[complaint])
            outcome.disturbed = k
            if not world.slack:
                break
    return outcome


def trials(numbers: Sequence[int], seed: int, faults: Sequence[Fault], channel: str, jobs: int) -> Iterator[Outcome]:
    """Outcomes of all trials, in order."""
    if not channel:
        names = [fault.name for fault in faults]
        if jobs == 1 or len(numbers) < 4:
            yield from (virtual_trial(number, seed, names) for number in numbers)
            return
        with ProcessPoolExecutor(jobs) as pool:
            yield from pool.map(partial(virtual_trial, seed=seed, names=names), numbers)
        return
    rig = load_rig(config_from_parameters({}))
    place: Place = LoopbackPlace() if channel == "loopback" else SocketCanPlace(channel)
    try:
        yield from (live_trial(number, seed, faults, rig, place) for number in numbers)
    finally:
        place.close()


def table(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """The summary, line by line: largest times in s."""
    groups: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        groups[outcome.group].append(outcome)
    yield f"{'fault':<28}{'trials':>7}{'stopped':>9}{'went on':>9}{'reaction':>10}{'at rest':>9}{'back':>7}{'wrong':>7}"
    for name, group in groups.items():
        stopped = [each for each in group if each.stopped]
        times = [_largest(getattr(each, what) for each in stopped) for what in ("reaction", "standing", "rejoined")]
        wrong = sum(bool(each.complaints) for each in group)
        counts = f"{len(group):>7}{len(stopped):>9}{len(group) - len(stopped):>9}"
        yield f"{name:<28}{counts}{times[0]:>10}{times[1]:>9}{times[2]:>7}{wrong:>7}"


def _largest(values: Iterable[float]) -> str:
    known = [value for value in values if value == value]
    return f"{max(known):.2f}" if known else "–"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a campaign; status 1 where something was not as it must be."""
    options = _parser().parse_args(argv)
    faults = [BY_NAME[name] for name in options.fault] or list(CATALOGUE)
    numbers = list(range(options.trials)) if options.only is None else [options.only]
    outcomes: list[Outcome] = []
    try:
        running = trials(numbers, options.seed, faults, options.channel, options.jobs)
        for number, outcome in zip(numbers, _shown(running, len(numbers)), strict=True):
            outcomes.append(outcome)
            for complaint in dict.fromkeys(outcome.complaints):
                print(
                    f"trial {number} (seed {options.seed}): {outcome.fault}, {outcome.motor}: {complaint}", flush=True
                )
    except ArtibotError as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(table(outcomes)))
    wrong = sum(bool(each.complaints) for each in outcomes)
    repeated = sum(each.disturbed for each in outcomes)
    where = options.channel or "a bus in memory"
    print(f"{len(outcomes)} trials on {where}, seed {options.seed}: {wrong} not as they must be", end="")
    print(f"; {repeated} made again, for the machine held them up" if repeated else "")
    return 1 if wrong else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m artibot_driver.faults",
        description="Random faults in a closed loop of driver and simulated drives, with a summary.",
        epilog="Example: python -m artibot_driver.faults 1000 1; on a real bus: … 100 1 --channel vcan0",
    )
    parser.add_argument("trials", type=int, nargs="?", default=100)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--channel", default="", help="loopback, or a SocketCAN interface; [a bus in memory]")
    parser.add_argument(
        "--fault", action="append", default=[], choices=sorted(BY_NAME), help="only this one; repeatable"
    )
    parser.add_argument("--only", type=int, metavar="K", help="only trial K of the campaign")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes, in memory [all cores]")
    return parser


def _shown(outcomes: Iterable[Outcome], total: int) -> Iterator[Outcome]:
    """The same, with a bar where somebody looks."""
    if not sys.stderr.isatty():
        yield from outcomes
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(outcomes, "faults", total=total, console=Console(stderr=True))
