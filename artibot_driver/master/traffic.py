"""The bus as the master uses it: bounded reading, sending that is watched, and how full it is."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Final, Protocol

import can

from artibot_driver.bus import Bus, BusState, Health
from artibot_driver.frames import Frame
from artibot_driver.master.values import BusStatus
from artibot_driver.rig import frame_bits

FRAMES_A_READ: Final = 400
"""Frames that are read at once at most: more than any bus of 1 Mbit/s carries in 25 ms."""

SHARE_OF_PERIOD: Final = 0.35
"""Share of the SYNC period that reading may take."""

WINDOW: Final = 50_000_000
"""Time over which the bus's load is measured, ns."""

FULL: Final = 0.95
"""A bus with this load (stuff bits at their most, as :attr:`Rig.bus_load` counts) is flooded."""

CUT_SHORT_MOST: Final = 5
"""So many readings in a row that leave something unread: the bus says more than can be taken in."""

_CLOCK_EVERY = 16

Clock = Callable[[], int]
"""Steady time, ns."""


class AnyBus(Protocol):
    """What the master asks of a bus; :class:`artibot_driver.bus.Bus` has it."""

    def send(self, frame: Frame) -> bool:
        """Send a frame; False where it could not be sent."""

    def receive(self, timeout: float = 0.0) -> can.Message | None:
        """The next frame within `timeout` seconds, or None."""

    def health(self) -> Health:
        """What is known of its state."""


class BusTraffic:
    """Reads and sends, and measures both.

    Parameters
    ----------
    bus : AnyBus
    bitrate : int
        bit/s.
    period : int
        Of SYNC, ns.
    clock : Clock
    """

    def __init__(self, bus: AnyBus, bitrate: int, period: int, tally: Counter[str], clock: Clock) -> None:
        self.bus = bus
        self._bitrate, self._tally, self._clock = bitrate, tally, clock
        self._time_to_read = round(SHARE_OF_PERIOD * period)
        self._bits = 0
        self._loads: deque[tuple[int, int]] = deque()
        self.cut_short = 0
        self.failed = 0
        self._asked: int | None = None
        self._health = bus.health()

    def read(self) -> Iterator[can.Message]:
        """The frames that have come, oldest first, but no more than there is time for; the rest is left for later."""
        until = self._clock() + self._time_to_read
        for count in range(FRAMES_A_READ):
            message = self.bus.receive()
            if message is None:
                self.cut_short = 0
                return
            self._bits += frame_bits(len(message.data))
            yield message
            if count % _CLOCK_EVERY == _CLOCK_EVERY - 1 and self._clock() > until:
                break
        self.cut_short += 1
        self._tally["reads_cut_short"] += 1

    def send(self, frames: list[Frame]) -> bool:
        """Send what a cycle has to say; `failed` counts how often in a row something could not be sent.

        Returns
        -------
        bool
            Whether anything could, as far as is known of the bus.
        """
        if not frames:  # which says nothing of the bus
            return False
        bus = self.bus
        sent = bus.send_all(frames) if isinstance(bus, Bus) else [bus.send(frame) for frame in frames]
        self._bits += sum(frame_bits(len(frame.data)) for frame, one in zip(frames, sent, strict=True) if one)
        failures = sent.count(False)
        self._tally["not_sent"] += failures
        self.failed = self.failed + 1 if failures else 0
        return failures < len(frames) and self._health.state.carries_frames

    def check_state(self, now: int, every: int) -> BusState:
        """The bus's state, asked for anew after `every` ns, or at once where sending fails."""
        if self._asked is None or self.failed or now - self._asked >= every:
            self._asked, self._health = now, self.bus.health()
        self._loads.append((now, self._bits))
        while len(self._loads) > 1 and self._loads[1][0] <= now - WINDOW:
            self._loads.popleft()  # one stays from before: what a late check finds has come since the check before it
        return self._health.state

    @property
    def load(self) -> float:
        """Share of the bit rate that was used in the last 50 ms or since the check before; 0 at first."""
        (begin, before), (end, after) = self._loads[0], self._loads[-1]
        took = end - begin
        return 0.0 if took < 0.8 * WINDOW else 1e9 * (after - before) / (took * self._bitrate)

    @property
    def flooded(self) -> bool:
        """Whether the bus is full, or says more than can be taken in."""
        return self.cut_short >= CUT_SHORT_MOST or (bool(self._loads) and self.load > FULL)

    def status(self) -> BusStatus:
        """All about it, for a person."""
        health = self._health
        load = self.load if self._loads else 0.0
        return BusStatus(health.state, load, health.tx_errors, health.rx_errors, health.reason)
