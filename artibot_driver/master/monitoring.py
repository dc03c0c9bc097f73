"""Reasons to stop, each looked for in every cycle in which drives may have current; the first found is the stop's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from artibot_driver.bus import BusState
from artibot_driver.cia402 import DriveState
from artibot_driver.config import DriverConfig
from artibot_driver.frames import HEARTBEAT_BASE
from artibot_driver.master.link import MISMATCHES_MOST, Link
from artibot_driver.master.traffic import BusTraffic
from artibot_driver.master.values import SetupStage, StopReason, StopRecord

FAILED_MOST: Final = 3
"""Cycles in a row in which something could not be sent."""

HEARTBEATS: Final = 3.0
"""While feedback comes, heartbeats may be away for this many ``heartbeat.drive_timeout``: single ones get lost."""


def loop_trouble(now: int, last: int, config: DriverConfig) -> Iterator[StopRecord]:
    """The driver's own loop: held up for most of the time after which the drives stop by themselves."""
    late = 1e-9 * (now - last)
    if late > 2.0 / 3.0 * config.driver_timeout:
        yield StopRecord(StopReason.OVERRUN, f"the driver's loop was held up for {late:.3f} s", now)


def bus_trouble(now: int, state: BusState, traffic: BusTraffic) -> Iterator[StopRecord]:
    """What is wrong with the bus."""
    if not state.carries_frames:
        why = traffic.status().reason
        yield StopRecord(StopReason.BUS_LOST, f"{state.value}" + (f": {why}" if why else ""), now)
    if traffic.failed >= FAILED_MOST:
        text = f"frames could not be sent in {traffic.failed} cycles: {traffic.status().reason or 'no reason known'}"
        yield StopRecord(StopReason.CANNOT_SEND, text, now)
    if traffic.flooded:
        load = f"the bus is {100 * traffic.load:.0f} % full"
        yield StopRecord(StopReason.BUS_OVERLOADED, f"{load}, or says more than can be read in time", now)


def drive_trouble(now: int, link: Link, config: DriverConfig, expected: DriveState | None) -> Iterator[StopRecord]:
    """What is wrong with a drive; `expected` is the state that it was led to, None while it is on its way."""

    def found(reason: StopReason, text: str) -> StopRecord:
        return StopRecord(reason, f"drive {link.motor} (node {link.node}) {text}", now, link.motor)

    if link.restarted:
        yield found(StopReason.DRIVE_RESTARTED, link.restarted)
    if link.in_fault:
        yield found(StopReason.DRIVE_FAULT, f"is in fault: {link.fault_text()}")
    if link.alarm is not None:
        yield found(StopReason.DRIVE_FAULT, f"reports {link.alarm.text}")
    silence = link.feedback_age(now)
    if silence > config.drive_timeout:
        yield found(StopReason.DRIVE_SILENT, f"has sent no feedback for {silence:.3f} s")
    silence = link.heartbeat_age(now)
    if silence > HEARTBEATS * config.drive_timeout:
        yield found(StopReason.DRIVE_SILENT, f"has sent no heartbeat for {silence:.3f} s")
    if expected is not None and link.received.mismatches >= MISMATCHES_MOST:
        yield found(StopReason.DRIVE_STATE, link.received.mismatch)


def enable_trouble(links: Sequence[Link], now: int) -> Iterator[StopRecord]:
    """Drives that do not become enabled; their settings are doubtful then."""
    slow = [link for link in links if link.state is not DriveState.OPERATION_ENABLED]
    for link in slow:
        link.doubtful = True
    names = ", ".join(f"{link.motor} is in state '{link.state}'" for link in slow)
    yield StopRecord(StopReason.ENABLE_TIMEOUT, f"the drives are not enabled after 1 s: {names}", now)


def first(*groups: Iterator[StopRecord]) -> StopRecord | None:
    """The first of all."""
    for group in groups:
        for each in group:
            return each
    return None


def text_of(link: Link, now: int, config: DriverConfig) -> str:
    """What is wrong with a drive, one clause, where it is not asked to move; empty where nothing is."""
    if link.setup.refusal:
        return link.setup.refusal
    if link.in_fault:
        return f"in fault: {link.fault_text()}"
    if link.setup.stage is not SetupStage.RUNNING:
        return link.setup.stage.value
    if link.feedback_age(now) > config.drive_timeout:
        return "silent"
    if link.shares_id:
        return f"every answer comes twice: a second node has the id {link.node}; give one of them another"
    if is_alive(link, now, config):
        return ""
    if not link.misses_heartbeat(now, HEARTBEATS * config.drive_timeout):
        return "its first heartbeat is waited for"
    return (
        f"feedback comes, but no heartbeat (identifier {HEARTBEAT_BASE + link.node:#x}), though 1017h asks for one "
        f"every {1e3 * config.drive_period:g} ms: see the drive's manual, and what keeps this identifier from the bus"
    )


def is_alive(link: Link, now: int, config: DriverConfig) -> bool:
    """Whether feedback and heartbeats come as they should."""
    beating = link.heartbeat_age(now) <= HEARTBEATS * config.drive_timeout
    return beating and link.feedback_age(now) <= config.drive_timeout


def rest(links: Sequence[Link], now: int, config: DriverConfig) -> None:
    """Where nothing turns: what has happened is dealt with, and drives that are away are sought.

    The settings of a doubtful drive are read again, and one that has fallen silent is set up anew; not one that sends
    feedback without heartbeats, for that is something to be named.
    """
    for link in links:
        link.restarted, link.alarm = "", None
        if link.doubtful and not link.in_fault:
            link.doubtful = False
            link.setup.check()
        if (
            link.setup.stage in (SetupStage.CHECKING, SetupStage.RUNNING)
            and link.feedback_age(now) > config.drive_timeout
        ):
            link.forget()
        elif link.misses_heartbeat(now, HEARTBEATS * config.drive_timeout):
            link.doubt_once()


def retry(links: Sequence[Link]) -> None:
    """Seek drives anew that were refused: a person says that something was changed."""
    for link in links:
        if link.setup.stage is SetupStage.REFUSED:
            link.forget()


def enable_refused(links: Sequence[Link], now: int, config: DriverConfig) -> str:
    """Why drives cannot be enabled, naming the first that keeps from it."""
    for link in links:
        text = text_of(link, now, config)
        if text:
            return text if link.setup.refusal else f"drive {link.motor} (node {link.node}): {text}"
    return "it is not the time"
