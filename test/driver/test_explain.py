"""Decoded frames: cantools, which knows only the DBC, says the same; and nothing that a bus can carry raises."""

from __future__ import annotations

import csv
import io
import json
from typing import NamedTuple

import canopen
import cantools
import pytest
from canopen.objectdictionary import ODVariable
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver.cia402 import DriveState, statusword
from artibot_driver.config import config_from_parameters
from artibot_driver.dbc import dbc_text
from artibot_driver.explain import COLUMNS, KINDS, Explainer, as_csv, as_json, for_reading, matches
from artibot_driver.frames import Frame, NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.rig import load_rig
from artibot_sim.model import MOTORS

RIG = load_rig(config_from_parameters({"node_ids.back_left": 9}))
EXPLAINER = Explainer(RIG)
DATABASE = cantools.database.load_string(dbc_text(RIG), "dbc")
PDOS = [(motor, name) for motor in MOTORS for name in RIG.codec.maps]


class Seen(NamedTuple):
    """A frame as a bus hands it out."""

    can_id: int
    data: bytes
    dlc: int = 8
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False


def seen(frame: Frame) -> Seen:
    return Seen(*frame, len(frame.data))


@pytest.mark.parametrize(("motor", "name"), PDOS)
@given(data=st.data())
def test_pdos_are_what_cantools_reads(motor: str, name: str, data: st.DataObject) -> None:
    each = RIG.codec.maps[name]
    content = data.draw(st.binary(min_size=each.packing.size, max_size=each.packing.size))
    frame = Seen(each.id_of(RIG.codec.nodes[motor]), content, len(content))
    found = EXPLAINER.explain(frame)
    assert (found.node, found.what, found.kind) == (motor, name, name[:4].lower())
    message = DATABASE.get_message_by_frame_id(frame.can_id)
    physical = message.decode(content, decode_choices=False)
    integers = message.decode(content, scaling=False, decode_choices=False)
    assert {value.name: value.raw for value in found.values} == integers
    for value in found.values:
        unit = message.get_signal_by_name(value.name).unit or ""
        assert value.unit == unit
        assert (value.si if unit else value.raw) == physical[value.name]


@given(
    can_id=st.one_of(st.integers(0, 0x7FF), st.integers(0, 2**29 - 1)),
    data=st.binary(max_size=8),
    flags=st.tuples(st.booleans(), st.booleans(), st.booleans()),
)
def test_any_frame_has_lines_of_every_form(can_id: int, data: bytes, flags: tuple[bool, bool, bool]) -> None:
    frame = Seen(can_id, data, len(data), *flags)
    found = EXPLAINER.explain(frame)
    assert found.kind in KINDS
    assert (found.kind in ("other", "error")) or not any(flags)
    for raw in (False, True):
        line = for_reading(raw)(1.5, 10**18, frame, found)
        assert "\n" not in line
        assert found.node in line
    read = json.loads(as_json(1.5, 10**18, frame, found))
    assert bytes.fromhex(read["data"]) == data
    assert list(read["values"]) == [value.name for value in found.values]
    rows = list(csv.reader(io.StringIO(as_csv(1.5, 10**18, frame, found))))
    assert len(rows) == max(1, len(found.values))
    assert all(len(row) == len(COLUMNS) for row in rows)


def test_words_of_bits_are_in_words() -> None:
    word = statusword(DriveState.FAULT_REACTION_ACTIVE)
    found = EXPLAINER.explain(seen(RIG.codec.pdo("TPDO1", 9, (word, 0, 0))))
    assert (found.node, found.number, found.values[0].text) == ("back_left", 9, "fault reaction active")
    found = EXPLAINER.explain(seen(RIG.codec.pdo("RPDO1", 1, (0x0F, 0, 0))))
    assert [value.text for value in found.values] == ["enable operation", "", ""]
    found = EXPLAINER.explain(seen(RIG.codec.pdo("TPDO2", 2, (0, 10, 0x11, 0x8130))))
    assert [value.text for value in found.values[1:]] == [
        "cyclic sync torque",
        "generic, communication",
        "8130h heartbeat or life guarding missed",
    ]


@pytest.mark.parametrize(
    ("frame", "node", "kind", "text"),
    [
        (nmt(NmtCommand.ENTER_PRE_OPERATIONAL), "all", "nmt", "enter pre operational"),
        (nmt(NmtCommand.START, 9), "back_left", "nmt", "start"),
        (heartbeat(127, NmtState.OPERATIONAL), "driver", "heartbeat", "operational"),
        (heartbeat(42, NmtState.STOPPED), "node 42", "heartbeat", "stopped"),
        (RIG.codec.emcy(2, 0x2310, 0x03), "front_left", "emcy", "2310h continuous over-current, motor side"),
    ],
)
def test_services(frame: Frame, node: str, kind: str, text: str) -> None:
    found = EXPLAINER.explain(seen(frame))
    assert (found.node, found.kind) == (node, kind)
    assert found.values[0].text == text


def test_what_is_wrong_is_said() -> None:
    cut = EXPLAINER.explain(Seen(0x181, b"\x37", 1))
    assert (cut.kind, cut.node) == ("malformed", "front_right")
    assert cut.note.startswith("TPDO1 of 1 bytes, expected 8")
    foreign = EXPLAINER.explain(Seen(0x3FF, b""))
    assert (foreign.kind, foreign.note) == ("other", "identifier 0x3ff is none of ours")
    error = EXPLAINER.explain(Seen(0x40, bytes(8), is_error=True))
    assert (error.kind, error.note) == ("error", "bus-off")


class Wire(canopen.Network):
    """Keeps what canopen's own master sends."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[Seen] = []

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.sent.append(Seen(can_id, bytes(data), len(data)))
        answer = {0x20: b"\x60", 0x40: b"\x43"}[data[0] & 0xE0] + bytes(data[1:4]) + b"\x2a\x00\x00\x00"
        self.notify(0x580 + (can_id & 0x7F), bytearray(answer), 0.0)
        self.sent.append(Seen(0x580 + (can_id & 0x7F), answer))


@pytest.mark.parametrize("motor", MOTORS)
def test_objects_that_canopen_writes_are_read_back(motor: str) -> None:
    """Every setting of the rig, of every size and sign, as canopen's own SDO client sends it."""
    node_id = RIG.codec.nodes[motor]
    wire = Wire()
    node = canopen.RemoteNode(node_id, RIG.dictionary)
    wire.add_node(node)
    for setting in RIG.settings(motor):
        wire.sent.clear()
        entry = node.sdo[setting.index]
        (entry if setting.index in RIG.dictionary and isinstance(RIG.dictionary[setting.index], ODVariable)
         else entry[setting.subindex]).raw = setting.value  # fmt: skip
        request, answer = (EXPLAINER.explain(frame) for frame in wire.sent)
        assert (request.node, request.what) == (motor, "SDO download request")
        (value,) = request.values
        assert (value.key, value.raw) == (f"{setting.index:04X}h:{setting.subindex}", setting.value)
        scale = RIG.scaling[motor].of_object(setting.index)
        assert (value.si, value.unit) == ((None, "") if scale is None else (scale.si(setting.value), scale.unit))
        assert (answer.what, answer.values) == ("SDO download answer", ())
        assert value.key in answer.note


def test_answers_and_aborts_of_sdos() -> None:
    answer = EXPLAINER.explain(Seen(0x582, bytes.fromhex("4B77600000FF0000")))  # 6077h: -256 ‰, of 2 bytes
    (value,) = answer.values
    assert (value.name, value.raw, value.unit) == ("torque_actual_value", -256, "N m")
    abort = EXPLAINER.explain(Seen(0x582, bytes.fromhex("8011110000000206")))
    assert abort.values[0].text == "06020000h Object does not exist"
    long = EXPLAINER.explain(Seen(0x582, bytes.fromhex("410810000D000000")))
    assert long.note == "1008h:0 manufacturer_device_name: 13 bytes follow"
    part = EXPLAINER.explain(Seen(0x602, bytes.fromhex("4018100100000000")))
    assert part.note == "1018h:1 identity_object.vendor_id"


def test_frames_are_picked_by_node_and_kind() -> None:
    found = EXPLAINER.explain(seen(RIG.codec.pdo("TPDO1", 9, (0, 0, 0))))
    none: frozenset[str] = frozenset()
    assert matches(found, none, none)
    assert matches(found, frozenset({"back_left"}), frozenset({"tpdo"}))
    assert matches(found, frozenset({"9", "driver"}), none)
    assert not matches(found, frozenset({"4"}), none)
    assert not matches(found, none, frozenset({"rpdo"}))
