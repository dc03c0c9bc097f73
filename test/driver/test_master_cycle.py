"""What the master commands, cycle by cycle, in time of its own: eq. 30 on the wire, ramps, requests, limits."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from artibot_driver.cia402 import Command, DriveState, command_of, statusword
from artibot_driver.config import config_from_parameters
from artibot_driver.faults.closed_loop import VirtualLoop
from artibot_driver.faults.simulated_bus import message_of
from artibot_driver.frames import Frame, Heartbeat, Sync
from artibot_driver.master import Master, Phase, Setpoints, SetupStage, StopReason
from artibot_driver.pdo import Pdo
from artibot_driver.rig import frame_bits, load_rig
from artibot_sim.model import MOTORS
from artibot_sim.sharing import Law, load_law

RIG = load_rig(config_from_parameters({}))
TURN = VirtualLoop(RIG, random.Random(0)).turn


class Logged(VirtualLoop):
    """Notes every frame on the wire, in order, as ``candump`` does."""

    def __init__(self, seed: int = 1) -> None:
        super().__init__(RIG, random.Random(seed))
        self.log: list[Frame] = []
        for end in (self._near, self._far):
            end.send = self._noting(end.send)  # type: ignore[method-assign]

    def _noting(self, send):  # type: ignore[no-untyped-def]
        def note(frame: Frame) -> bool:
            self.log.append(frame)
            return send(frame)

        return note

    def enabled(self) -> Logged:
        assert self.run_until(Phase.READY, 3.0)
        self.master.enable()
        assert self.run_until(Phase.ENABLED, 1.0)
        return self


def periods(log: list[Frame]) -> Iterator[tuple[dict[int, Pdo], dict[int, Pdo]]]:
    """RPDO1s of each period, by node, and the TPDO1s that answered its SYNC."""
    asked: dict[int, Pdo] = {}
    answered: dict[int, Pdo] = {}
    for frame in log:
        said = RIG.codec.decode(*frame)
        if isinstance(said, Pdo) and said.map.name == "RPDO1":
            if answered:
                yield asked, answered
                asked, answered = {}, {}
            asked[said.node] = said
        elif isinstance(said, Pdo) and said.map.name == "TPDO1":
            answered[said.node] = said


@pytest.mark.parametrize("kappa", [0.8, 0.65])
def test_back_torques_are_eq_30_of_the_front_torques_of_the_period_before(kappa: float) -> None:
    """From the frames alone, and by the equation as printed: each back torque to one count."""
    w = Logged().enabled()
    w.log.clear()
    w.command = lambda now: Setpoints((100 * math.sin(now * 6e-9), 80 * math.sin(now * 5e-9)), now, kappa=kappa)
    w.run(3.0)
    factor = 47.64 / 28.93 * (1 - kappa) / kappa / 2
    seen = 0
    for (_, before), (asked, _) in itertools.pairwise(periods(w.log)):
        total = -before[1].value("torque_actual_value") + before[2].value("torque_actual_value")  # right motors: −1
        for node, sign in ((3, -1), (4, 1)):
            assert abs(asked[node].value("target_torque") - sign * factor * total) <= 0.5 + 1e-6
        seen += abs(total) > 50
    assert seen > 100


def test_kappa_changes_from_one_period_to_the_next() -> None:
    w = Logged().enabled()
    torques = []
    for kappa in (1.0, 0.622):
        w.command = lambda now, kappa=kappa: Setpoints((100 * math.sin(now * 6e-9),) * 2, now, kappa=kappa)
        w.run(0.5)
        torques.append(max(abs(s.cycle.commanded.back_effort[0]) for s in w.trace[-40:] if s.cycle))
    assert torques[0] == 0.0
    assert torques[1] > 0.05


def test_a_law_sets_the_back_torques_from_the_front_ones() -> None:
    """From the frames: the outer motor's torque exceeds the inner one's by what vectoring adds to eq. 30."""
    w = Logged().enabled()
    w.log.clear()
    law = load_law("vectoring:gain=1")
    w.command = lambda now: Setpoints((60 * math.sin(now * 6e-9), 30 * math.sin(now * 6e-9)), now, kappa=1.0, law=law)
    w.run(2.0)
    seen = 0
    for (_, before), (asked, _) in itertools.pairwise(periods(w.log)):
        front = sum(abs(before[node].value("torque_actual_value")) for node in (1, 2))
        right, left = -asked[3].value("target_torque"), asked[4].value("target_torque")
        assert abs(right + left) <= 1  # kappa 1: nothing on average
        moves = any(asked[node].value("target_velocity") for node in (1, 2))
        assert abs(abs(right - left) - front * 30 / 90) <= 2 or not moves
        seen += front > 50
    assert seen > 50


def test_a_law_that_fails_stops_the_rover_and_leaves_the_back_motors_without_torque() -> None:
    def failing(robot: object, cycle: object) -> tuple[float, float]:
        raise ZeroDivisionError("in a law")

    w = Logged().enabled()
    law = Law("failing", "Fails.", failing)
    w.command = lambda now: Setpoints((60.0, 60.0), now, kappa=0.7, law=law)
    w.run(0.2)
    assert w.last.status.stop is not None and w.last.status.stop.reason is StopReason.INVALID_COMMAND
    assert "ZeroDivisionError: in a law" in w.last.status.stop.text
    driven = [s.cycle.commanded for s in w.trace if s.cycle and not math.isnan(s.cycle.commanded.back_effort[0])]
    assert driven[-1].back_effort == pytest.approx((0.0, 0.0), abs=0.3)


def test_what_is_said_to_be_commanded_is_what_the_frames_say() -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((33.333333, -21.7), now, (math.nan, 0.1234))
    w.run(0.3)
    w.log.clear()
    w.run(0.02)
    asked, _ = next(periods(w.log))
    commanded = w.last.commanded
    for k, node, name in ((0, 1, "front_right"), (1, 2, "front_left")):
        raw = asked[node].value("target_velocity")
        assert commanded.front_velocity[k] == RIG.scaling[name].velocity.si(raw)
        assert abs(commanded.front_velocity[k] - (33.333333, -21.7)[k]) <= abs(RIG.scaling[name].velocity.step) / 2
    assert asked[4].value("target_torque") == round(123.4 / 0.6)
    assert commanded.back_effort[1] == pytest.approx(0.1234, abs=3e-4)


def test_every_period_has_four_rpdos_one_sync_and_heartbeats_in_time() -> None:
    w = Logged().enabled()
    w.log.clear()
    w.run(1.0)
    said = [RIG.codec.decode(*frame) for frame in w.log]
    assert sum(isinstance(each, Sync) for each in said) == 100
    assert sum(isinstance(each, Pdo) and each.map.name == "RPDO1" for each in said) == 400
    beats = sum(isinstance(each, Heartbeat) and each.node == RIG.config.driver_id for each in said)
    assert abs(beats - 1.0 / RIG.config.driver_period) <= 1


@pytest.mark.parametrize("request_it", ["disable", "quick_stop"])
def test_a_stop_ramps_both_front_wheels_alike_at_the_deceleration(request_it: str) -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((0.8 * TURN, 0.4 * TURN), now)
    w.run(0.5)
    getattr(w.master, request_it)()
    first = len(w.trace)
    assert w.run_until(Phase.READY, 2.0)
    ramp = [s.cycle.commanded.front_velocity for s in w.trace[first:] if s.cycle and s.cycle.status.phase.moves]
    moving = [pair for pair in ramp if abs(pair[0]) > 0.05 * TURN]
    for right, left in moving:
        assert left / right == pytest.approx(0.5, abs=1e-3)  # the curvature stays
    steps = [(a[0] - b[0]) / TURN / 0.01 for a, b in itertools.pairwise(moving)]
    assert steps == pytest.approx([RIG.config.stop_deceleration] * len(steps), rel=1e-2)
    assert w.last.status.stop is not None
    assert w.last.status.stop.reason.asked_for
    assert len(ramp) * 0.01 <= 0.8 / RIG.config.stop_deceleration + 0.1


def test_nothing_moves_before_an_enable_and_without_a_fresh_command() -> None:
    w = Logged()
    w.command = lambda now: Setpoints((50.0, 50.0), now)
    assert w.run_until(Phase.READY, 3.0)
    w.run(0.5)
    old = Setpoints((50.0, 50.0), w.now)
    w.command = lambda now: old
    w.master.enable()
    assert w.run_until(Phase.ENABLED, 1.0)
    w.run(0.5)
    assert not any(asked.velocity for sample in w.trace for asked in sample.drives.asked[:2])
    assert w.last.status.counters["setpoints_stale"] > 40
    assert not w.last.status.following
    w.command = lambda now: replace(old, stamp_ns=now)
    w.run(0.05)
    assert w.last.status.following
    assert w.trace[-1].drives.asked[0].velocity == pytest.approx(50.0, abs=1e-3)


def test_an_enable_that_comes_too_early_is_refused_and_forgotten() -> None:
    w = Logged()
    w.run(0.1)
    w.master.enable()
    assert w.run_until(Phase.READY, 3.0)
    w.run(1.0)
    assert w.last.status.phase is Phase.READY
    assert w.last.status.notice.startswith("enable refused")
    assert w.last.status.requests == 1


def test_a_stop_beats_an_enable_of_the_same_period() -> None:
    w = Logged()
    assert w.run_until(Phase.READY, 3.0)
    for ask in (w.master.enable, w.master.quick_stop, w.master.enable):
        ask()
    w.run(0.5)
    assert w.last.status.phase is Phase.READY
    assert all(s.cycle is None or s.cycle.status.phase is not Phase.ENABLING for s in w.trace)


def test_standing_without_a_command_is_no_incident() -> None:
    w = Logged().enabled()
    w.run(1.0)
    assert w.last.status.phase is Phase.ENABLED
    w.command = lambda now: Setpoints((20.0, 20.0), now)
    w.run(0.3)
    w.command = lambda now: Setpoints((0.0, 0.0), now)
    w.run(0.1)
    w.command = lambda now: None
    w.run(1.0)
    assert w.last.status.phase is Phase.ENABLED
    w.command = lambda now: Setpoints((20.0, 20.0), now)
    w.run(0.1)
    assert w.last.status.following


def test_too_fast_a_command_is_scaled_within_a_percent_and_refused_beyond() -> None:
    w = Logged().enabled()
    limit = RIG.config.max_speed * TURN
    w.command = lambda now: Setpoints((1.009 * limit, 0.5 * limit), now)
    w.run(0.1)
    right, left = w.last.commanded.front_velocity
    assert right <= limit * (1 + 1e-9)
    assert left / right == pytest.approx(0.5 / 1.009, rel=1e-5)
    assert w.last.status.counters["saturated_velocity"] > 0
    w.command = lambda now: Setpoints((1.011 * limit, 0.5 * limit), now)
    w.run(0.05)
    assert w.last.status.stop is not None
    assert w.last.status.stop.reason is StopReason.INVALID_COMMAND
    assert "max_speed" in w.last.status.stop.text


@pytest.mark.parametrize(
    "given",
    [
        Setpoints((math.nan, 0.0), 0),
        Setpoints((0.0, -math.inf), 0),
        Setpoints((1e300, 0.0), 0),
        Setpoints((1.0, 1.0), 0, (math.inf, math.nan)),
        Setpoints((1.0, 1.0), 0, kappa=math.nan),
        Setpoints((1.0, 1.0), 0, kappa=0.6),
        Setpoints((1.0, "x"), 0),  # type: ignore[arg-type]
        Setpoints((1.0,), 0),  # type: ignore[arg-type]
        Setpoints(None, 0),  # type: ignore[arg-type]
        Setpoints((1.0, 1.0), math.nan),  # type: ignore[arg-type]
        Setpoints((1.0, 1.0), None),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_followed_stops_and_never_raises(given: Setpoints) -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((60.0, 60.0), now)
    w.run(0.3)
    w.command = lambda now: replace(given, stamp_ns=now if given.stamp_ns == 0 else given.stamp_ns)
    w.run(0.02)
    assert w.last.status.stop is not None
    assert w.last.status.stop.reason is StopReason.INVALID_COMMAND
    assert w.run_until(Phase.READY, 2.0)
    assert w.last.status.counters["setpoints_invalid"] == 1


def test_a_rolling_rover_is_caught_on_a_ramp_when_it_is_enabled() -> None:
    w = Logged()
    assert w.run_until(Phase.READY, 3.0)
    for motor in ("front_right", "front_left"):
        w.drive_set.shafts[motor]._state = w.drive_set.shafts[motor].state()._replace(velocity=0.6 * TURN)
    w.run(0.05)
    w.master.enable()
    assert w.run_until(Phase.ENABLED, 1.0)
    speeds = [w.drive_set.shafts["front_right"].state().velocity]
    for _ in range(30):
        w.run(0.01)
        speeds.append(w.drive_set.shafts["front_right"].state().velocity)
    drops = [(a - b) / TURN / 0.01 for a, b in itertools.pairwise(speeds)]
    assert max(drops) < 1.5 * RIG.config.stop_deceleration
    assert speeds[-1] < 0.2 * TURN


def test_a_speed_that_no_rover_has_is_not_what_an_enable_begins_with() -> None:
    """An encoder that has gone wrong: the ramp begins at max_speed at most, and is over as soon as that allows."""
    w = Logged()
    assert w.run_until(Phase.READY, 3.0)
    shaft = w.drive_set.shafts["front_right"]
    shaft._state = shaft.state()._replace(velocity=50.0 * RIG.config.max_speed * TURN)
    w.run(0.05)
    w.master.enable()
    assert w.run_until(Phase.ENABLED, 1.0)
    w.run(RIG.config.max_speed / RIG.config.stop_deceleration)
    assert w.last.commanded.front_velocity == (0.0, 0.0)


def lets_go(w: Logged, motor: str) -> None:
    """As a drive does whose STO is cut and given back: without current, and no fault."""
    w.drive_set.drives[motor].let_go()


def restarts(w: Logged, motor: str) -> None:
    """As a drive does whose supply was away for a moment; it is set up again before the ramp is over."""
    w.drive_set.drives[motor].power_on(w.now)


@pytest.mark.parametrize("leave", [lets_go, restarts])
@pytest.mark.parametrize("motor", MOTORS)
def test_a_drive_that_has_left_is_not_enabled_again_by_the_stop(
    leave: Callable[[Logged, str], None], motor: str
) -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((1.9 * TURN, 1.9 * TURN), now)
    w.run(0.5)
    leave(w, motor)
    begin = len(w.trace)
    w.run(0.15)
    assert w.last.status.stop is not None
    assert w.last.status.stop.motor == motor
    w.run(2.0)
    assert w.last.status.phase is Phase.READY
    states = [sample.drives.state[MOTORS.index(motor)] for sample in w.trace[begin:]]
    assert DriveState.OPERATION_ENABLED not in states


def test_frames_out_of_order_after_an_enable_take_no_current_away() -> None:
    """A statusword from before the enable that comes late does not lead a drive back through the states."""
    w = Logged().enabled()
    w.command = lambda now: Setpoints((60.0, 60.0), now)
    w.run(0.1)
    for state in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON, DriveState.SWITCH_ON_DISABLED):
        late = RIG.codec.pdo("TPDO1", 1, (statusword(state), 0, 0))
        w._near.inbox.append(late)
        w.run(0.05)
    assert w.last.status.phase is Phase.ENABLED
    assert all(sample.drives.state == (DriveState.OPERATION_ENABLED,) * 4 for sample in w.trace[-15:])


def test_the_first_reason_is_kept_until_the_next_enable() -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((60.0, 60.0), now)
    w.run(0.3)
    w.drive_set.drives["back_left"].fail(0x4310)
    w.run(0.05)
    w.drive_set.unplug("front_left")
    w.master.disable()
    w.run(1.0)
    stop = w.last.status.stop
    assert stop is not None
    assert (stop.reason, stop.motor) == (StopReason.DRIVE_FAULT, "back_left")
    assert "4310h drive too hot" in stop.text
    w.drive_set.plug("front_left")
    w.master.reset_fault()
    w.run(2.0)
    w.master.reset_fault()
    assert w.run_until(Phase.READY, 2.0)
    assert w.last.status.stop == stop
    w.master.enable()
    assert w.run_until(Phase.ENABLED, 1.0)
    assert w.last.status.stop is None


def test_a_reset_asked_for_under_way_resets_no_fault_that_is_still_to_come() -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((60.0, 60.0), now)
    w.run(0.2)
    w.master.reset_fault()
    w.run(0.02)
    assert w.last.status.notice == "reset refused: the drives are enabled"
    w.drive_set.drives["back_left"].fail(0x2310)
    w.run(0.9)
    assert w.last.status.phase is Phase.LOCKED


def test_warnings_of_a_drive_do_not_stop_but_are_shown() -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((60.0, 60.0), now)
    w.run(0.3)
    w.inject([RIG.codec.emcy(2, 0x8210, 0x10), RIG.codec.emcy(3, 0x2351, 0x02)])
    w.run(0.3)
    assert w.last.status.phase is Phase.ENABLED
    assert w.last.status.drives[1].emergency.startswith("8210h PDO too short")
    assert w.last.status.counters["emergencies"] == 2


def test_a_flood_takes_no_more_than_its_share_of_a_cycle() -> None:
    """However much waits to be read, a cycle reads a bounded number of frames, and still sends all of its own."""
    w = Logged().enabled()
    w.inject([Frame(0x7F0, bytes(8))] * 100_000)
    w.log.clear()
    w.master.cycle(w.now, None)
    assert sum(frame.can_id == RIG.codec.sync_id for frame in w.log) == 1
    assert w.last.status.counters["reads_cut_short"] == 0
    assert w.master.cycle(w.now + w.period, None).status.counters["reads_cut_short"] == 2


def test_frames_that_the_bus_does_not_take_are_a_reason_to_stop_before_the_drives_fall_silent() -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((40.0, 40.0), now)
    w.run(0.2)
    w.unreliable.send = lambda frame: False  # type: ignore[method-assign]
    w.run(0.05)
    stop = w.last.status.stop
    assert stop is not None and stop.reason is StopReason.CANNOT_SEND
    assert w.last.status.phase is Phase.STOPPING


def test_reading_ends_when_its_time_is_over_whatever_waits() -> None:
    now = [1_000_000_000]

    class Slow:
        """A bus whose every frame takes a millisecond to be read."""

        def send(self, frame: Frame) -> bool:
            return True

        def receive(self, timeout: float = 0.0):  # type: ignore[no-untyped-def]
            now[0] += 1_000_000
            return message_of(Frame(0x7F0, b""))

        def health(self):  # type: ignore[no-untyped-def]
            return w.unreliable.health()

    w = VirtualLoop(RIG, random.Random(1))
    master = Master(Slow(), RIG, clock=lambda: now[0])
    begin = now[0]
    master.cycle(now[0], None)
    assert now[0] - begin < 20_000_000


@pytest.mark.parametrize("seed", range(3))
def test_random_frames_raise_nothing_and_move_nothing_that_is_not_enabled(seed: int) -> None:
    """Random data under any identifier, many of them ours, in all phases; a person enables and resets in between."""
    w = Logged(seed)
    rng = random.Random(seed)
    ours = [can_id for can_id in range(0x800) if RIG.codec.knows(can_id) and can_id & 0x7F in (0, 1, 2, 3, 4, 127)]
    w.command = lambda now: Setpoints((40.0, 40.0), now)
    phases = set()
    for k in range(1500):
        noisy = k % 500 < 250
        w.inject(
            [Frame(rng.choice(ours), rng.randbytes(rng.choice((8, 8, rng.randrange(9))))) for _ in range(3 * noisy)]
        )
        w.run(0.01)
        if k % 20 == 0:
            (w.master.enable if k % 40 else w.master.reset_fault)()
        status = w.last.status
        phases.add(status.phase)
        if not status.phase.moves:
            assert all(math.isnan(each) for each in w.last.commanded.front_velocity)
    assert {Phase.CONFIGURING, Phase.READY, Phase.ENABLED, Phase.STOPPING} <= phases


def test_a_cycle_that_comes_late_makes_no_leap() -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((0.8 * TURN, 0.8 * TURN), now)
    w.run(0.5)
    w.hung = True
    w.run(0.12)
    w.hung = False
    w.run(0.01)
    assert w.last.status.stop is not None
    assert w.last.status.stop.reason is StopReason.OVERRUN
    assert w.last.commanded.front_velocity[0] > 0.7 * TURN


def test_close_takes_the_current_away_at_once_and_leaves_no_fault() -> None:
    w = Logged().enabled()
    w.command = lambda now: Setpoints((60.0, 60.0), now)
    w.run(0.3)
    w.master.close(w.now)
    w.hung = True
    w.run(0.01)
    assert all(asked.is_free for asked in w.trace[-1].drives.asked)
    w.run(0.5)
    assert {drive.state for drive in w.drive_set.drives.values()} == {DriveState.SWITCH_ON_DISABLED}


def test_a_driver_that_takes_over_enabled_drives_stops_them_and_keeps_them_locked() -> None:
    """Its predecessor was killed a moment ago: it listens, and the drives miss the heartbeat meanwhile."""
    w = Logged().enabled()
    w.command = lambda now: Setpoints((0.8 * TURN, 0.8 * TURN), now)
    w.run(0.5)
    w.new_master()
    begin = len(w.trace)
    w.run(1.5)
    assert w.last.status.phase is Phase.LOCKED
    assert not any(DriveState.OPERATION_ENABLED in sample.drives.state for sample in w.trace[begin + 17 :])
    speeds = [abs(sample.drives.velocity[0]) for sample in w.trace[begin + 17 :]]
    assert all(b <= a + 1e-6 for a, b in itertools.pairwise(speeds))
    assert speeds[-1] < 0.02 * TURN
    w.master.enable()
    w.run(0.1)
    assert w.last.status.phase is Phase.LOCKED


def test_outside_of_motion_every_controlword_takes_the_voltage_away() -> None:
    w = Logged()
    assert w.run_until(Phase.READY, 3.0)
    w.run(0.5)
    words = [
        said.value("controlword")
        for frame in w.log
        if isinstance(said := RIG.codec.decode(*frame), Pdo) and said.map.to_drive
    ]
    assert len(words) > 400
    assert {command_of(word) for word in words} == {Command.DISABLE_VOLTAGE}


def test_feedback_is_stamped_with_the_sync_that_sampled_it() -> None:
    w = Logged().enabled()
    before = w.now - w.period
    cycle = w.master.cycle(w.now, None)
    assert cycle.feedback.stamp_ns == (before,) * 4
    assert [drive.stage for drive in cycle.status.drives] == [SetupStage.RUNNING] * 4


def test_the_load_is_told_also_after_the_loop_was_held_up() -> None:
    w = VirtualLoop(RIG, random.Random(4))
    assert w.run_until(Phase.READY, 3.0)
    w.run(0.1)
    usual = w.last.status.bus.load
    once_more = 4 * frame_bits(1) / (0.05 * RIG.config.bitrate)  # 50 ms hold one or two of a drive's heartbeats
    assert 0.1 < usual < RIG.bus_load + once_more
    w.hung = True
    w.run(0.06)
    w.hung = False
    w.run(0.01)
    assert 0.1 * usual < w.last.status.bus.load < 1.5 * usual
