"""A recording's messages ahead of time: read by a thread of their own, so that a slow disk delays none."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.storage import BagInfo, RawMessage, iter_messages
from artibot_sim.nodes.common.stamps import SECOND, stamp_of

AHEAD = 64 << 20
"""Bytes that are read ahead, at most."""
MOST = 10_000
"""Messages that are read ahead, at most."""
GAP_NS = 10_000_000
"""Between the last instant of a pass and the first one of the next, ns."""


@dataclass(frozen=True)
class PlayedSpan:
    """The part of a recording that is played, log times in ns; `end_ns` is still played."""

    begin_ns: int
    end_ns: int

    @property
    def period_ns(self) -> int:
        """From one pass to the next."""
        return self.end_ns - self.begin_ns + GAP_NS

    @classmethod
    def of(cls, info: BagInfo, start: float | None, end: float | None) -> PlayedSpan:
        """Return the stretch from `start` to `end`, seconds from the recording's beginning.

        Raises
        ------
        ArtibotError
            If there is nothing between them.
        """
        length = (info.end_ns - info.start_ns) / SECOND
        begin = info.start_ns + round((start or 0.0) * SECOND)
        last = info.end_ns if end is None else min(info.end_ns, info.start_ns + round(end * SECOND))
        if begin > last:
            raise ArtibotError(
                f"{info.path}: nothing from {start or 0:g} s to {end or length:g} s; it is {length:g} s long"
            )
        return cls(begin, last)


class Due(NamedTuple):
    """A message and when it is due: ns since the beginning of the first pass; `pass_number` counts from 0."""

    at_ns: int
    pass_number: int
    message: RawMessage


class MessageSource:
    """Messages of a stretch in order, pass after pass.

    Parameters
    ----------
    path : of the recording.
    topics : names as recorded.
    latched : those of them whose last message before the stretch is given out at its beginning.
    stretch : what to play.
    loop : whether to begin again at the end.
    admits : says which messages to give out; all if None.
    """

    def __init__(
        self, path: Path, topics: Collection[str], latched: Collection[str], stretch: PlayedSpan, loop: bool,
        admits: Callable[[RawMessage], bool] | None = None,
    ) -> None:  # fmt: skip
        self.path = path
        self.topics = set(topics)
        self.stretch = stretch
        self.loop = loop
        self._admits = admits
        self._latched = set(latched)
        self._queue: deque[Due] = deque()
        self._bytes = 0
        self._taken = 0
        self._error: ArtibotError | None = None
        self._done = self._stopped = False
        self._thread = threading.Thread(target=self._read, name="bag reader", daemon=True)
        self._thread.start()

    def wait_ready(self) -> None:
        """Wait until enough is read to begin."""
        while not self._done and self._bytes - self._taken < AHEAD // 4 and len(self._queue) < MOST // 4:
            time.sleep(0.002)

    def close(self) -> None:
        """End the reading."""
        self._stopped = True
        self._thread.join()

    def __iter__(self) -> Iterator[Due | None]:
        """Yield messages, and None while the next one is not read yet.

        Raises
        ------
        ArtibotError
            Where the recording turns out to be damaged: what came before has been given out.
        """
        while True:
            done = self._done  # looked at first: what was queued before it is still given out
            if self._queue:
                due = self._queue.popleft()
                self._taken += len(due.message.data)
                yield due
            elif done:
                break
            else:
                yield None
        if self._error is not None:
            raise self._error

    def _read(self) -> None:
        """Fill the queue: the thread's body."""
        try:
            for due in self._passes():
                while (self._bytes - self._taken > AHEAD or len(self._queue) >= MOST) and not self._stopped:
                    time.sleep(0.005)
                if self._stopped:
                    return
                self._queue.append(due)
                self._bytes += len(due.message.data)
        except ArtibotError as error:
            self._error = error
        finally:
            self._done = True

    def _passes(self) -> Iterator[Due]:
        begin, end = self.stretch.begin_ns, self.stretch.end_ns
        before = self._before()
        number = 0
        while True:
            offset = number * self.stretch.period_ns
            yield from (Due(offset, number, message) for message in before)
            count = len(before)
            for message in iter_messages(self.path, self.topics, begin, end + 1):
                if self._admits is None or self._admits(message):
                    yield Due(offset + max(0, message.log_ns - begin), number, message)
                    count += 1
            if not self.loop or not count:
                return
            number += 1

    def _before(self) -> list[RawMessage]:
        """Return the last message of each latched topic before the stretch, in order."""
        if not self._latched:
            return []
        latest = {m.channel.topic: m for m in iter_messages(self.path, self._latched, None, self.stretch.begin_ns)}
        return sorted(latest.values(), key=lambda message: message.log_ns)


class RecordedTime:
    """The time of the recording, for `/clock`: that of its own `/clock` if it has one, else the log time.

    Parameters
    ----------
    path : of the recording.
    stretch : what is played.
    has_clock : whether `/clock` was recorded.
    """

    def __init__(self, path: Path, stretch: PlayedSpan, has_clock: bool) -> None:
        self.stretch = stretch
        self._log: list[int] = []
        self._clock: list[int] = []
        for message in iter_messages(path, {"/clock"}) if has_clock else ():
            if len(message.data) >= 12 and (not self._clock or stamp_of(message.data) > self._clock[-1]):
                self._log.append(message.log_ns)
                self._clock.append(stamp_of(message.data))
        self._period = self._at(stretch.end_ns) - self._at(stretch.begin_ns) + GAP_NS

    def _at(self, log_ns: int) -> int:
        """Return the recorded time at a log time: between two recorded clocks in proportion, outside in step."""
        if not self._log:
            return log_ns
        i = bisect_right(self._log, log_ns) - 1
        if i < 0 or i == len(self._log) - 1:
            i = max(i, 0)
            return self._clock[i] + log_ns - self._log[i]
        share = (log_ns - self._log[i]) / max(1, self._log[i + 1] - self._log[i])
        return self._clock[i] + round(share * (self._clock[i + 1] - self._clock[i]))

    def at(self, since_ns: int) -> int:
        """Return the time to publish `since_ns` after the beginning of the first pass; increasing, also over passes."""
        number, rest = divmod(since_ns, self.stretch.period_ns)
        return self.shift(number) + self._at(self.stretch.begin_ns + rest)

    def shift(self, pass_number: int) -> int:
        """Return by how much the time of a pass is ahead of the recording's, ns."""
        return pass_number * self._period


def lateness_summary(late_s: np.ndarray) -> dict[str, float]:
    """Return median, p99 and largest lateness, ms; empty for no messages."""
    if not len(late_s):
        return {}
    ms = 1e3 * np.asarray(late_s, float)
    return {
        "late_p50_ms": float(np.median(ms)), "late_p99_ms": float(np.quantile(ms, 0.99)), "late_max_ms": float(ms.max())
    }  # fmt: skip
