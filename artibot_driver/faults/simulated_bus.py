"""A bus in memory for time that a trial sets, and an unreliable bus around any other."""

from __future__ import annotations

import random
from collections import Counter, deque
from dataclasses import dataclass

import can

from artibot_driver.bus import BusState, Health
from artibot_driver.frames import Frame
from artibot_driver.master.traffic import AnyBus


class MemoryBus:
    """One end of a bus in memory.

    Attributes
    ----------
    inbox : deque of Frame
        What it has not read yet.
    state : BusState
        What its controller, or the interface, can do.
    """

    def __init__(self) -> None:
        self.inbox: deque[Frame] = deque()
        self.other: MemoryBus = self
        self.state = BusState.ACTIVE

    def send(self, frame: Frame) -> bool:
        """Put a frame into the other end's inbox."""
        if self.state.carries_frames:
            self.other.inbox.append(frame)
        return self.state.carries_frames

    def receive(self, timeout: float = 0.0) -> can.Message | None:
        """The next frame; nobody waits in time that does not pass by itself."""
        return message_of(self.inbox.popleft()) if self.inbox and self.state.carries_frames else None

    def health(self) -> Health:
        """Its state."""
        return Health(self.state, None, None, "" if self.state is BusState.ACTIVE else self.state.value)


def memory_buses() -> tuple[MemoryBus, MemoryBus]:
    """A bus in memory with two ends."""
    one, other = MemoryBus(), MemoryBus()
    one.other, other.other = other, one
    return one, other


def message_of(frame: Frame) -> can.Message:
    """A frame as python-can has it."""
    return can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)


@dataclass
class Interference:
    """Chance of each mishap, 0 to 1, for every frame in either direction."""

    lost: float = 0.0
    duplicated: float = 0.0
    reordered: float = 0.0
    truncated: float = 0.0


class UnreliableBus:
    """A bus on which frames meet with mishaps, by chance.

    Attributes
    ----------
    interference : Interference
    done : Counter
        What has happened, by kind.
    cut : bool
        Whether nothing passes at all, as with a controller that has left the bus.
    room : int
        So many frames are taken all the same and wait, as in the queue of an interface whose cable is off.
    """

    def __init__(self, bus: AnyBus, rng: random.Random) -> None:
        self.bus = bus
        self.cut = False
        self.room = 0
        self._waiting: list[Frame] = []
        self.interference = Interference()
        self.done: Counter[str] = Counter()
        self._rng = rng
        self._kept: Frame | None = None
        self._coming: deque[can.Message] = deque()
        self._late: can.Message | None = None

    def _happens(self, kind: str) -> bool:
        chance = getattr(self.interference, kind)
        happens = chance > 0.0 and self._rng.random() < chance
        self.done[kind] += happens
        return happens

    def send(self, frame: Frame) -> bool:
        """Send a frame, or what becomes of it."""
        if self.cut:
            taken = len(self._waiting) < self.room
            self._waiting += [frame] * taken
            return taken
        if self._happens("lost"):
            return True
        if self._happens("truncated"):
            frame = Frame(frame.can_id, frame.data[: self._rng.randrange(len(frame.data) + 1)])
        if self._kept is None and self._happens("reordered"):
            self._kept = frame
            return True
        sent = self.bus.send(frame)
        if self._happens("duplicated"):
            self.bus.send(frame)
        if self._kept is not None:
            kept, self._kept = self._kept, None
            self.bus.send(kept)
        return sent

    def join(self) -> None:
        """No longer cut: what waits goes out at once."""
        self.cut = False
        for frame in self._waiting:
            self.bus.send(frame)
        self._waiting = []

    def receive(self, timeout: float = 0.0) -> can.Message | None:
        """The next frame, or what has become of it."""
        if self.cut:
            while self.bus.receive() is not None:  # what the controller reports of itself is taken in by that
                pass
            return None
        if self._coming:
            return self._coming.popleft()
        message = self.bus.receive(timeout)
        if message is None:
            message, self._late = self._late, None
            return message
        if self._happens("lost"):
            return self.receive(0.0)
        if self._happens("truncated"):
            cut = self._rng.randrange(len(message.data) + 1)
            message = message_of(Frame(message.arbitration_id, bytes(message.data[:cut])))
        if self._late is None and self._happens("reordered"):
            self._late = message
            return self.receive(0.0)
        if self._happens("duplicated"):
            self._coming.append(message)
        if self._late is not None:
            self._coming.append(self._late)
            self._late = None
        return message

    def health(self) -> Health:
        """That of the bus."""
        return self.bus.health()
