"""The driver's services, their answers, and `enable_on_start`: requests of the master and what came of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from artibot_driver.master import MasterStatus, Phase, SetupStage, StopRecord

# ----------------------------------------------------------------------
# Answers of the driver's services: what came of a request, found by checking the master's status once a cycle.
# ----------------------------------------------------------------------


Answer = tuple[bool, str]
"""Success, and one sentence for a person."""

PATIENCE = {"enable": 1.5, "disable": 3.0, "quick_stop": 0.5, "reset_fault": 1.0}
"""How long an answer waits for what it is about, s."""

_STANDING = tuple(phase for phase in Phase if not phase.moves)


@dataclass(frozen=True)
class PendingRequest:
    """A request that has not been answered.

    Attributes
    ----------
    what : str
        Name of the service.
    requests : int
        How many the master had answered when it was made.
    asked : float
        When, steady s.
    reply : callable
        Takes the answer.
    """

    what: str
    requests: int
    asked: float
    reply: Callable[[Answer], None]


def answer(pending: PendingRequest, status: MasterStatus, now: float) -> Answer | None:
    """What a request has led to, or None while that is not decided."""
    found = None
    if status.requests > pending.requests:
        found = _OUTCOMES[pending.what](status, pending)
    if found is None and now - pending.asked > PATIENCE[pending.what]:
        return False, f"{status.notice or 'not taken'}; {status.phase.value}: {obstacles(status)}"
    return found


def _enabled(status: MasterStatus, pending: PendingRequest) -> Answer | None:
    if status.phase in (Phase.ENABLING, Phase.ENABLED):
        return (True, "enabled: what is commanded from now on is followed") if status.phase is Phase.ENABLED else None
    if status.stop is not None and status.stop.at_ns >= pending.asked * 1e9:
        return False, stop_text(status.stop)
    return False, _and(status.notice, obstacles(status))


def _disabled(status: MasterStatus, _pending: PendingRequest) -> Answer | None:
    return (True, _and("disabled", obstacles(status))) if status.phase in _STANDING else None


def _stopping(status: MasterStatus, _pending: PendingRequest) -> Answer | None:
    if status.phase in _STANDING:
        return True, _and(status.notice or "disabled", obstacles(status))
    return (True, "ramp to standstill; /diagnostics shows its end") if status.phase is Phase.STOPPING else None


def _reset(status: MasterStatus, _pending: PendingRequest) -> Answer | None:
    if status.phase is Phase.READY:
        return True, "no drive is in fault; call ~/enable to go on"
    return (False, status.notice) if status.phase.moves else None


_OUTCOMES = {"enable": _enabled, "disable": _disabled, "quick_stop": _stopping, "reset_fault": _reset}


def stop_text(stop: StopRecord) -> str:
    """Why the rover was stopped, in words."""
    reason = stop.reason.value
    return reason if stop.text in ("", reason) else f"{reason}: {stop.text}"


def obstacles(status: MasterStatus) -> str:
    """What is in the way of enabling, or empty."""
    if status.other_driver or status.refusal:
        return status.other_driver or status.refusal
    if not status.bus.state.carries_frames:
        return f"bus: {status.bus.reason or status.bus.state.value}"
    found = []
    for drive in status.drives:
        if drive.trouble or drive.stage is not SetupStage.RUNNING:
            found.append(f"{drive.motor} (node {drive.node}): {drive.trouble or drive.stage.value}")
    return "; ".join(found)


def _and(one: str, other: str) -> str:
    return "; ".join(filter(None, (one, other)))


# ----------------------------------------------------------------------
# The driver's services: each sets a auto_enable, and answers once it is known what came of it.
# ----------------------------------------------------------------------


class Services:
    """``~/enable``, ``~/disable``, ``~/quick_stop`` and ``~/reset_fault``.

    Parameters
    ----------
    node : rclpy Node
    request : callable
        Takes a service's name and makes the request of the master; returns how many requests the master had answered
        before, or why none can be made.
    """

    def __init__(self, node: Node, request: Callable[[str], int | str]) -> None:
        self._request, self._log = request, node.get_logger()
        self._pending: list[PendingRequest] = []
        group = ReentrantCallbackGroup()  # a call that waits for its answer keeps no other waiting
        for name in PATIENCE:
            node.create_service(Trigger, f"~/{name}", self._handler(name), callback_group=group)

    def _handler(self, name: str) -> Any:
        async def handle(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            answered: Future = Future()
            before = self._request(name)
            if isinstance(before, str):
                answered.set_result((False, before))
            else:
                self._pending.append(PendingRequest(name, before, time.monotonic(), answered.set_result))
            response.success, response.message = await answered
            self._log.info(f"~/{name}: {response.message}")
            return response

        return handle

    def answer(self, status: MasterStatus) -> None:
        """Answer the calls of which it is known now what came of them."""
        now = time.monotonic()
        for pending in list(self._pending):
            found: Answer | None = answer(pending, status, now)
            if found is not None:
                self._pending.remove(pending)
                pending.reply(found)

    def end(self, why: str) -> None:
        """Answer all calls that still wait."""
        for pending in self._pending:
            pending.reply((False, why))
        self._pending.clear()


# ----------------------------------------------------------------------
# `enable_on_start`: the drives are enabled once, at the start, and not after something has happened.
# ----------------------------------------------------------------------


START_WITHIN = 60.0
"""It holds for so long after the bus was opened, s: drives that come later ask for a person."""


class EnableDecision(NamedTuple):
    """Whether to enable the drives now, or why the wish has lapsed; mostly neither."""

    enable: bool = False
    lapsed: str = ""


class AutoEnable:
    """The wish to be enabled as soon as the drives are set up."""

    def __init__(self) -> None:
        self._until: float | None = None

    def begin(self, now: float) -> None:
        """It holds from now on (steady s)."""
        self._until = now + START_WITHIN

    def end(self) -> None:
        """Whoever commands by hand, or closes the bus, takes its place."""
        self._until = None

    def check(self, status: MasterStatus, now: float) -> EnableDecision:
        """What it comes to in this period."""
        if self._until is None:
            return EnableDecision()
        if now > self._until:
            found = EnableDecision(lapsed=f"the drives were not ready within {START_WITHIN:g} s")
        elif status.stop is not None:
            found = EnableDecision(lapsed=stop_text(status.stop))
        elif status.phase is Phase.LOCKED:
            found = EnableDecision(lapsed=status.phase.value)
        elif status.phase is Phase.READY:
            found = EnableDecision(enable=True)
        else:
            return EnableDecision()
        self._until = None
        return found
