"""A simulated drive's objects refuse what CiA 301 refuses, and its SDO server answers any request once."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver.dictionary import load_dictionary
from artibot_driver.simulated import objects as codes
from artibot_driver.simulated.objects import NO_SUCH_COMMAND, TOGGLE_WRONG, Abort, Objects, SdoServer

DICTIONARY = load_dictionary(node=3)


def fresh() -> Objects:
    return Objects(DICTIONARY, {(0x6076, 0): 850})


def test_values_begin_as_the_eds_or_the_commissioning_says() -> None:
    objects = fresh()
    assert objects.values[0x6076, 0] == 850
    assert objects.values[0x1400, 1] == 0x203
    assert objects.read((0x1008, 0)) == b"artibot drive"
    assert objects.read((0x60C2, 2)) == struct.pack("b", -3)
    objects.write((0x6085, 0), bytes(4))
    objects.write((0x1017, 0), b"\x10\x00")
    objects.reset(communication_only=True)
    assert (objects.values[0x6085, 0], objects.values[0x1017, 0]) == (0, 0)
    objects.write((0x1017, 0), b"\x10\x00")
    objects.reset()
    assert (objects.values[0x6085, 0], objects.values[0x1017, 0]) == (4_500_000, 0)


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (0x2000, 0, bytes(4), codes.NO_OBJECT),
        (0x1018, 9, bytes(4), codes.NO_SUBINDEX),
        (0x6041, 0, bytes(2), codes.READ_ONLY),
        (0x6076, 0, bytes(4), codes.READ_ONLY),
        (0x1008, 0, b"name", codes.READ_ONLY),
        (0x6040, 0, bytes(4), codes.WRONG_LENGTH),
        (0x6040, 0, b"", codes.WRONG_LENGTH),
        (0x605E, 0, b"\x03\x00", codes.TOO_HIGH),
        (0x605E, 0, b"\xff\xff", codes.TOO_LOW),
        (0x1600, 1, struct.pack("<I", 0x60400010), codes.NOT_NOW),  # the PDO is on
        (0x1400, 1, struct.pack("<I", 0x123), codes.INVALID_VALUE),
        (0x1400, 2, b"\xff", codes.TOO_HIGH),
    ],
)
def test_what_cannot_be_written_is_refused_with_cia_301_s_code(
    index: int, subindex: int, data: bytes, code: int
) -> None:
    objects = fresh()
    before = dict(objects.values)
    with pytest.raises(Abort) as refused:
        objects.write((index, subindex), data)
    assert refused.value.code == code
    assert objects.values == before


def off(objects: Objects, communication: int = 0x1400) -> None:
    """Switch a PDO off and empty its mapping."""
    objects.write((communication, 1), struct.pack("<I", 0x80000203))
    objects.write((communication + 0x200, 0), b"\x00")


def test_a_pdo_is_mapped_anew_in_the_standard_s_order() -> None:
    objects = fresh()
    off(objects)
    assert objects.pdo(0x1400) is None
    for k, word in enumerate((0x60710010, 0x60400010), 1):
        objects.write((0x1600, k), struct.pack("<I", word))
    objects.write((0x1600, 0), b"\x02")
    objects.write((0x1400, 1), struct.pack("<I", 0x203))
    found = objects.pdo(0x1400)
    assert found is not None
    assert (found[0], found[1].size, found[2]) == (0x203, 4, ((0x6071, 0), (0x6040, 0)))


@pytest.mark.parametrize(
    ("word", "code"),
    [
        (0x20000010, codes.NOT_MAPPABLE),
        (0x60400020, codes.NOT_MAPPABLE),  # it has 16 bits
        (0x10170010, codes.NOT_MAPPABLE),  # its PDOMapping is 0
        (0x60410010, codes.NOT_MAPPABLE),  # what only the drive writes cannot be received
    ],
)
def test_what_cannot_be_mapped_is_refused(word: int, code: int) -> None:
    objects = fresh()
    off(objects)
    with pytest.raises(Abort) as refused:
        objects.write((0x1600, 1), struct.pack("<I", word))
    assert refused.value.code == code


def test_a_mapping_that_is_too_long_or_has_gaps_is_refused() -> None:
    objects = fresh()
    off(objects)
    for k in (1, 2, 3):
        objects.write((0x1600, k), struct.pack("<I", 0x60FF0020))
    with pytest.raises(Abort) as refused:
        objects.write((0x1600, 0), b"\x03")
    assert refused.value.code == codes.PDO_TOO_LONG
    objects.write((0x1600, 2), bytes(4))
    with pytest.raises(Abort) as refused:
        objects.write((0x1600, 0), b"\x02")
    assert refused.value.code == codes.NOT_MAPPABLE


def abort(index: int, subindex: int, code: int) -> bytes:
    """The frame of an abort."""
    return struct.pack("<BHBI", 0x80, index, subindex, code)


def test_a_text_is_read_in_segments() -> None:
    server = SdoServer(fresh())
    assert server.answer(bytes.fromhex("4008100000000000")) == bytes.fromhex("410810000d000000")
    first = server.answer(bytes.fromhex("6000000000000000"))
    second = server.answer(bytes.fromhex("7000000000000000"))
    assert first == b"\x00artibot"
    assert second == b"\x13 drive\x00"
    assert server.answer(bytes.fromhex("6000000000000000")) == abort(0x1008, 0, NO_SUCH_COMMAND)


def test_segments_out_of_turn_end_the_transfer() -> None:
    server = SdoServer(fresh())
    server.answer(bytes.fromhex("4008100000000000"))
    assert server.answer(bytes.fromhex("7000000000000000")) == abort(0x1008, 0, TOGGLE_WRONG)
    server.answer(bytes.fromhex("4008100000000000"))
    assert server.answer(abort(0x1008, 0, 0x08000000)) is None
    assert server.answer(bytes.fromhex("6000000000000000")) == abort(0x1008, 0, NO_SUCH_COMMAND)


def test_a_client_need_not_say_how_many_bytes_it_sends() -> None:
    server = SdoServer(objects := fresh())
    for index, value, size in ((0x1017, 250, 2), (0x605E, 2, 2), (0x6085, 70_000, 4)):
        request = struct.pack("<BHBI", 0x22, index, 0, value)
        assert server.answer(request) == struct.pack("<BHBI", 0x60, index, 0, 0)
        assert objects.values[index, 0] == value and len(objects.read((index, 0))) == size
    assert server.answer(struct.pack("<BHBI", 0x22, 0x2000, 0, 1)) == abort(0x2000, 0, codes.NO_OBJECT)


def test_a_segmented_or_block_download_is_refused() -> None:
    server = SdoServer(fresh())
    for command in (0x21, 0xC2, 0x00):
        answer = server.answer(bytes((command, 0x40, 0x60, 0, 2, 0, 0, 0)))
        assert answer is not None
        assert answer[0] == 0x80
        assert struct.unpack_from("<I", answer, 4)[0] == NO_SUCH_COMMAND


@pytest.mark.parametrize(
    ("index", "threshold", "switches"),
    [
        (0x1000, 0, False),  # CiA 301: no protocol switch is allowed
        (0x1000, 3, False),  # the object has four bytes
        (0x1000, 4, True),
        (0x1008, 12, False),
        (0x1008, 13, True),
    ],
)
def test_a_block_upload_becomes_an_ordinary_one_up_to_the_switch_threshold_only(
    index: int, threshold: int, switches: bool
) -> None:
    server = SdoServer(fresh())
    answer = server.answer(struct.pack("<BHBBBH", 0xA0, index, 0, 64, threshold, 0))
    if switches:
        assert answer is not None and answer[0] >> 5 == 2  # upload response
    else:
        assert answer == abort(index, 0, NO_SUCH_COMMAND)


@given(requests=st.lists(st.binary(max_size=8) | st.binary(min_size=8, max_size=8), max_size=30))
def test_any_bytes_get_one_answer_of_eight_bytes_or_none(requests: list[bytes]) -> None:
    server = SdoServer(fresh())
    for request in requests:
        answer = server.answer(request)
        if len(request) != 8 or request[0] >> 5 == 4:
            assert answer is None
        else:
            assert answer is not None
            assert len(answer) == 8
    assert server.answer(bytes.fromhex("4041600000000000")) == bytes.fromhex("4b41600000000000")
