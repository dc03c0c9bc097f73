"""What the driver's services answer, and what /diagnostics says, from the master's status alone."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed; run `make setup`, or source a ROS 2 Jazzy")

from artibot_driver.bus import BusState
from artibot_driver.cia402 import DriveState
from artibot_driver.config import config_from_parameters
from artibot_driver.master import BusStatus, DriveStatus, MasterStatus, Phase, SetupStage, StopReason, StopRecord
from artibot_sim.model import MOTORS
from artibot_sim.nodes.driver.publishers import ERROR, OK, STALE, WARN, Identity, diagnostics, judged
from artibot_sim.nodes.driver.services import PATIENCE, START_WITHIN, AutoEnable, PendingRequest, answer, obstacles

CONFIG = config_from_parameters({})
DRIVES = tuple(
    DriveStatus(motor, k, SetupStage.RUNNING, DriveState.SWITCH_ON_DISABLED, "", "", 0, 0x40, 0.01, 0.01, 1.0)
    for k, motor in enumerate(MOTORS, 1)
)
READY = MasterStatus(
    phase=Phase.READY,
    stop=None,
    armed_ns=None,
    following=False,
    refusal="",
    notice="",
    requests=3,
    drives=DRIVES,
    bus=BusStatus(BusState.ACTIVE, 0.2, None, None, ""),
    counters={"frames_unknown": 7},
)
STOP = StopRecord(StopReason.DRIVE_SILENT, "drive back_left says nothing", 6_000_000_000, "back_left")


def asked(what: str) -> PendingRequest:
    return PendingRequest(what, requests=3, asked=5.0, reply=lambda _: None)


def with_drive(index: int, **changes: object) -> MasterStatus:
    drives = list(DRIVES)
    drives[index] = drives[index]._replace(**changes)
    return READY._replace(drives=tuple(drives))


@pytest.mark.parametrize("what", PATIENCE)
def test_no_answer_before_the_master_has_looked_and_always_one_in_the_end(what: str) -> None:
    assert answer(asked(what), READY, 5.1) is None
    found = answer(asked(what), READY, 5.0 + PATIENCE[what] + 0.1)
    assert found is not None and not found[0] and found[1]
    for phase in Phase:
        status = READY._replace(phase=phase, requests=4)
        assert answer(asked(what), status, 5.0 + PATIENCE[what] + 0.1) is not None


def test_enable_is_true_only_of_enabled_drives() -> None:
    for phase in Phase:
        found = answer(asked("enable"), READY._replace(phase=phase, requests=4, notice="refused: why"), 5.1)
        if phase is Phase.ENABLING:
            assert found is None
        else:
            assert found is not None and found[0] is (phase is Phase.ENABLED)
            assert found[0] or "why" in found[1]
    failed = READY._replace(requests=4, stop=STOP, notice="enabling")
    assert answer(asked("enable"), failed, 5.1) == (False, "a drive is silent: drive back_left says nothing")
    before = failed._replace(stop=replace(STOP, at_ns=1), notice="refused: not ready")
    assert "refused: not ready" in answer(asked("enable"), before, 5.1)[1], "an old stop is no answer"  # type: ignore[index]


def test_what_is_in_the_way_names_motor_node_and_trouble() -> None:
    assert obstacles(READY) == ""
    assert "back_right (node 3): overheated" in obstacles(with_drive(2, trouble="overheated"))
    assert "front_left (node 2): not heard" in obstacles(with_drive(1, stage=SetupStage.SEEKING))
    assert obstacles(READY._replace(refusal="608Fh differs")) == "608Fh differs"
    down = READY._replace(bus=BusStatus(BusState.DOWN, 0.0, None, None, "vcan0 is down"))
    assert "vcan0 is down" in obstacles(down)


@pytest.mark.parametrize(
    ("status", "levels"),
    [
        (READY, [OK] * 6),
        (with_drive(0, stage=SetupStage.SEEKING, state=None, heartbeat_age=math.inf), [OK, OK, STALE, OK, OK, OK]),
        (with_drive(3, state=DriveState.FAULT, emergency="2310h over-current"), [OK, OK, OK, OK, OK, ERROR]),
        (with_drive(1, trouble="a second node has the id 2"), [OK, OK, OK, ERROR, OK, OK]),
        (with_drive(1, stage=SetupStage.CHECKING), [OK, OK, OK, WARN, OK, OK]),
        (with_drive(2, statusword=0xC0), [OK, OK, OK, OK, WARN, OK]),
        (with_drive(2, statusword=0x0C37), [OK, OK, OK, OK, WARN, OK]),
        (with_drive(0, remark="another revision"), [OK, OK, WARN, OK, OK, OK]),
        (READY._replace(stop=STOP), [ERROR, OK, OK, OK, OK, OK]),
        (READY._replace(stop=replace(STOP, reason=StopReason.DISABLE)), [OK, OK, OK, OK, OK, OK]),
        (
            READY._replace(phase=Phase.CONFIGURING, stop=replace(STOP, reason=StopReason.DISABLE)),
            [WARN, OK, OK, OK, OK, OK],
        ),
        (READY._replace(phase=Phase.LISTENING), [WARN, OK, OK, OK, OK, OK]),
        (READY._replace(phase=Phase.LISTENING, other_driver="somebody else leads"), [ERROR, OK, OK, OK, OK, OK]),
        (READY._replace(phase=Phase.CONFIGURING), [WARN, OK, OK, OK, OK, OK]),
        (
            READY._replace(phase=Phase.OFFLINE, bus=BusStatus(BusState.BUS_OFF, 0.0, 255, 0, "bus-off")),
            [ERROR, ERROR, OK, OK, OK, OK],
        ),
    ],
)
def test_levels_of_diagnostics(status: MasterStatus, levels: list[bytes]) -> None:
    message = diagnostics(1, CONFIG, Identity("agriq"), status, {"kappa": 0.8})
    assert [each.name for each in message.status] == [f"artibot driver: {n}" for n in ("driver", "bus", *MOTORS)]
    assert [each.level for each in message.status] == levels
    assert all(each.hardware_id and each.message for each in message.status)
    values = {pair.key: pair.value for pair in message.status[0].values}
    assert values["frames_unknown"] == "7" and values["kappa"] == "0.8"
    if status.stop:
        if levels[0] != WARN:
            assert status.stop.text in message.status[0].message
        assert values["stop motor"] == "back_left"


def test_warning_and_limit_are_said_with_their_bits() -> None:
    message = diagnostics(
        1, CONFIG, Identity("agriq"), with_drive(1, statusword=0x08B7, emergency="2351h load high"), {}
    )
    (status,) = (each for each in message.status if each.name.endswith("front_left"))
    for part in ("2351h load high", "warns (statusword, bit 7)", "internal limit acts (statusword, bit 11)"):
        assert part in status.message


def test_after_a_fault_s_stop_it_is_said_what_is_in_the_way_now() -> None:
    status = with_drive(0, trouble="a second node has the id 1")._replace(phase=Phase.CONFIGURING, stop=STOP)
    text = diagnostics(1, CONFIG, Identity("agriq"), status, {}).status[0].message
    assert STOP.text in text and "a second node has the id 1" in text


def test_a_warning_without_a_reason_is_said_to_have_none() -> None:
    message = diagnostics(1, CONFIG, Identity("agriq"), with_drive(1, statusword=0x00B7, emergency=""), {})
    (status,) = (each for each in message.status if each.name.endswith("front_left"))
    assert "no emergency" in status.message


@pytest.mark.parametrize(
    ("full_name", "name", "hardware"),
    [
        ("/driver", "artibot driver: bus", "agriq"),
        ("/rover1/driver", "rover1/artibot driver: bus", "rover1/agriq"),
        ("/farm/rover2/driver", "farm/rover2/artibot driver: bus", "farm/rover2/agriq"),
        ("/left_rover", "left_rover/artibot driver: bus", "left_rover/agriq"),
    ],
)
def test_two_rovers_are_told_apart_by_name_and_hardware_id(full_name: str, name: str, hardware: str) -> None:
    message = diagnostics(1, CONFIG, Identity.of_node("agriq", full_name), READY, {})
    assert message.status[1].name == name
    assert message.status[0].hardware_id == hardware
    others = diagnostics(1, CONFIG, Identity.of_node("agriq", "/another/driver"), READY, {})
    assert not {each.name for each in message.status} & {each.name for each in others.status}
    assert not {each.hardware_id for each in message.status} & {each.hardware_id for each in others.status}


@pytest.mark.parametrize(("word", "supply", "limit"), [(0x40, False, False), (0x50, True, False), (0x0C50, True, True)])
def test_supply_and_limit_are_told_by_the_statusword(word: int, supply: bool, limit: bool) -> None:
    message = diagnostics(1, CONFIG, Identity("agriq"), with_drive(3, statusword=word), {})
    values = {pair.key: pair.value for pair in message.status[-1].values}
    assert (values["motor supply"], values["at a limit"]) == (str(supply), str(limit))


def test_news_is_what_a_person_would_want_to_know() -> None:
    assert judged(READY) == judged(with_drive(0, feedback_age=0.017)), "numbers that always change are none"
    assert judged(READY) != judged(READY._replace(phase=Phase.ENABLED))
    assert judged(READY) != judged(with_drive(0, state=DriveState.FAULT))
    assert judged(None) != judged(None, fault="no bus")


def looked(auto_enable: AutoEnable, status: MasterStatus, now: float) -> tuple[bool, str]:
    return auto_enable.check(status, now)


def test_enable_on_start_enables_once() -> None:
    auto_enable = AutoEnable()
    assert looked(auto_enable, READY, 5.0) == (False, "")
    auto_enable.begin(5.0)
    assert looked(auto_enable, READY._replace(phase=Phase.LISTENING), 5.1) == (False, "")
    assert looked(auto_enable, READY._replace(phase=Phase.CONFIGURING), 5.2) == (False, "")
    assert looked(auto_enable, READY, 6.0) == (True, "")
    assert looked(auto_enable, READY, 6.1) == (False, "")


@pytest.mark.parametrize(
    ("status", "after", "why"),
    [
        (READY, START_WITHIN + 0.1, "not ready within 60 s"),
        (READY._replace(stop=STOP), 1.0, "drive back_left says nothing"),
        (READY._replace(phase=Phase.LOCKED), 1.0, Phase.LOCKED.value),
    ],
)
def test_enable_on_start_lapses_after_a_while_or_when_something_has_happened(
    status: MasterStatus, after: float, why: str
) -> None:
    auto_enable = AutoEnable()
    auto_enable.begin(5.0)
    enable, lapsed = looked(auto_enable, status, 5.0 + after)
    assert not enable
    assert why in lapsed
    assert looked(auto_enable, READY, 5.1 + after) == (False, "")


def test_enable_on_start_ends_with_a_request_by_hand() -> None:
    auto_enable = AutoEnable()
    auto_enable.begin(5.0)
    auto_enable.end()
    assert looked(auto_enable, READY, 5.1) == (False, "")
