"""Many trials with random faults: ``python -m artibot_driver.faults 1000 1`` (trials, seed).

In time of its own on a bus in memory, unless a channel is named: ``--channel loopback`` or, in a kernel with CAN,
``--channel vcan0`` try the same in real time on a real bus. The faults take turns; speed, direction, moment, drive and
duration are drawn from the seed, so that ``--only K`` does trial K again. ``--each`` makes so many trials of each fault
instead; ``--log FILE`` keeps them, and goes on from there where a campaign was broken off.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from artibot_driver.config import config_from_parameters
from artibot_driver.faults.catalogue import BY_NAME, CAN_PASS, ON_A_BUS, Fault, briefly, two
from artibot_driver.faults.closed_loop import VirtualLoop
from artibot_driver.faults.live_loop import LiveLoop, SwitchableBus, SwitchableLoopback, SwitchableSocketCan
from artibot_driver.faults.outcomes import Key, NotReady, TrialLog, TrialOutcome, table
from artibot_driver.faults.trial import FaultTrial
from artibot_driver.faults.watchdog import HELD_UP, Watchdog, attended
from artibot_driver.master import StopReason
from artibot_driver.rig import Rig, load_rig
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS
from artibot_sim.progress import Bar

LIVE_TRIES: Final = 10
"""So often a trial in real time is made where the machine holds it up."""

IN_MEMORY: Final = "memory"


class CampaignTask(NamedTuple):
    """A trial to be made: its number, and the names of the faults that it is drawn from."""

    number: int
    names: tuple[str, ...]

    @property
    def key(self) -> Key:
        """Under which its outcome is kept."""
        return self.number, "all" if self.names == tuple(BY_NAME) else ", ".join(self.names)


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


def virtual_trial(number: int, seed: int, names: Sequence[str]) -> TrialOutcome:
    """One trial in time of its own."""
    rng, fault, motor = draw(number, seed, [BY_NAME[name] for name in names])
    return FaultTrial(VirtualLoop(_rig(), rng), fault, motor).run()


@cache
def _rig() -> Rig:
    """The drives of all trials in time of its own."""
    return load_rig(config_from_parameters({}))


def live_trial(
    number: int, seed: int, names: Sequence[str], rig: Rig, bus: SwitchableBus, watchdog: Watchdog
) -> TrialOutcome:
    """One trial on a real bus; void, and made again, where the machine held something up meanwhile.

    That is said by the watchdog, or by a driver whose loop nothing else had held up. Also void is what did not come so
    far that the fault could be tried: nothing had happened yet.
    """
    complaints: list[str] = []
    for k in range(LIVE_TRIES):
        rng, fault, motor = draw(number, seed, [BY_NAME[name] for name in names])
        watchdog.longest()
        with LiveLoop(rig, rng, bus) as loop:
            try:
                outcome = FaultTrial(loop, fault, motor).run()
            except NotReady as error:
                complaints = [f"could not be tried: {error}"]
                continue
        outcome.void = k
        late = outcome.reason is StopReason.OVERRUN and StopReason.OVERRUN not in fault.reasons
        if not late and watchdog.longest().seconds <= HELD_UP:
            return outcome
    return TrialOutcome(
        fault.name, fault.group or fault.name, motor, complaints=complaints, void=LIVE_TRIES, judged=False
    )


def live_rig(names: Sequence[str]) -> Rig:
    """Drives for a trial in real time.

    A single processor that is bus, drives, driver and flood at once carries what fills 150 kbit/s, at half the rate.
    """
    slow = os.cpu_count() == 1 and "bus flooded" in names
    return load_rig(config_from_parameters({"bus.bitrate": 150_000, "sync_rate": 50.0} if slow else {}))


def live(tasks: Sequence[CampaignTask], seed: int, channel: str) -> Iterator[TrialOutcome]:
    """Outcomes of trials on a real bus, in order."""
    bus: SwitchableBus = SwitchableLoopback() if channel == "loopback" else SwitchableSocketCan(channel)
    try:
        with attended() as watchdog:
            for task in tasks:
                yield live_trial(task.number, seed, task.names, live_rig(task.names), bus, watchdog)
    finally:
        bus.close()


def virtual(tasks: Sequence[CampaignTask], seed: int, jobs: int) -> Iterator[TrialOutcome]:
    """Outcomes of trials in time of their own, in order."""
    if jobs == 1 or len(tasks) < 4:
        yield from (virtual_trial(task.number, seed, task.names) for task in tasks)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(virtual_trial, *zip(*((task.number, seed, task.names) for task in tasks), strict=True))


def tasks_of(trials: int, each: bool, names: Sequence[str]) -> list[CampaignTask]:
    """`trials` of the faults in turns; or so many of each, in rounds, so that any beginning has all."""
    if each:
        return [CampaignTask(number, (name,)) for number in range(trials) for name in names]
    return [CampaignTask(number, tuple(names)) for number in range(trials)]


def main(argv: Sequence[str] | None = None) -> int:
    """Run a campaign; status 1 where something was not as it must be, or could not be judged."""
    options = _parser().parse_args(argv)
    names = options.fault or (ON_A_BUS if options.each and options.channel else tuple(BY_NAME))
    tasks = tasks_of(options.trials, options.each, names)
    if options.only is not None:
        tasks = [task for task in tasks_of(options.only + 1, options.each, names) if task.number == options.only]
    try:
        outcomes = _run(tasks, options)
    except ArtibotError as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        kept = f"what is in {options.log} stays: the same command goes on" if options.log else "nothing is kept"
        print(f"broken off; {kept}", file=sys.stderr)
        return 130
    return _sum_up(outcomes, options)


def _run(tasks: Sequence[CampaignTask], options: argparse.Namespace) -> list[TrialOutcome]:
    """Make the trials that are not made yet; say what is wrong as soon as it is known."""
    trial_log = TrialLog(options.log, options.seed, options.channel or IN_MEMORY)
    left = [task for task in tasks if task.key not in trial_log.done]
    done = [trial_log.done[task.key] for task in tasks if task.key in trial_log.done]
    if done:
        print(f"{len(done)} trials are in {options.log} already; {len(left)} to go", flush=True)
    if options.channel and left:
        running = live(left, options.seed, options.channel)
    else:
        running = virtual(left, options.seed, options.jobs)
    with Bar(total=len(left)) as bar:
        for k, (task, outcome) in enumerate(zip(left, running, strict=True)):
            trial_log.write(task.key, outcome)
            done.append(outcome)
            for complaint in dict.fromkeys(outcome.complaints):
                text = f"trial {task.number} (seed {options.seed}): {outcome.fault}, {outcome.motor}: {complaint}"
                print(text, flush=True)
            bar.show(k + 1, outcome.fault)
    return done


def _sum_up(outcomes: Sequence[TrialOutcome], options: argparse.Namespace) -> int:
    print("\n".join(table(outcomes)))
    judged = [each for each in outcomes if each.judged]
    wrong, void = sum(bool(each.complaints) for each in judged), sum(each.void for each in outcomes)
    where = f"on {options.channel}" if options.channel else "on a bus in memory"
    print(f"{len(judged)} trials {where}, seed {options.seed}: {wrong} not as they must be", end="")
    print(f"; {void} void, for the machine held them up" if void else "", end="")
    unknown = len(outcomes) - len(judged)
    print(
        f"; {unknown} not judged, for it did so {LIVE_TRIES} times: try them again when it is quiet" if unknown else ""
    )
    return 1 if wrong or unknown else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m artibot_driver.faults",
        description="Random faults in a closed loop of driver and simulated drives, with a summary.",
        epilog="Example: python -m artibot_driver.faults 1000 1; of each fault 100 on a real bus: "
        "… 100 1 --each --channel vcan0 --log faults.jsonl",
    )
    parser.add_argument("trials", type=int, nargs="?", default=100)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--channel", default="", help="loopback, or a SocketCAN interface; [a bus in memory]")
    parser.add_argument("--each", action="store_true", help="so many trials of each fault; on a real bus of those "
                        "that a bus has a part in, and one of each other kind")  # fmt: skip
    parser.add_argument(
        "--fault", action="append", default=[], choices=sorted(BY_NAME), help="only this one; repeatable"
    )
    parser.add_argument("--only", type=int, metavar="K", help="only trial K of the campaign")
    parser.add_argument("--log", type=Path, metavar="FILE", help="keep the trials there, and go on where it ends")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes, in memory [all cores]")
    return parser
