"""How full a bus was, and which frames filled it: counts, rates and gaps by identifier, and the load."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

from artibot_driver.explain import AnyFrame
from artibot_driver.rig import frame_bits

_SECOND: Final = 1_000_000_000
_EXTENSION: Final = 20
"""Bits that a 29-bit identifier takes beyond one of 11 bits, stuff bits apart."""


class Key(NamedTuple):
    """What frames are distinguished by."""

    can_id: int
    is_extended: bool
    is_error: bool


@dataclass
class FrameCount:
    """Frames of one identifier: how many, first and last stamp and the longest time between two of them, ns."""

    count: int
    first_ns: int
    last_ns: int
    longest_ns: int = 0
    bits: int = 0

    @property
    def rate(self) -> float:
        """Frames a second between the first and the last, 0 for a single one."""
        return (self.count - 1) * _SECOND / (self.last_ns - self.first_ns) if self.last_ns > self.first_ns else 0.0


class Traffic:
    """Adds up frames in the order of their stamps; memory grows with identifiers alone.

    Attributes
    ----------
    series : by identifier.
    bits : of all frames, were each stuffed with as many bits as can be; error frames take none.
    busiest : most bits in one whole second after the first frame.
    """

    def __init__(self) -> None:
        self.series: dict[Key, FrameCount] = {}
        self.bits = self.busiest = self.count = 0
        self._first_ns = self._last_ns = 0
        self._second = self._bits_of_second = 0

    def add(self, frame: AnyFrame, stamp_ns: int) -> None:
        """Count a frame."""
        key = Key(frame.can_id, frame.is_extended, frame.is_error)
        bits = 0 if frame.is_error else longest_bits(len(frame.data), frame.is_extended)
        self._first_ns = self._first_ns if self.count else stamp_ns
        self.count += 1
        self.bits += bits
        self._last_ns = max(self._last_ns, stamp_ns)
        second = (stamp_ns - self._first_ns) // _SECOND
        if second != self._second:
            self._second, self._bits_of_second = second, 0
        self._bits_of_second += bits
        self.busiest = max(self.busiest, self._bits_of_second)
        known = self.series.get(key)
        if known is None:
            self.series[key] = FrameCount(1, stamp_ns, stamp_ns, bits=bits)
            return
        known.longest_ns = max(known.longest_ns, stamp_ns - known.last_ns)
        known.last_ns = max(known.last_ns, stamp_ns)
        known.count += 1
        known.bits += bits

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (self._last_ns - self._first_ns) / _SECOND

    def load(self, bitrate: int) -> tuple[float, float]:
        """Return the shares of a bus's bits that were taken: on average, and in the busiest second."""
        return self.bits / (bitrate * max(self.seconds, 1.0)), self.busiest / bitrate

    def in_order(self) -> Iterator[tuple[Key, FrameCount]]:
        """Identifiers and their frames, those of the highest priority first."""
        yield from sorted(self.series.items())


def longest_bits(length: int, is_extended: bool) -> int:
    """Most bits that a data frame takes on the bus; see :func:`frame_bits`."""
    if not is_extended:
        return frame_bits(length)
    return 47 + _EXTENSION + 8 * length + (34 + _EXTENSION + 8 * length - 1) // 4
