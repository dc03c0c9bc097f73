"""Every fault of the catalogue, in time of its own on a bus in memory.

ARTIBOT_TRIALS gives more or fewer of each, ARTIBOT_SEED others.
"""

from __future__ import annotations

import json
import os
import random
import signal
import time
from pathlib import Path

import pytest

from artibot_driver.cia402 import DriveState
from artibot_driver.config import config_from_parameters
from artibot_driver.faults import campaign
from artibot_driver.faults.catalogue import BRIEFLY, BY_NAME, CAN_PASS, CATALOGUE, TWO, Fault, briefly, two
from artibot_driver.faults.closed_loop import ClosedLoop, VirtualLoop
from artibot_driver.faults.simulated_bus import Interference, UnreliableBus, memory_buses
from artibot_driver.faults.trial import BEFORE_END, FaultTrial
from artibot_driver.faults.watchdog import HELD_UP, Watchdog
from artibot_driver.frames import Frame
from artibot_driver.master import Master, Phase, StopReason
from artibot_driver.rig import load_rig
from artibot_sim.model import MOTORS

TRIALS, SEED = int(os.environ.get("ARTIBOT_TRIALS", "1")), int(os.environ.get("ARTIBOT_SEED", "1"))


@pytest.mark.parametrize("name", BY_NAME)
def test_what_must_follow_a_fault_does(name: str) -> None:
    for number in range(TRIALS):
        outcome = campaign.virtual_trial(number, SEED, [name])
        assert not outcome.complaints, (f"seed {SEED}, trial {number}", outcome)


@pytest.mark.parametrize("number", range(TRIALS))
def test_two_faults_at_once_and_those_that_pass_by_end_well_too(number: int) -> None:
    rng = random.Random(f"{SEED}/{number}")
    pair = two(*rng.sample(CATALOGUE, 2), rng.uniform(0.0, 0.3))
    for fault in (pair, briefly(rng.choice(CAN_PASS), rng.uniform(0.01, 0.15))):
        outcome = FaultTrial(VirtualLoop(load_rig(config_from_parameters({})), rng), fault, rng.choice(MOTORS)).run()
        assert not outcome.complaints, (f"seed {SEED}, trial {number}", outcome)


def test_a_campaign_has_all_faults_and_both_kinds_made_of_others() -> None:
    drawn = [campaign.draw(number, SEED, CATALOGUE)[1] for number in range(300)]
    assert {fault.name for fault in CATALOGUE} <= {fault.name for fault in drawn}
    assert {fault.group for fault in drawn} == {"", TWO, BRIEFLY}


def test_the_names_are_unique() -> None:
    assert len(BY_NAME) == len(CATALOGUE)


def test_the_same_seed_gives_the_same_trial() -> None:
    one, other = (campaign.virtual_trial(7, 3, ["drive fault", "10 % of frames lost"]) for _ in range(2))
    assert one == other


def test_mishaps_that_are_counted_do_happen() -> None:
    w = VirtualLoop(load_rig(config_from_parameters({})), random.Random(1))
    assert w.run_until(Phase.READY, 3.0)
    w.unreliable.interference = Interference(0.1, 0.1, 0.1, 0.1)
    w.run(3.0)
    assert all(w.unreliable.done[kind] > 100 for kind in ("lost", "duplicated", "reordered", "truncated"))
    counters = w.last.status.counters
    assert all(counters[kind] > 20 for kind in ("malformed", "duplicate", "out_of_order", "missed_feedback"))


def test_an_unreliable_bus_invents_nothing_and_keeps_nothing() -> None:
    near, far = memory_buses()
    bus = UnreliableBus(near, random.Random(2))
    bus.interference = Interference(reordered=0.3, duplicated=0.2)
    for k in range(200):
        bus.send(Frame(k, b""))
    bus.interference = Interference()
    bus.send(Frame(200, b""))
    sent = [frame.can_id for frame in far.inbox]
    assert sorted(set(sent)) == list(range(201))
    assert sent != sorted(sent)
    assert len(sent) == 201 + bus.done["duplicated"]


class Deaf(Master):
    """A master that does not notice when a drive falls silent."""

    def _trouble(self, now, last, asked):  # type: ignore[no-untyped-def]
        stop = super()._trouble(now, last, asked)
        return None if stop is not None and stop.reason is StopReason.DRIVE_SILENT else stop


class Eager(Master):
    """A master that follows commands from before the enable."""

    def _take_setpoints(self, now, given):  # type: ignore[no-untyped-def]
        self._armed = 0
        return super()._take_setpoints(now, given)


class Abrupt(Master):
    """A master whose ramp is half as steep as it should be."""

    def _move(self, now, dt):  # type: ignore[no-untyped-def]
        return super()._move(now, 0.5 * dt)


class Stubborn(Master):
    """A master whose stop enables drives that are not."""

    def _aim(self, link):  # type: ignore[no-untyped-def]
        powered = self._phase.moves and self._released is None
        return DriveState.OPERATION_ENABLED if powered else DriveState.SWITCH_ON_DISABLED


class Hasty(Master):
    """A master that speaks again without listening."""

    def poll(self, now_ns):  # type: ignore[no-untyped-def]
        self._receiver.note_sent(now_ns, self._receiver.alone)
        super().poll(now_ns)


@pytest.mark.parametrize(
    ("master", "fault", "complaint"),
    [
        (Deaf, BY_NAME["drive unplugged"], "had to stop|not slowed down|not at rest"),
        (Eager, BY_NAME["drive fault"], "moved on a command from before the enable"),
        (Abrupt, BY_NAME["emergency message"], "was not at rest"),
        (Stubborn, BY_NAME["drive lets go"], "was enabled again"),
        (Hasty, BY_NAME["bus-off"], "did not listen"),
    ],
)
def test_a_trial_notices_a_driver_that_is_at_fault(master: type[Master], fault: Fault, complaint: str) -> None:
    w = VirtualLoop(load_rig(config_from_parameters({})), random.Random(5))
    w.master = master(w.unreliable, w.rig, clock=lambda: w.now)
    outcome = FaultTrial(w, fault, "back_left").run()
    assert any(part in each for each in outcome.complaints for part in complaint.split("|")), outcome


def test_a_stop_that_comes_late_is_watched_to_its_end() -> None:
    """What need not stop at all may do so in the last moment that is watched; the ramp takes its time after that."""

    def inject(loop: ClosedLoop, motor: str) -> None:
        before, late = loop.command, loop.now + round(1e9 * (BEFORE_END + ramp + trial.duration - 0.2))
        loop.command = lambda now: before(now) if now < late else None

    fault = Fault("silence, later", inject, lambda loop, motor: None, False, 0.15, (StopReason.COMMAND_SILENCE,))
    w = VirtualLoop(load_rig(config_from_parameters({})), random.Random(5))
    trial = FaultTrial(w, fault, "back_left")
    ramp = trial.speed / w.rig.config.stop_deceleration
    outcome = trial.run()
    assert outcome.stopped and not outcome.complaints, outcome


def test_a_campaign_says_what_it_has_done(capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign.main(["2", "5", "--fault", "drive fault", "--fault", "unknown nodes", "--jobs", "1"]) == 0
    said = capsys.readouterr().out.splitlines()
    heads = ("fault", "trials", "stopped", "went on", "reaction", "most", "at rest", "back", "most", "void", "wrong")
    assert said[0].split() == " ".join(heads).split()
    assert said[1].startswith("drive fault")
    assert said[1].split()[2:5] == ["1", "1", "0"]
    assert said[2].split()[2:5] == ["1", "0", "1"]
    assert said[3] == "2 trials on a bus in memory, seed 5: 0 not as they must be"


def test_a_campaign_that_was_broken_off_goes_on_where_it_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "trials.jsonl"
    words = ["2", "5", "--each", "--fault", "drive fault", "--fault", "unknown nodes", "--jobs", "1", "--log", str(log)]
    assert campaign.main(words) == 0
    whole, table = log.read_text(encoding="utf-8"), capsys.readouterr().out
    lines = whole.splitlines()
    assert [json.loads(line)["fault"] for line in lines] == ["drive fault", "unknown nodes"] * 2
    log.write_text("\n".join(lines[:2]) + "\n" + lines[2][:40], encoding="utf-8")
    assert campaign.main(words) == 0
    said = capsys.readouterr().out
    assert said == f"2 trials are in {log} already; 2 to go\n{table}"
    assert [line for line in log.read_text(encoding="utf-8").splitlines() if line in lines] == lines
    assert campaign.main([*words[:1], "6", *words[2:]]) == 0  # another seed's trials are others
    assert len(log.read_text(encoding="utf-8").splitlines()) == 4 + 1 + 4


def test_a_log_that_is_something_else_is_refused_and_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "notes.txt"
    log.write_text("not a trial", encoding="utf-8")
    assert campaign.main(["1", "--log", str(log)]) == 2
    assert "notes.txt: line 1: found no trial" in capsys.readouterr().err
    assert log.read_text(encoding="utf-8") == "not a trial"


class Quick(VirtualLoop):
    """A loop in time of its own in place of one in real time; while it lasts the watchdog may be held up."""

    held_up: list[int] = []  # noqa: RUF012  # processes to be held up, one after the other

    def __init__(self, rig, rng, place):  # type: ignore[no-untyped-def]
        super().__init__(rig, rng)

    def __enter__(self):  # type: ignore[no-untyped-def]
        if self.held_up:
            process = self.held_up.pop()
            os.kill(process, signal.SIGSTOP)
            time.sleep(4 * HELD_UP)
            os.kill(process, signal.SIGCONT)
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_trial_that_the_machine_held_up_is_void_and_never_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "LiveLoop", Quick)
    rig = load_rig(config_from_parameters({}))
    monkeypatch.setattr(campaign, "LIVE_TRIES", 3)
    with Watchdog(0) as watchdog:
        Quick.held_up = [watchdog.process.pid] * 2
        outcome = campaign.live_trial(1, 1, ["drive fault"], rig, None, watchdog)  # type: ignore[arg-type]
        assert not outcome.judged or (outcome.void >= 2 and outcome.stopped)
        assert not Quick.held_up
        monkeypatch.setattr(campaign, "LIVE_TRIES", 2)
        Quick.held_up = [watchdog.process.pid] * 2
        outcome = campaign.live_trial(1, 1, ["drive fault"], rig, None, watchdog)  # type: ignore[arg-type]
    assert (outcome.judged, outcome.void, outcome.complaints) == (False, 2, [])


def test_the_watchdog_sees_who_was_held_up_and_for_how_long() -> None:
    with Watchdog(0) as watchdog:
        watchdog.longest()
        os.kill(watchdog.process.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(watchdog.process.pid, signal.SIGCONT)
        time.sleep(0.05)
        stall = watchdog.longest()
    assert stall.seconds > 0.25
    assert stall.whose.startswith("processor")


def test_a_campaign_on_a_bus_that_is_not_there_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign.main(["1", "--channel", "nosuchcan0"]) == 2
    assert "nosuchcan0" in capsys.readouterr().err
