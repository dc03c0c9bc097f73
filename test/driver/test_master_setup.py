"""Setting drives up through the master, in time of its own: what is written, refused and tried again, and how fast."""

from __future__ import annotations

import math
import random
import re
from pathlib import Path

import pytest

from artibot_driver.config import config_from_parameters
from artibot_driver.faults.closed_loop import VirtualLoop
from artibot_driver.faults.simulated_bus import Interference
from artibot_driver.frames import Frame, NmtState
from artibot_driver.master import Phase, Setpoints, SetupStage, StopReason
from artibot_driver.rig import load_rig
from artibot_sim.model import MOTORS
from artibot_sim.resources import config_path


def loop(seed: int = 1, **given: object) -> VirtualLoop:
    rig = load_rig(config_from_parameters({name.replace("__", "."): value for name, value in given.items()}))
    return VirtualLoop(rig, random.Random(seed))


def driving() -> VirtualLoop:
    made = loop()
    assert made.run_until(Phase.READY, 3.0)
    made.master.enable()
    assert made.run_until(Phase.ENABLED, 1.0)
    made.command = lambda now: Setpoints((60.0, 50.0), now)
    made.run(0.3)
    return made


def test_every_setting_arrives_and_nothing_moves() -> None:
    w = loop()
    assert w.run_until(Phase.READY, 2.0)
    for motor, drive in w.drive_set.drives.items():
        assert drive.nmt is NmtState.OPERATIONAL
        for each in w.rig.settings(motor):
            if (each.index, each.subindex) not in (
                (0x1400, 1),
                (0x1800, 1),
                (0x1801, 1),
                (0x1600, 0),
                (0x1A00, 0),
                (0x1A01, 0),
            ):
                assert drive.objects.values[each.index, each.subindex] == each.value, (motor, each)
    assert all(asked.is_free for sample in w.trace for asked in sample.drives.asked)
    assert [drive.stage for drive in w.last.status.drives] == [SetupStage.RUNNING] * 4


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            (0x608F, 1),
            2048,
            r"^motor back_left \(node 4\): object 608Fh:1 \(.*\): found 2048, expected 4096; .*counts_per_turn.back",
        ),
        ((0x6076, 0), 900, r"object 6076h .*found 900, expected 600; .*drive.back.rated_torque"),
        ((0x607E, 0), 0x40, r"object 607Eh .*found 64, expected 0; .*set it to 0 in the drive"),
        ((0x60A9, 0), 0, r"object 60A9h .*velocity_exponent"),
    ],
)
def test_another_motor_than_was_configured_is_refused_and_never_moved(
    key: tuple[int, int], value: int, message: str
) -> None:
    w = loop()
    w.run(0.01)
    drive = w.drive_set.drives["back_left"]
    drive.objects.values[key] = value
    w.run(2.0)
    status = w.last.status
    assert status.phase is Phase.CONFIGURING
    assert status.drives[3].stage is SetupStage.REFUSED
    with pytest.raises(ValueError, match=message):
        raise ValueError(status.refusal)
    w.master.enable()
    w.command = lambda now: Setpoints((50.0, 50.0), now)
    w.run(0.5)
    assert status.refusal in w.last.status.notice
    assert w.last.status.phase is Phase.CONFIGURING
    assert all(asked.is_free for sample in w.trace for asked in sample.drives.asked)
    drive.objects.values[key] = next(
        each.value for each in w.rig.settings("back_left") if (each.index, each.subindex) == key
    )
    w.run(1.5)
    assert w.last.status.drives[3].stage is SetupStage.REFUSED  # until somebody has looked at it
    w.master.reset_fault()
    assert w.run_until(Phase.READY, 2.0)
    assert w.last.status.refusal == ""


def test_a_drive_that_refuses_a_value_is_refused_with_its_reason() -> None:
    w = loop()
    w.run(0.01)
    w.drive_set.drives["front_left"].objects.values[0x6502, 0] = 0  # no mode of operation is supported
    w.run(2.0)
    assert "motor front_left (node 2): object 6060h" in w.last.status.refusal
    assert "found 0, expected 9; writing 9 to 6060h was refused (0x06090030:" in w.last.status.refusal


def test_a_missing_drive_is_named_and_found_within_two_seconds() -> None:
    w = loop()
    w.drive_set.cut_power("back_right")
    w.run(2.0)
    assert w.last.status.phase is Phase.CONFIGURING
    assert [each.stage for each in w.last.status.drives] == [
        SetupStage.RUNNING,
        SetupStage.RUNNING,
        SetupStage.SEEKING,
        SetupStage.RUNNING,
    ]
    w.master.enable()
    w.run(0.02)
    assert "drive back_right (node 3): not heard" in w.last.status.notice
    w.drive_set.power("back_right", w.now)
    assert w.run_until(Phase.READY, 2.0)


def test_a_node_of_another_profile_is_not_set_up() -> None:
    w = loop()
    w.drive_set.cut_power("front_left")
    w.run(0.2)
    w.drive_set.power("front_left", w.now)
    w.drive_set.drives["front_left"].objects.values[0x1000, 0] = 0x0003_0191  # an input and output module, CiA 401
    w.run(2.0)
    assert [each.stage for each in w.last.status.drives].count(SetupStage.SEEKING) == 1
    assert w.last.status.phase is Phase.CONFIGURING
    assert w.last.status.counters["sdo_unexpected"] > 5


@pytest.mark.parametrize("seed", range(5))
def test_frames_that_get_lost_only_make_it_slower(seed: int) -> None:
    w = loop(seed)
    w.unreliable.interference = Interference(0.1, 0.1, 0.1, 0.1)
    assert w.run_until(Phase.READY, 10.0)
    counters = w.last.status.counters
    assert counters["sdo_repeats"] > 0
    assert counters["malformed"] > 0


def test_setting_up_holds_up_nobody_else() -> None:
    """One drive rejoins again and again while the rest go on hearing SYNC in every period."""
    w = loop()
    assert w.run_until(Phase.READY, 2.0)
    w.drive_set.drives["front_right"].power_on(w.now)
    before = w.last.status.counters["missed_feedback"]
    assert w.run_until(Phase.READY, 2.0)
    assert w.last.status.counters["missed_feedback"] == before


def test_setting_up_leaves_room_on_a_bus_that_is_nearly_full() -> None:
    """All four at once, beside cyclic frames that take most of the bus: no flood, and an enable is taken at once."""
    w = loop(bus__bitrate=250_000)
    assert w.rig.bus_load > 0.7
    loads = []
    while not loads or w.last.status.phase is not Phase.READY:
        w.run(0.01)
        loads.append(w.last.status.bus.load)
        assert len(loads) < 600
    assert 0.7 < max(loads) < 0.95
    w.master.enable()
    assert w.run_until(Phase.ENABLED, 1.0), w.last.status.notice


def test_positions_go_on_after_a_drive_has_restarted() -> None:
    w = driving()
    before = w.last.feedback.position
    assert before[0] > 1.0
    w.drive_set.drives["front_right"].power_on(w.now)
    assert w.run_until(Phase.READY, 3.0)
    w.run(0.1)
    after = w.last.feedback.position
    moved = w.drive_set.shafts["front_right"].state().position
    assert 0.0 <= after[0] - before[0] <= moved - before[0] + 1e-2  # what it turned while it was away is not known
    w.master.enable()
    assert w.run_until(Phase.ENABLED, 1.0)
    w.run(0.2)
    begin, at = w.last.feedback.position[0], w.drive_set.shafts["front_right"].state().position
    w.command = lambda now: Setpoints((30.0, 30.0), now)
    w.run(0.5)
    turned = w.drive_set.shafts["front_right"].state().position - at
    assert turned > 5.0
    assert w.last.feedback.position[0] - begin == pytest.approx(turned, abs=0.02 * turned + 0.5)


def test_a_silent_drive_s_feedback_is_not_known() -> None:
    w = driving()
    w.drive_set.unplug("back_left")
    w.run(0.5)
    feedback = w.last.feedback
    assert math.isnan(feedback.velocity[3])
    assert feedback.stamp_ns[3] is None
    assert not any(math.isnan(feedback.velocity[k]) for k in range(3))


def test_a_position_that_is_told_no_more_is_not_known_though_all_else_is() -> None:
    w = driving()
    receive = w.unreliable.receive
    lost = w.rig.codec.maps["TPDO2"].id_of(w.rig.codec.nodes["front_left"])

    def without_it(timeout: float = 0.0):  # type: ignore[no-untyped-def]
        message = receive(timeout)
        return without_it(timeout) if message is not None and message.arbitration_id == lost else message

    w.unreliable.receive = without_it  # type: ignore[method-assign]
    w.run(0.3)
    feedback = w.last.feedback
    assert [math.isnan(position) for position in feedback.position] == [False, True, False, False]
    assert not any(map(math.isnan, feedback.velocity))
    w.unreliable.receive = receive  # type: ignore[method-assign]
    w.run(0.02)
    assert not any(map(math.isnan, w.last.feedback.position))


RATIO = """
[{index}]
ParameterName=A ratio
ObjectType=0x8
SubNumber=3
"""
PART = """
[{index}sub{k}]
ParameterName=A part
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue={value}
PDOMapping=0
"""


@pytest.mark.parametrize(
    ("index", "said"), [("6091", r"found 10, expected 1; .*drive.back.tau"), ("6096", "velocity_exponent")]
)
def test_a_drive_that_reckons_with_a_ratio_of_its_own_is_refused(tmp_path: Path, index: str, said: str) -> None:
    own = RATIO.format(index=index) + "".join(PART.format(index=index, k=k, value=1 + (k == 0)) for k in range(3))
    eds = tmp_path / "other.eds"
    eds.write_text(config_path("eds", "drive").read_text(encoding="utf-8") + own, encoding="utf-8")
    w = loop(eds=str(eds))
    assert w.run_until(Phase.READY, 2.0)
    w = loop(eds=str(eds))
    w.run(0.01)
    w.drive_set.drives["back_left"].objects.values[int(index, 16), 1] = 10
    w.run(1.0)
    assert w.last.status.phase is Phase.CONFIGURING
    assert re.search(said, w.last.status.refusal)


def test_answers_that_nobody_asked_for_change_nothing() -> None:
    w = loop()
    rng = random.Random(3)
    for _ in range(150):
        node = w.rig.codec.nodes[rng.choice(MOTORS)]
        w.inject([Frame(0x580 + node, bytes((0x60, 0x00, 0x18, 1)) + bytes(4)), Frame(0x580 + node, rng.randbytes(8))])
        w.run(0.01)
    assert w.run_until(Phase.READY, 3.0) or w.last.status.phase is Phase.READY
    assert w.last.status.counters["sdo_unexpected"] > 100


def restarts_unnoticed(w: VirtualLoop, motor: str, state: NmtState = NmtState.PRE_OPERATIONAL) -> None:
    """Supply away for a moment, and the boot-up message lost; some drives are operational by themselves after that."""
    drive = w.drive_set.drives[motor]
    send, drive._send = drive._send, lambda frame: None
    drive.power_on(w.now)
    drive._send, drive.nmt = send, state


def lost_settings(w: VirtualLoop) -> list[tuple[str, int]]:
    """Objects that are not as they were set."""
    found = []
    for motor, drive in w.drive_set.drives.items():
        last = {(each.index, each.subindex): each.value for each in w.rig.settings(motor)}
        found += [(motor, key[0]) for key, value in last.items() if drive.objects.values[key] != value]
    return found


@pytest.mark.parametrize("seed", range(15))
def test_a_drive_that_restarts_unnoticed_while_it_is_set_up_is_set_up_again(seed: int) -> None:
    w, rng = loop(seed), random.Random(seed)
    w.run(rng.uniform(0.2, 1.2))
    motor = rng.choice(MOTORS)
    restarts_unnoticed(w, motor)
    assert lost_settings(w)
    w.run(0.12)  # at the latest now it is missed, whatever it was at
    assert w.run_until(Phase.READY, 2.0)
    assert not lost_settings(w)


@pytest.mark.parametrize("motor", MOTORS)
def test_a_drive_that_comes_back_operational_without_its_settings_is_found_out(motor: str) -> None:
    w = driving()
    restarts_unnoticed(w, motor, NmtState.OPERATIONAL)
    w.drive_set.drives[motor].objects.values[0x1017, 0] = 40  # stored in it: it is heard as before
    w.run(1.0)
    status = w.last.status
    assert status.stop is not None
    assert (status.stop.reason, status.stop.motor) == (StopReason.DRIVE_STATE, motor)
    assert w.run_until(Phase.READY, 2.0)
    assert w.last.status.counters["settings_lost"] == 1
    assert not lost_settings(w)


def test_settings_that_are_as_they_were_cost_a_drive_nothing_but_time() -> None:
    w = driving()
    w.drive_set.drives["front_left"].let_go()
    w.run(0.8)
    assert w.run_until(Phase.READY, 1.0)
    assert w.last.status.counters["settings_lost"] == w.last.status.counters["drive_restarts"] == 0


def test_a_drive_that_does_not_keep_what_is_written_is_refused() -> None:
    w = loop()
    for _ in range(400):
        w.drive_set.drives["back_right"].objects.values[0x6085, 0] = 1
        w.run(0.01)
    assert w.last.status.drives[2].stage is SetupStage.REFUSED
    assert "motor back_right (node 3): object 6085h" in w.last.status.refusal
    assert "found 1, expected" in w.last.status.refusal
    assert "the drive has not taken it" in w.last.status.refusal
