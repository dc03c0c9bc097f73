"""Frames are encoded and decoded as canopen does it, and whatever comes is decoded without an exception."""

from __future__ import annotations

import can
import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver import fuzz
from artibot_driver.dictionary import Field, PdoMap, load_dictionary
from artibot_driver.frames import (
    ERRORS,
    Emcy,
    Frame,
    Heartbeat,
    Malformed,
    Nmt,
    NmtCommand,
    NmtState,
    Sdo,
    Sync,
    UnknownFrame,
    error_text,
    heartbeat,
    nmt,
    register_text,
)
from artibot_driver.pdo import Codec, Pdo
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS

NODES = {motor: k for k, motor in enumerate(MOTORS, 1)}
CODEC = Codec(load_dictionary(), NODES)
NAMES = sorted(CODEC.maps)


def values_of(each: PdoMap) -> st.SearchStrategy[tuple[int, ...]]:
    """Values that fit the fields of a PDO."""
    return st.tuples(*(st.integers(*field.range) for field in each.fields))


@pytest.mark.parametrize("name", NAMES)
@given(data=st.data(), node=st.sampled_from(sorted(NODES.values())))
def test_a_pdo_comes_back(name: str, data: st.DataObject, node: int) -> None:
    each = CODEC.maps[name]
    values = data.draw(values_of(each))
    frame = CODEC.pdo(name, node, values)
    assert CODEC.decode(*frame) == Pdo(node, each, values)
    named = dict(zip((field.name for field in each.fields), values, strict=True))
    assert CODEC.pdo(name, node, named) == frame
    pdo = CODEC.decode(*frame)
    assert isinstance(pdo, Pdo)
    assert {field: pdo.value(field) for field in named} == named


@pytest.mark.parametrize("name", NAMES)
@given(data=st.data())
def test_canopen_makes_the_same_bytes(name: str, data: st.DataObject) -> None:
    node = canopen.Network().create_node(3, load_dictionary(node=3))
    theirs = {"R": node.rpdo, "T": node.tpdo}[name[0]][int(name[4:])]
    theirs.read(from_od=True)
    values = data.draw(values_of(CODEC.maps[name]))
    for variable, value in zip(theirs, values, strict=True):
        variable.raw = value
    ours = CODEC.pdo(name, 3, values)
    assert (theirs.cob_id, bytes(theirs.data)) == (ours.can_id, ours.data)


def misfits(field: Field) -> list[object]:
    low, high = field.range
    return [low - 1, high + 1, 0.5, None, "1"]


@pytest.mark.parametrize("name", NAMES)
def test_values_that_do_not_fit_are_refused_by_name(name: str) -> None:
    each = CODEC.maps[name]
    good: list[object] = [0] * len(each.fields)
    for k, field in enumerate(each.fields):
        for value in misfits(field):
            with pytest.raises(ArtibotError, match=f"^{name}: found .*{field.name} "):
                CODEC.pdo(name, 1, good[:k] + [value] + good[k + 1 :])  # type: ignore[arg-type]
    for wrong in (good[1:], [*good, 0], {"controlword": 1}, dict.fromkeys([f.name for f in each.fields] + ["more"], 0)):
        with pytest.raises(ArtibotError, match=f"^{name}: found"):
            CODEC.pdo(name, 1, wrong)  # type: ignore[arg-type]
    with pytest.raises(ArtibotError, match="PDO 'RPDO4': not mapped in the EDS; expected one of RPDO1, TPDO1, TPDO2"):
        CODEC.pdo("RPDO4", 1, (0,))


@given(node=st.integers(1, 127), state=st.sampled_from(NmtState), command=st.sampled_from(NmtCommand))
def test_services_come_back(node: int, state: NmtState, command: NmtCommand) -> None:
    assert CODEC.decode(*heartbeat(node, state)) == Heartbeat(node, state)
    assert CODEC.decode(*nmt(command, node)) == Nmt(command, node)
    assert CODEC.decode(*nmt(command)) == Nmt(command, 0)
    assert CODEC.decode(*CODEC.sync()) == Sync(None)
    frame = CODEC.emcy(node, 0x8130, 0x11, b"abcde")
    assert CODEC.decode(*frame) == Emcy(node, 0x8130, 0x11, b"abcde")


def test_identifiers_are_the_predefined_ones() -> None:
    assert CODEC.sync() == Frame(0x080, b"")
    assert nmt(NmtCommand.START, 4) == Frame(0x000, b"\x01\x04")
    assert heartbeat(4, NmtState.OPERATIONAL) == Frame(0x704, b"\x05")
    assert CODEC.emcy(4, 0x8130, 0x11) == Frame(0x084, bytes.fromhex("3081110000000000"))
    assert CODEC.pdo("RPDO1", 4, (0x0F, 1000, -1)) == Frame(0x204, bytes.fromhex("0f00e8030000ffff"))


def test_an_emergency_in_words() -> None:
    emergency = CODEC.decode(0x081, bytes.fromhex("3081110000000000"))
    assert isinstance(emergency, Emcy)
    assert emergency.text == "8130h heartbeat or life guarding missed (error register: generic, communication)"
    assert error_text(0x2355) == "2355h load too high (I²t, thermal state)"
    assert error_text(0x23FF) == "23FFh current on the output side"
    assert error_text(0xFF17) == "FF17h manufacturer's own"
    assert error_text(0x0000) == "0000h no error, or errors reset"
    assert error_text(0xA000) == "A000h reserved"
    assert register_text(0) == "none"


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFF))
def test_every_error_has_words(code: int, register: int) -> None:
    text = error_text(code)
    assert text.startswith(f"{code:04X}h ")
    assert text[6:] in {*ERRORS.values(), "reserved"}
    assert register_text(register)


def test_sdo_frames_as_canopen_sends_them() -> None:
    # what candump shows while canopen reads 6041h of node 1 and writes 6060h
    assert CODEC.decode(0x601, bytes.fromhex("4041600000000000")) == Sdo(1, True, "upload", 0x6041, 0, bytes(4))
    assert CODEC.decode(0x581, bytes.fromhex("4b41600037020000")) == Sdo(1, False, "upload", 0x6041, 0, b"\x37\x02\0\0")
    assert CODEC.decode(0x601, bytes.fromhex("2f60600009000000")) == Sdo(1, True, "download", 0x6060, 0, b"\x09\0\0\0")
    abort = CODEC.decode(0x581, bytes.fromhex("8060600030000906"))
    assert abort == Sdo(1, False, "abort", 0x6060, 0, bytes.fromhex("30000906"))


@pytest.mark.parametrize(
    ("can_id", "data", "node", "reason"),
    [
        (0x181, "00", 1, "TPDO1 of 1 bytes, expected 8: EDS and the drive's own mapping differ"),
        (0x080, "0102", 0, "SYNC of 2 bytes, expected 0, or 1"),
        (0x000, "01", 0, "NMT of 1 bytes, expected 2"),
        (0x000, "0300", 0, "NMT command 3 for node 0"),
        (0x000, "0180", 0, "NMT command 1 for node 128"),
        (0x701, "", 1, "heartbeat without data"),
        (0x701, "85", 1, "heartbeat 85; expected one byte, 0, 4, 5 or 127"),
        (0x701, "0500", 1, "heartbeat 0500"),
        (0x082, "3081", 2, "EMCY of 2 bytes, expected 8"),
        (0x601, "40", 1, "SDO of 1 bytes, expected 8"),
        (0x601, "ff00000000000000", 1, "SDO command 0xff"),
    ],
)
def test_what_is_malformed_says_why(can_id: int, data: str, node: int, reason: str) -> None:
    found = CODEC.decode(can_id, bytes.fromhex(data))
    assert isinstance(found, Malformed)
    assert found.node == node
    assert reason in found.reason


@given(length=st.integers(0, 8), name=st.sampled_from(NAMES), node=st.sampled_from(sorted(NODES.values())))
def test_a_cut_pdo_is_never_taken_for_one(length: int, name: str, node: int) -> None:
    frame = CODEC.pdo(name, node, [0] * len(CODEC.maps[name].fields))
    found = CODEC.decode(frame.can_id, frame.data[:length])
    assert isinstance(found, Pdo if length == 8 else Malformed)


@given(
    extended=st.booleans(), remote=st.booleans(), error=st.booleans(), can_id=st.integers(0, 0x7FF),
    data=st.binary(max_size=8),
)  # fmt: skip
def test_any_message_of_python_can_is_decoded(
    extended: bool, remote: bool, error: bool, can_id: int, data: bytes
) -> None:
    message = can.Message(
        arbitration_id=can_id, is_extended_id=extended, is_remote_frame=remote, is_error_frame=error,
        data=None if remote else data,
    )  # fmt: skip
    found = CODEC.decode_message(message)
    if extended or remote or error:
        assert isinstance(found, UnknownFrame)
        assert ("error" if error else "extended" if extended else "remote") in found.reason
    else:
        assert found == CODEC.decode(can_id, data)
        assert isinstance(found, UnknownFrame) is not CODEC.knows(can_id)


def test_a_pdo_of_a_node_that_is_not_ours_is_unknown() -> None:
    assert CODEC.decode(0x185, bytes(8)) == UnknownFrame("identifier 0x185 is none of ours")


@pytest.mark.parametrize("seed", [1, 2])
def test_random_frames_never_raise_and_lead_a_drive_only_along_the_table(seed: int) -> None:
    kinds, changes = fuzz.run(100_000, seed)
    assert sum(kinds.values()) == 100_000
    assert {"UnknownFrame", "Malformed", "Pdo", "Sdo", "Emcy", "Sync"} <= set(kinds)
    assert {"0", "1", "2", "4", "13"} <= set(changes)  # it does get enabled, faulted and reset
    assert (kinds, changes) == fuzz.run(100_000, seed)  # a seed is a reproduction


def test_two_services_on_one_identifier_are_refused() -> None:
    with pytest.raises(ArtibotError, match=r"RPDO1 of front_left: identifier 0x201 is taken"):
        Codec(load_dictionary(), {"front_right": 1, "front_left": 1})
