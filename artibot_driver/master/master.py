"""The master: one cycle in every SYNC period, from one thread, without waiting for anything.

A cycle reads what has come, decides in which phase the drives are, and sends set-points, SYNC and the driver's own
heartbeat, so that a loop that hangs is noticed by the drives. Requests may come from any thread; the next cycle takes
them.
"""

from __future__ import annotations

import enum
import math
import threading
import time
from collections import Counter
from collections.abc import Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

from artibot_driver.bus import BusState
from artibot_driver.cia402 import DriveState
from artibot_driver.config import DriverConfig
from artibot_driver.frames import NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.master import monitoring, setup
from artibot_driver.master.link import POWERED, TORQUE, VELOCITY, Link
from artibot_driver.master.phases import Facts, Phase, next_phase
from artibot_driver.master.reception import KINDS, Delay, Receiver, no_delay
from artibot_driver.master.setpoints import STANDING, Integers, Targets
from artibot_driver.master.traffic import AnyBus, BusTraffic, Clock
from artibot_driver.master.values import (
    Commanded,
    DriveStatus,
    Feedback,
    Four,
    MasterCycle,
    MasterStatus,
    Setpoints,
    SetupStage,
    StopReason,
    StopRecord,
)
from artibot_driver.rig import Rig
from artibot_sim.model import MOTORS

# ----------------------------------------------------------------------
# Requests to the master: asked that any thread may set, taken by the next cycle and then gone.
# ----------------------------------------------------------------------


class Request(enum.Enum):
    """What can be asked for."""

    ENABLE = "enable"
    STOP = "stop"
    RESET = "reset faults"


class PendingRequests(NamedTuple):
    """What was asked for since the last cycle; `stop` is the first of the reasons, with the cycle's time."""

    enable: bool
    reset: bool
    stop: StopRecord | None
    number: int


class Requests:
    """AskedFor that wait for the next cycle."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[tuple[Request, StopReason, str]] = []

    def ask(self, request: Request, reason: StopReason = StopReason.DISABLE, text: str = "") -> None:
        """Set a wish; the reason counts for a stop only."""
        with self._lock:
            self._waiting.append((request, reason, text))

    def take(self, now: int) -> PendingRequests:
        """All asked, which are gone then."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
        kinds = {request for request, _, _ in waiting}
        stops = [StopRecord(reason, text, now) for request, reason, text in waiting if request is Request.STOP]
        return PendingRequests(
            Request.ENABLE in kinds, Request.RESET in kinds, stops[0] if stops else None, len(waiting)
        )


# ----------------------------------------------------------------------
# What a cycle gives: feedback and status from what the drives have said.
# ----------------------------------------------------------------------


def feedback(links: Sequence[Link], now: int, config: DriverConfig) -> Feedback:
    """What the drives have reported; NaN for those that are silent or not set up."""
    known = [
        each.setup.stage is SetupStage.RUNNING and each.feedback_age(now) <= config.drive_timeout for each in links
    ]

    def four(values: Sequence[float]) -> Four:
        one, two, three, four = (value if there else math.nan for value, there in zip(values, known, strict=True))
        return one, two, three, four

    one, two, three, last = (
        each.received.sampled_ns if there else None for each, there in zip(links, known, strict=True)
    )
    return Feedback(
        four([each.position(now, config.drive_timeout) for each in links]),
        four([each.quantity(VELOCITY) for each in links]),
        four([each.quantity(TORQUE) for each in links]),
        (one, two, three, last),
    )


def drives(links: Sequence[Link], now: int, config: DriverConfig) -> tuple[DriveStatus, ...]:
    """All about each drive, for a person."""
    return tuple(link.status(now, monitoring.text_of(link, now, config)) for link in links)


def refusal(links: Sequence[Link]) -> str:
    """What keeps a drive from being set up for good; empty where nothing does."""
    return next((link.setup.refusal for link in links if link.setup.refusal), "")


# ----------------------------------------------------------------------
# The master: one cycle in every SYNC period, from one thread, without waiting for anything.
# ----------------------------------------------------------------------


ENABLE_TIMEOUT: Final = 1_000_000_000
"""Drives that are not enabled after this long are given up, ns."""

HOLD_TIME: Final = 50_000_000
"""At a ramp's end the front motors are held at standstill for so long, should they lag behind, ns."""

RELEASE_TIMEOUT: Final = 200_000_000
"""Drives are waited for to be without current for so long after a ramp, ns."""

RESET_TIME: Final = 1_000_000_000
"""A fault reset is tried for so long, ns."""

HEALTH_PERIOD: Final = 50_000_000
"""Between two questions after the bus's state, ns; where sending fails it is asked for at once."""


class Master:
    """Leads the four drives of a rig.

    Parameters
    ----------
    bus : AnyBus
        Open; the caller closes it, after :meth:`close`.
    rig : Rig
    clock : Clock
        To bound the time that reading takes.
    delay : Delay
        So that of two drivers started together one is first on the bus.
    """

    def __init__(self, bus: AnyBus, rig: Rig, clock: Clock = time.monotonic_ns, delay: Delay = no_delay) -> None:
        self._rig, self._config, self._clock = rig, rig.config, clock
        self._period = 1000 * rig.config.sync_period_us
        self._tally: Counter[str] = Counter(dict.fromkeys(KINDS, 0))
        self._links = tuple(Link(rig, motor, self._tally) for motor in MOTORS)
        self._receiver = Receiver(rig, self._links, self._tally, delay)
        self._targets = Targets(rig, self._tally)
        self._requests, self._answered, self._notice = Requests(), 0, ""
        self._phase, self._bus_state = Phase.OFFLINE, BusState.ACTIVE
        self._stop: StopRecord | None = None
        self._armed: int | None = None
        self._following = False
        self._since = self._reset_until = self._beat_due = self._sync = self._polls = 0
        self._rested: int | None = None
        self._released: int | None = None
        self._last: int | None = None
        self.use_bus(bus)

    # Requests, from any thread.

    def enable(self) -> None:
        """Ask for the drives to be enabled; refused, with :attr:`MasterStatus.notice`, unless they are READY."""
        self._requests.ask(Request.ENABLE)

    def disable(self) -> None:
        """Ask for a ramp to standstill, then no current."""
        self.stop(StopReason.DISABLE)

    def quick_stop(self) -> None:
        """Ask for the same as :meth:`disable`, under another name: the ramp is at ``stop_deceleration`` either way."""
        self.stop(StopReason.QUICK_STOP)

    def stop(self, reason: StopReason, text: str = "") -> None:
        """Ask for a ramp to standstill for a reason of the caller's."""
        self._requests.ask(Request.STOP, reason, text or reason.value)

    def reset_fault(self) -> None:
        """Ask for faults to be reset, and for refused drives to be tried again, where nothing turns."""
        self._requests.ask(Request.RESET)

    # The loop's thread.

    def use_bus(self, bus: AnyBus) -> None:
        """Go on with another bus where the old one is lost: listen first, then set all drives up again."""
        self._traffic = BusTraffic(bus, self._config.bitrate, self._period, self._tally, self._clock)
        self._receiver.begin()

    def poll(self, now_ns: int) -> None:
        """Read what has come and go on with setting up, without set-points and SYNC."""
        self._receiver.resume(now_ns)
        for message in self._traffic.read():
            self._receiver.take(message, now_ns, self._sync)
        if self._receiver.leads:
            self._polls, setups = self._polls + 1, [link.setup for link in self._links]
            self._traffic.send(setup.due(setups, now_ns, self._rig.requests_a_cycle, self._polls))

    def cycle(self, now_ns: int, setpoints: Setpoints | None) -> MasterCycle:
        """One SYNC period.

        Parameters
        ----------
        now_ns : int
            Steady time.
        setpoints : Setpoints or None
            What the rover is to do; None where nobody rules.
        """
        last, self._last = now_ns if self._last is None else self._last, now_ns
        self.poll(now_ns)
        self._bus_state = self._traffic.check_state(now_ns, HEALTH_PERIOD)
        self._receiver.listen(now_ns, self._bus_state.carries_frames, self._phase in (Phase.READY, Phase.LOCKED))
        asked = self._requests.take(now_ns)
        if self._phase in (Phase.ENABLING, Phase.ENABLED):
            self._stop = self._trouble(now_ns, last, asked.stop) or self._take_setpoints(now_ns, setpoints)
        elif not self._phase.moves:
            monitoring.rest(self._links, now_ns, self._config)
        self._change_phase(now_ns, self._answer(now_ns, asked))
        sent = self._move(now_ns, 1e-9 * min(now_ns - last, 2 * self._period))  # no leap down after a hold-up
        self._send(now_ns, sent)
        commanded = self._targets.commanded(sent, now_ns) if self._phase.moves else Commanded(stamp_ns=now_ns)
        return MasterCycle(feedback(self._links, now_ns, self._config), commanded, self._status(now_ns))

    def close(self, now_ns: int) -> None:
        """Take the drives' current away; they are left pre-operational, without a watch on the driver's heartbeat."""
        frames = [frame for link in self._links for frame in link.frames(DriveState.SWITCH_ON_DISABLED, 0, 0, False)]
        frames.append(self._rig.codec.sync())
        frames += [nmt(NmtCommand.RESET_COMMUNICATION, link.node) for link in self._links]
        if self._receiver.leads:  # one that only listened leaves the drives to whoever leads them
            self._traffic.send(frames)
        self._phase, self._armed, self._following = Phase.CONFIGURING, None, False
        for link in self._links:
            link.forget()

    # Parts of a cycle.

    def _trouble(self, now: int, last: int, asked: StopRecord | None) -> StopRecord | None:
        """The first reason to stop."""
        expected = DriveState.OPERATION_ENABLED if self._phase is Phase.ENABLED else None
        stop = asked or monitoring.first(
            monitoring.loop_trouble(now, last, self._config),
            monitoring.bus_trouble(now, self._bus_state, self._traffic),
            self._receiver.trouble(now),
            *(monitoring.drive_trouble(now, link, self._config, expected) for link in self._links),
        )
        if stop is None and self._phase is Phase.ENABLING and now - self._since > ENABLE_TIMEOUT:
            stop = monitoring.first(monitoring.enable_trouble(self._links, now))
        return stop

    def _take_setpoints(self, now: int, given: Setpoints | None) -> StopRecord | None:
        """Follow set-points that are fresh and sound; else say why the rover has to stop, if it has to."""
        if self._phase is not Phase.ENABLED:
            return None
        text = "" if given is None else self._targets.fault_of(given)
        if given is not None and not text and (self._armed is None or given.stamp_ns <= self._armed):
            self._tally["setpoints_stale"] += 1
            given = None
        if given is None or text:
            self._tally["setpoints_invalid" if text else "setpoints_missing"] += 1
            under_way, self._following = self._following and not self._targets.at_rest, False
            if text:
                return StopRecord(StopReason.INVALID_COMMAND, text, now)
            return StopRecord(StopReason.COMMAND_SILENCE, StopReason.COMMAND_SILENCE.value, now) if under_way else None
        self._following = True
        self._targets.follow(given)
        return None

    def _answer(self, now: int, asked: PendingRequests) -> bool:
        """Say what becomes of the requests; whether the drives are to be enabled."""
        refused = ""
        self._answered += asked.number
        if asked.reset:
            self._notice = self._reset(now)
        if asked.enable:
            refused = "a stop was asked for as well" if asked.stop else self._enable_refused(now)
            self._notice = f"enable refused: {refused}" if refused else "the drives are being enabled"
        if asked.stop:
            self._notice = f"stop: {asked.stop.text}"
        return asked.enable and not refused

    def _reset(self, now: int) -> str:
        """Begin to reset faults, but none that is still to come while the rover moves; what became of it."""
        if self._phase.moves:
            return f"reset refused: the drives are {self._phase.name.lower()}"
        self._reset_until = now + RESET_TIME
        monitoring.retry(self._links)
        return "faults are being reset"

    def _enable_refused(self, now: int) -> str:
        """Why the drives cannot be enabled now; empty where they can."""
        if self._phase.moves:
            return f"they are {self._phase.name.lower()}"
        if not self._receiver.alone:
            return self._receiver.other_driver or Phase.LISTENING.value
        trouble = monitoring.first(
            monitoring.bus_trouble(now, self._bus_state, self._traffic), self._receiver.trouble(now)
        )
        if trouble is not None:
            return trouble.text
        ready = self._phase is Phase.READY and next_phase(Phase.READY, self._facts(now, True)) is Phase.ENABLING
        return "" if ready else monitoring.enable_refused(self._links, now, self._config)

    def _facts(self, now: int, enable: bool) -> Facts:
        running = [link for link in self._links if link.setup.stage is SetupStage.RUNNING]
        alive = [link for link in running if monitoring.is_alive(link, now, self._config)]
        off = not any(link.state in POWERED for link in alive)
        since = None if self._released is None else now - self._released
        return Facts(
            carries=self._bus_state.carries_frames,
            alone=self._receiver.leads,
            complete=len(alive) == len(self._links) and not any(link.shares_id for link in alive),
            faulted=any(link.in_fault for link in running),
            enable=enable,
            incident=self._stop is not None,
            all_enabled=all(link.state is DriveState.OPERATION_ENABLED for link in self._links),
            stopped=since is not None and since > 0 and (off or since > RELEASE_TIMEOUT),
        )

    def _change_phase(self, now: int, enable: bool) -> None:
        was, self._phase = self._phase, next_phase(self._phase, self._facts(now, enable))
        if self._phase is was:
            return
        self._since, self._rested, self._released = now, None, None
        if self._phase is Phase.ENABLING:
            self._stop, self._armed, self._reset_until = None, now, now
            self._targets.begin((self._links[0].quantity(VELOCITY), self._links[1].quantity(VELOCITY)))
        elif self._phase is not Phase.ENABLED:
            self._tally["stops"] += self._phase is Phase.STOPPING
            self._armed, self._following = None, False

    def _move(self, now: int, dt: float) -> Integers:
        """Set-points of this cycle; where none are followed, the ramp to standstill."""
        if not self._phase.moves:
            return STANDING
        if not self._following:
            self._targets.ramp_down(dt)
        if self._phase is Phase.STOPPING and self._released is None and self._targets.at_rest:
            self._rested = now if self._rested is None else self._rested
            slow = all(self._targets.is_slow(link.quantity(VELOCITY)) for link in self._links[:2])
            self._released = now if slow or now - self._rested >= HOLD_TIME else None
        if self._phase is Phase.ENABLING or self._released is not None:
            return Integers(self._targets.integers((0, 0)).velocity, (0, 0))
        right, left = (
            link.received.objects.get(TORQUE, 0) if link.feedback_age(now) <= self._config.drive_timeout else 0
            for link in self._links[:2]
        )
        return self._targets.integers((right, left))

    def _aim(self, link: Link) -> DriveState:
        """The state that a drive is to be in; a stop enables none that is not: the ramp is for those that are."""
        powered = self._phase.moves and self._released is None
        if self._phase is Phase.STOPPING:
            powered = powered and link.state is DriveState.OPERATION_ENABLED
        return DriveState.OPERATION_ENABLED if powered else DriveState.SWITCH_ON_DISABLED

    def _send(self, now: int, sent: Integers) -> None:
        if not self._receiver.leads:  # its first word moves nothing, and stops no other driver
            self._receiver.note_sent(now, self._traffic.send([self._rig.codec.sync()] * self._receiver.alone))
            return
        reset = not self._phase.moves and now < self._reset_until
        targets = ((sent.velocity[0], 0), (sent.velocity[1], 0), (0, sent.torque[0]), (0, sent.torque[1]))
        frames = []
        for link, (velocity, torque) in zip(self._links, targets, strict=True):
            target, enabled = self._aim(link), self._phase is Phase.ENABLED
            frames += link.frames(target, velocity, torque, reset, hold=enabled)
            link.end_period(target if enabled else None)
        frames.append(self._rig.codec.sync())
        if now >= self._beat_due:
            frames.append(heartbeat(self._config.driver_id, NmtState.OPERATIONAL))
            self._beat_due = now + round(1e9 * self._config.driver_period) - self._period // 2
        self._receiver.note_sent(now, self._traffic.send(frames))
        self._sync = now

    def _status(self, now: int) -> MasterStatus:
        return MasterStatus(
            phase=self._phase,
            stop=self._stop,
            armed_ns=self._armed,
            following=self._following,
            refusal=refusal(self._links),
            notice=self._notice,
            requests=self._answered,
            drives=drives(self._links, now, self._config),
            bus=self._traffic.status(),
            counters=MappingProxyType(dict(self._tally)),
            other_driver=self._receiver.other_driver,
        )
