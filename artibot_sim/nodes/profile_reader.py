"""Reading a profile of thousands of points without holding up a loop that has to be punctual.

rclpy turns 3000 points into Python objects in one go of 0.14 s, in which no other thread runs. Here the serialised
message is read point by point, if wanted in a thread beside the loop.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace as Record

from artibot_sim.nodes.profile import Profile, Refused, parse_profile


class _Cdr:
    """Reads CDR from front to back; what is aligned is so relative to the first byte after the header of four."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 4
        order = "<" if data[1] & 1 else ">"
        self._word, self._time, self._order = struct.Struct(order + "I"), struct.Struct(order + "iI"), order

    def _align(self, size: int) -> int:
        return self._at + (4 - self._at) % size

    def count(self) -> int:
        """An unsigned 32-bit integer."""
        at = self._align(4)
        self._at = at + 4
        return int(self._word.unpack_from(self._data, at)[0])

    def time(self) -> Record:
        """Seconds and nanoseconds."""
        at = self._align(4)
        self._at = at + 8
        sec, nanosec = self._time.unpack_from(self._data, at)
        return Record(sec=sec, nanosec=nanosec)

    def text(self) -> str:
        """A string, sent with its length and a zero at its end."""
        length = self.count()
        at, self._at = self._at, self._at + length
        if self._at > len(self._data):
            raise IndexError("a string longer than the message")
        return self._data[at : at + length - 1].decode()

    def numbers(self) -> tuple[float, ...]:
        """A sequence of doubles."""
        length = self.count()
        if not length:
            return ()
        at = self._align(8)
        self._at = at + 8 * length
        if self._at > len(self._data):
            raise IndexError("a sequence longer than the message")
        return struct.unpack_from(f"{self._order}{length}d", self._data, at)


def read_trajectory(data: bytes) -> Record:
    """A serialised trajectory_msgs/JointTrajectory as :func:`parse_profile` takes it.

    Raises
    ------
    Refused
        When it is none.
    """
    try:
        cdr = _Cdr(data)
        stamp, _frame = cdr.time(), cdr.text()
        names = [cdr.text() for _ in range(cdr.count())]
        points = []
        for _ in range(cdr.count()):
            positions, velocities = cdr.numbers(), cdr.numbers()
            cdr.numbers(), cdr.numbers()  # accelerations, efforts
            points.append(Record(positions=positions, velocities=velocities, time_from_start=cdr.time()))
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise Refused(f"it cannot be decoded: {error}") from error
    return Record(header=Record(stamp=stamp), joint_names=names, points=points)


Read = tuple[Profile | Refused, float]
"""A profile, or why it is none, and when its message came (steady s)."""


class ProfileReader:
    """Reads profiles, in the order in which they came.

    Parameters
    ----------
    beside : bool
        In a thread of its own; otherwise at once.
    """

    def __init__(self, beside: bool) -> None:
        self._pool = ThreadPoolExecutor(1, "profile") if beside else None
        self._under_way: list[Future[Read]] = []
        self._read: list[Read] = []

    def submit(self, data: bytes, received: float) -> None:
        """Read a serialised message, received at `received` (steady s)."""
        if self._pool is None:
            self._read.append(_read(data, received))
        else:
            self._under_way.append(self._pool.submit(_read, data, received))

    def drop(self) -> None:
        """Forget what came so far."""
        self._under_way, self._read = [], []

    def results(self) -> Iterator[Read]:
        """What has been read since the last call."""
        while self._under_way and self._under_way[0].done():
            self._read.append(self._under_way.pop(0).result())
        while self._read:
            yield self._read.pop(0)


def _read(data: bytes, received: float) -> Read:
    try:
        return parse_profile(read_trajectory(data)), received
    except Refused as reason:
        return reason, received
