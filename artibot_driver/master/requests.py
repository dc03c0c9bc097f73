"""Requests to the master: wishes that any thread may set, taken by the next cycle and then gone."""

from __future__ import annotations

import enum
import threading
from typing import NamedTuple

from artibot_driver.master.values import Reason, Stop


class Request(enum.Enum):
    """What can be asked for."""

    ENABLE = "enable"
    STOP = "stop"
    RESET = "reset faults"


class Wishes(NamedTuple):
    """What was asked for since the last cycle; `stop` is the first of the reasons, with the cycle's time."""

    enable: bool
    reset: bool
    stop: Stop | None
    number: int


class Requests:
    """Wishes that wait for the next cycle."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[tuple[Request, Reason, str]] = []

    def ask(self, request: Request, reason: Reason = Reason.DISABLE, text: str = "") -> None:
        """Set a wish; the reason counts for a stop only."""
        with self._lock:
            self._waiting.append((request, reason, text))

    def take(self, now: int) -> Wishes:
        """All wishes, which are gone then."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
        kinds = {request for request, _, _ in waiting}
        stops = [Stop(reason, text, now) for request, reason, text in waiting if request is Request.STOP]
        return Wishes(Request.ENABLE in kinds, Request.RESET in kinds, stops[0] if stops else None, len(waiting))
