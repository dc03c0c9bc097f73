"""Answers of the driver's services: what came of a request, found by looking at the master's status once a cycle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from artibot_driver.master import Phase, Stage, Status, Stop

Answer = tuple[bool, str]
"""Success, and one sentence for a person."""

PATIENCE = {"enable": 1.5, "disable": 3.0, "quick_stop": 0.5, "reset_fault": 1.0}
"""How long an answer waits for what it is about, s."""

_STANDING = tuple(phase for phase in Phase if not phase.moves)


@dataclass(frozen=True)
class Pending:
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


def answer(pending: Pending, status: Status, now: float) -> Answer | None:
    """What a request has led to, or None while that is not decided."""
    found = None
    if status.requests > pending.requests:
        found = _OUTCOMES[pending.what](status, pending)
    if found is None and now - pending.asked > PATIENCE[pending.what]:
        return False, f"{status.notice or 'not taken'}; {status.phase.value}: {obstacles(status)}"
    return found


def _enabled(status: Status, pending: Pending) -> Answer | None:
    if status.phase in (Phase.ENABLING, Phase.ENABLED):
        return (True, "enabled: what is commanded from now on is followed") if status.phase is Phase.ENABLED else None
    if status.stop is not None and status.stop.at_ns >= pending.asked * 1e9:
        return False, stop_text(status.stop)
    return False, _and(status.notice, obstacles(status))


def _disabled(status: Status, _pending: Pending) -> Answer | None:
    return (True, _and("disabled", obstacles(status))) if status.phase in _STANDING else None


def _stopping(status: Status, _pending: Pending) -> Answer | None:
    if status.phase in _STANDING:
        return True, _and(status.notice or "disabled", obstacles(status))
    return (True, "ramp to standstill; /diagnostics shows its end") if status.phase is Phase.STOPPING else None


def _reset(status: Status, _pending: Pending) -> Answer | None:
    if status.phase is Phase.READY:
        return True, "no drive is in fault; call ~/enable to go on"
    return (False, status.notice) if status.phase.moves else None


_OUTCOMES = {"enable": _enabled, "disable": _disabled, "quick_stop": _stopping, "reset_fault": _reset}


def stop_text(stop: Stop) -> str:
    """Why the rover was stopped, in words."""
    reason = stop.reason.value
    return reason if stop.text in ("", reason) else f"{reason}: {stop.text}"


def obstacles(status: Status) -> str:
    """What is in the way of enabling, or empty."""
    if status.other_driver or status.refusal:
        return status.other_driver or status.refusal
    if not status.bus.state.carries_frames:
        return f"bus: {status.bus.reason or status.bus.state.value}"
    found = []
    for drive in status.drives:
        if drive.trouble or drive.stage is not Stage.RUNNING:
            found.append(f"{drive.motor} (node {drive.node}): {drive.trouble or drive.stage.value}")
    return "; ".join(found)


def _and(one: str, other: str) -> str:
    return "; ".join(filter(None, (one, other)))
