"""Two drivers on one bus: the second listens first, and leaves the drives to the one that leads them."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import can
import pytest

from artibot_driver.bus import BusState, Health
from artibot_driver.cia402 import DriveState
from artibot_driver.config import config_from_parameters
from artibot_driver.faults.closed_loop import VirtualLoop
from artibot_driver.faults.simulated_bus import message_of
from artibot_driver.frames import Frame, NmtState, heartbeat
from artibot_driver.master import Master, MasterCycle, Phase, Setpoints, StopReason
from artibot_driver.master.reception import LISTEN_TIME
from artibot_driver.rig import load_rig

RIG = load_rig(config_from_parameters({}))


class Tap:
    """A third end of a loop's bus: hears master and drives, and is heard by both."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop
        self.inbox: deque[Frame] = deque()
        self.sent: list[Frame] = []
        for end in (loop._near, loop._far):
            end.send = self._heard(end.send)  # type: ignore[method-assign]

    def _heard(self, send):  # type: ignore[no-untyped-def]
        def also(frame: Frame) -> bool:
            sent = send(frame)
            self.inbox.extend([frame] * sent)
            return sent

        return also

    def send(self, frame: Frame) -> bool:
        self.sent.append(frame)
        self._loop.inject([frame])
        return True

    def receive(self, timeout: float = 0.0) -> can.Message | None:
        return message_of(self.inbox.popleft()) if self.inbox else None

    def health(self) -> Health:
        return Health(BusState.ACTIVE, None, None, "")


class Two:
    """A rover under way, and another driver that is started."""

    def __init__(self) -> None:
        self.first = VirtualLoop(RIG, random.Random(1))
        assert self.first.run_until(Phase.READY, 3.0)
        self.first.master.enable()
        assert self.first.run_until(Phase.ENABLED, 1.0)
        self.first.command = lambda now: Setpoints((60.0, 50.0), now)
        self.first.run(0.3)
        self.tap = Tap(self.first)
        self.second = Master(self.tap, RIG, clock=lambda: self.first.now)

    def run(self, seconds: float) -> MasterCycle:
        """Let time pass for both; what the second one says last."""
        for _ in range(round(seconds / 0.01)):
            cycle = self.second.cycle(self.first.now, Setpoints((30.0, 30.0), self.first.now))
            self.first.run(0.01)
        return cycle


@pytest.fixture
def two() -> Two:
    return Two()


class Silence(NamedTuple):
    """How a driver comes to say nothing, and to speak again."""

    begin: Callable[[VirtualLoop], object]
    end: Callable[[VirtualLoop], object]


SILENCES = {
    "bus-off": Silence(VirtualLoop.bus_off, VirtualLoop.bus_on),
    "hangs": Silence(lambda w: setattr(w, "hung", True), lambda w: setattr(w, "hung", False)),
    "cannot send": Silence(lambda w: setattr(w.unreliable, "cut", True), lambda w: setattr(w.unreliable, "cut", False)),
}


@pytest.fixture(params=SILENCES)
def silence(request: pytest.FixtureRequest) -> Silence:
    return SILENCES[request.param]


def test_the_second_says_nothing_and_the_first_drives_on(two: Two) -> None:
    status = two.run(1.0).status
    assert status.phase is Phase.LISTENING
    assert status.other_driver == "somebody else leads the drives: heard RPDO1 for node 1; end that driver"
    two.second.enable()
    two.second.reset_fault()
    assert "enable refused: somebody else leads the drives" in two.run(0.5).status.notice
    two.second.close(two.first.now)
    two.first.run(0.2)
    assert two.tap.sent == []
    assert two.first.last.status.phase is Phase.ENABLED
    assert two.first.trace[-1].drives.asked[0].velocity == pytest.approx(60.0, abs=1e-3)
    assert not two.first.last.status.counters["foreign_commands"]


def test_the_second_takes_over_once_the_drives_have_missed_the_first(two: Two) -> None:
    two.run(0.5)
    two.first.hung, begin = True, len(two.first.trace)
    status = two.run(2.0).status
    assert status.phase is Phase.LOCKED  # all four are in fault: somebody has to look
    assert status.other_driver == ""
    asked = [abs(sample.drives.asked[0].velocity or 0.0) for sample in two.first.trace[begin:]]
    assert all(b <= a for a, b in pairwise(asked))
    two.second.reset_fault()
    assert two.run(1.5).status.phase is Phase.READY
    two.second.enable()
    assert two.run(1.0).status.phase is Phase.ENABLED


def test_one_that_was_silent_leaves_the_drives_to_who_leads_them_now(two: Two, silence: Silence) -> None:
    silence.begin(two.first)
    assert two.run(2.0).status.phase is Phase.LOCKED
    two.second.reset_fault()
    assert two.run(1.5).status.phase is Phase.READY
    two.second.enable()
    assert two.run(0.5).status.phase is Phase.ENABLED
    silence.end(two.first)
    first = len(two.first.trace)
    cycle = two.run(1.5)
    assert cycle.status.phase is Phase.ENABLED
    assert not cycle.status.counters["foreign_commands"]
    assert cycle.status.counters["foreign_sync"] <= 1  # where it could not know that its first word would get through
    status = two.first.last.status
    assert status.phase is Phase.LISTENING
    assert status.other_driver.startswith("somebody else leads the drives: heard ")
    assert all({*sample.drives.state} == {DriveState.OPERATION_ENABLED} for sample in two.first.trace[first:])


@pytest.mark.parametrize("seed", range(4))
def test_what_still_waited_in_the_interface_of_one_whose_cable_was_off_stops_another(two: Two, seed: int) -> None:
    """Nobody can take such frames back: they are set-points of long ago, among those of who leads the drives now."""
    two.first.rng.seed(seed)
    two.first.cable_off()
    assert two.run(2.0).status.phase is Phase.LOCKED
    two.second.reset_fault()
    assert two.run(1.5).status.phase is Phase.READY
    two.second.enable()
    assert two.run(0.5).status.phase is Phase.ENABLED
    first = len(two.first.trace)
    two.first.cable_on()
    stop = two.run(0.01).status.stop
    assert stop is not None and stop.reason is StopReason.SECOND_DRIVER
    assert two.run(0.5).status.counters["foreign_commands"] >= 4
    asked = [abs(sample.drives.asked[0].velocity or 0.0) for sample in two.first.trace[first:]]
    assert asked[0] < 30.0 and asked[-1] == 0.0
    assert all(b <= a for a, b in pairwise(asked))
    assert two.first.last.status.phase is Phase.LISTENING


def test_one_that_was_silent_for_long_listens_first_and_is_soon_back(silence: Silence) -> None:
    w = VirtualLoop(RIG, random.Random(1))
    assert w.run_until(Phase.READY, 3.0)
    silence.begin(w)
    w.run(5.0)
    silence.end(w)
    begin = w.now
    assert w.run_until(Phase.LISTENING, 0.1)
    assert w.run_until(Phase.LOCKED, 2.0 - 1e-9 * (w.now - begin))  # the drives have missed it


def test_one_that_was_silent_for_less_than_others_listen_goes_on(silence: Silence) -> None:
    w = VirtualLoop(RIG, random.Random(1))
    assert w.run_until(Phase.READY, 3.0)
    silence.begin(w)
    w.run(1e-9 * LISTEN_TIME - 2e-9 * w.period)
    silence.end(w)
    first = len(w.trace)
    w.run(0.5)
    assert Phase.LISTENING not in {sample.cycle.status.phase for sample in w.trace[first:] if sample.cycle}


def test_one_that_cannot_send_listens_without_end() -> None:
    """A cable that is unplugged: the controller takes no frames any more, and says nothing of that."""
    w = VirtualLoop(RIG, random.Random(1))
    assert w.run_until(Phase.READY, 3.0)
    w.unreliable.cut = True
    w.run(1.0)
    first = len(w.trace)
    w.run(3.0)
    assert {sample.cycle.status.phase for sample in w.trace[first:] if sample.cycle} == {Phase.LISTENING}


@pytest.mark.parametrize(
    "said",
    [
        RIG.codec.sync(),
        heartbeat(RIG.config.driver_id, NmtState.OPERATIONAL),
        RIG.codec.pdo("RPDO1", RIG.codec.nodes["back_left"], (0, 0, 0)),
    ],
)
def test_whatever_a_driver_says_keeps_another_one_silent(said: Frame) -> None:
    w = VirtualLoop(RIG, random.Random(1))
    tap = Tap(w)
    for _ in range(50):
        w.inject([said])
        w.run(0.05)
        tap.inbox = deque(frame for frame in tap.inbox if frame.can_id & 0x780 != 0x700)  # boot-ups of the drives
    assert not tap.inbox
    assert w.last.status.phase is Phase.LISTENING
    assert w.run_until(Phase.READY, 2.0)


def test_what_drives_and_strangers_say_keeps_nobody_silent() -> None:
    w = VirtualLoop(RIG, random.Random(1))
    w.noise = 5
    for node in RIG.codec.nodes.values():
        w.inject([RIG.codec.pdo("TPDO1", node, (0x250, 0, 0)), heartbeat(node, NmtState.OPERATIONAL)])
    assert w.run_until(Phase.READY, 2.0)


def test_the_first_word_comes_after_listening_and_again_after_another_bus() -> None:
    w = VirtualLoop(RIG, random.Random(1))
    tap = Tap(w)
    w.hung = True
    w.run(0.1)
    tap.inbox.clear()
    w.hung, begin = False, w.now
    while not any(frame.can_id == RIG.codec.sync_id for frame in tap.inbox):
        assert w.now - begin <= LISTEN_TIME + 2 * w.period
        w.run(0.01)
    assert w.now - begin >= LISTEN_TIME
    assert w.run_until(Phase.READY, 2.0)
    w.master.use_bus(w.unreliable)
    tap.inbox.clear()
    w.run(1e-9 * LISTEN_TIME - 0.01)
    assert not any(frame.can_id == RIG.codec.sync_id for frame in tap.inbox)
    assert w.run_until(Phase.LOCKED, 2.0)  # meanwhile the drives have missed it


@pytest.mark.parametrize("seed", range(10))
def test_of_two_started_at_once_one_leads_and_the_other_is_silent(seed: int) -> None:
    rng = random.Random(seed)
    w = VirtualLoop(RIG, rng)
    w.master = Master(w.unreliable, RIG, clock=lambda: w.now, delay=rng.random)
    tap = Tap(w)
    other = Master(tap, RIG, clock=lambda: w.now, delay=rng.random)
    for _ in range(300):
        phases = {other.cycle(w.now, None).status.phase, w.last.status.phase if w.trace else Phase.OFFLINE}
        w.run(0.01)
        assert {*w.trace[-1].drives.state} <= {DriveState.NOT_READY_TO_SWITCH_ON, DriveState.SWITCH_ON_DISABLED}
    assert phases == {Phase.READY, Phase.LISTENING}
    first = w.master if w.last.status.phase is Phase.READY else other
    first.enable()
    for _ in range(20):
        other.cycle(w.now, None)
        w.run(0.01)
    assert {*w.trace[-1].drives.state} == {DriveState.OPERATION_ENABLED}


def test_listening_outlasts_drives_that_wait_long_for_their_driver() -> None:
    """Whoever takes over finds no drive that still follows the driver before."""
    rig = load_rig(config_from_parameters({"heartbeat.driver_timeout": 1.0}))
    w = VirtualLoop(rig, random.Random(1))
    assert w.run_until(Phase.READY, 5.0)
    w.master.enable()
    assert w.run_until(Phase.ENABLED, 1.0)
    w.command = lambda now: Setpoints((60.0, 60.0), now)
    w.run(0.3)
    w.new_master()
    assert w.run_until(Phase.CONFIGURING, 3.0)
    assert DriveState.OPERATION_ENABLED not in w.trace[-2].drives.state  # before its first word
