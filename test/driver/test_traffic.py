"""The load of a bus: never less than the frames' true bits, and gaps and rates as they are."""

from __future__ import annotations

import random
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver.traffic import Key, Traffic, longest_bits


class Recorded(NamedTuple):
    can_id: int
    data: bytes
    dlc: int = 8
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False


def crc15(bits: list[int]) -> list[int]:
    """CAN's checksum (ISO 11898-1) of bits."""
    register = 0
    for bit in bits:
        top = register >> 14 & 1
        register = register << 1 & 0x7FFF
        if bit != top:
            register ^= 0x4599
    return [register >> k & 1 for k in range(14, -1, -1)]


def binary(value: int, width: int) -> list[int]:
    return [value >> k & 1 for k in range(width - 1, -1, -1)]


def true_bits(can_id: int, data: bytes, is_extended: bool) -> int:
    """Length of a data frame on the wire, with the stuff bits that it has and three bits between frames."""
    if is_extended:
        head = [0, *binary(can_id >> 18, 11), 1, 1, *binary(can_id & 0x3FFFF, 18), 0, 0, 0]
    else:
        head = [0, *binary(can_id, 11), 0, 0, 0]
    bits = head + binary(len(data), 4) + [bit for byte in data for bit in binary(byte, 8)]
    bits += crc15(bits)
    stuffed, run, last = 0, 0, -1
    for bit in bits:
        run, last = (run + 1 if bit == last else 1), bit
        if run == 5:
            stuffed, run, last = stuffed + 1, 1, 1 - bit
    return len(bits) + stuffed + 1 + 2 + 7 + 3


@given(can_id=st.integers(0, 2**29 - 1), data=st.binary(max_size=8), is_extended=st.booleans())
def test_no_frame_is_longer_than_the_bound(can_id: int, data: bytes, is_extended: bool) -> None:
    number = can_id if is_extended else can_id & 0x7FF
    assert true_bits(number, data, is_extended) <= longest_bits(len(data), is_extended)


@pytest.mark.parametrize("is_extended", [False, True])
def test_the_bound_is_not_far_off(is_extended: bool) -> None:
    plain = 47 + 20 * is_extended + 64
    assert plain < longest_bits(8, is_extended) <= 1.25 * plain
    assert true_bits(0, bytes(8), is_extended) > 1.1 * plain


def test_counts_rates_and_gaps_by_identifier() -> None:
    rng = random.Random(4)
    stamps = {0x181: [10_000_000 * k for k in range(301)], 0x80: [10_000_000 * k + 3_000_000 for k in range(301)]}
    del stamps[0x181][100:150]
    frames = sorted((stamp, can_id) for can_id, times in stamps.items() for stamp in times)
    traffic = Traffic()
    for stamp, can_id in frames:
        traffic.add(Recorded(can_id, rng.randbytes(8 if can_id == 0x181 else 0)), stamp)
    found = dict(traffic.in_order())
    assert list(found) == [Key(0x80, False, False), Key(0x181, False, False)]
    sync, pdo = found.values()
    assert (sync.count, sync.longest_ns, round(sync.rate, 9)) == (301, 10_000_000, 100.0)
    assert (pdo.count, pdo.longest_ns) == (251, 510_000_000)
    assert traffic.bits == 301 * longest_bits(0, False) + 251 * longest_bits(8, False)
    mean, busiest = traffic.load(500_000)
    assert mean == pytest.approx(traffic.bits / 3.003 / 500_000)
    assert busiest == pytest.approx(100 * (longest_bits(0, False) + longest_bits(8, False)) / 500_000)


def test_nothing_is_no_load() -> None:
    assert Traffic().load(500_000) == (0.0, 0.0)
