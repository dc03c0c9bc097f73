"""Every frame that comes, handed to whom it concerns; what concerns nobody is counted by kind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from artibot_driver.frames import Emcy, Heartbeat, Malformed, Nmt, Sdo, Sync, UnknownFrame
from artibot_driver.master.link import Link
from artibot_driver.master.values import StopReason, StopRecord
from artibot_driver.pdo import FrameMessage, Pdo
from artibot_driver.rig import Rig

SECOND_DRIVER_TIME: Final = 1_000_000_000
"""So long after somebody else's commands the bus is not taken to be ours, ns."""

LISTEN_TIME: Final = 200_000_000
"""A driver sends nothing before no frames of another have come for at least so long, ns: several periods of SYNC at
any usual rate."""

LONGER_THAN_DRIVES: Final = 50_000_000
"""It also listens for so much longer than drives put up with a driver that has fallen silent, ns: whatever it finds on
the bus then, none still follows what another one has commanded."""

SPREAD: Final = 200_000_000
"""A random part of this is added to the time of listening, ns: of two drivers started together one is first."""

Delay = Callable[[], float]
"""A number from 0 to 1, anew at each call."""


def no_delay() -> float:
    """Add nothing: a run can be repeated."""
    return 0.0


KINDS: Final = (
    "malformed", "unknown_frames", "unknown_nodes", "duplicate", "out_of_order", "missed_feedback",
    "feedback_too_early", "emergencies", "drive_restarts", "settings_lost", "sdo_repeats", "sdo_unexpected",
    "sdo_of_others", "foreign_sync", "foreign_nmt", "foreign_commands", "reads_cut_short", "not_sent", "stops",
    "setpoints_missing", "setpoints_stale", "setpoints_invalid", "saturated_velocity", "saturated_torque",
    "drive_warns", "drive_at_limit",
)  # fmt: skip
"""All that is counted."""


class Receiver:
    """Reads frames for the drives of a rig.

    Parameters
    ----------
    rig : Rig
    links : sequence of Link
        Of its drives.
    tally : Counter
        Gets what is counted.
    delay : Delay
        How much of :data:`SPREAD` it listens longer.

    Attributes
    ----------
    alone : bool
        Whether no other driver has sent for long enough.
    leads : bool
        Whether its first SYNC since then has gone out, and no other driver has answered it.
    """

    def __init__(self, rig: Rig, links: Sequence[Link], tally: Counter[str], delay: Delay = no_delay) -> None:
        self._codec, self._driver = rig.codec, rig.config.driver_id
        self._links = {link.node: link for link in links}
        self._tally = tally
        self._second: tuple[int, str] | None = None
        self._least = max(LISTEN_TIME, round(1e9 * rig.config.driver_timeout) + LONGER_THAN_DRIVES)
        self._delay = delay
        self.alone = self.leads = self._led = False
        self._other: tuple[int, str] | None
        self._quiet_since: int | None
        self.begin()

    def take(self, message: FrameMessage, now: int, sampled: int) -> None:
        """Take a frame; feedback in it was sampled with the SYNC at `sampled`."""
        said = self._codec.decode_message(message)
        if isinstance(said, Pdo):
            if said.map.to_drive:
                self._command(f"{said.map.name} for node {said.node}", now)
            else:
                self._links[said.node].take_pdo(said, now, sampled)
        elif isinstance(said, (Heartbeat, Emcy, Sdo)):
            self._take_service(said, now)
        elif isinstance(said, (UnknownFrame, Malformed)):
            self._tally["malformed" if isinstance(said, Malformed) else "unknown_frames"] += 1
        elif isinstance(said, Sync):
            self._tally["foreign_sync"] += 1
            self._note_other("SYNC", now)
        elif isinstance(said, Nmt):
            self._tally["foreign_nmt"] += 1

    def _take_service(self, said: Heartbeat | Emcy | Sdo, now: int) -> None:
        link = self._links.get(said.node)
        if isinstance(said, Heartbeat) and said.node == self._driver:
            self._command(f"a heartbeat of node {self._driver}, which is this driver's", now)
        elif link is None:
            self._tally["unknown_nodes"] += 1
        elif isinstance(said, Heartbeat):
            link.take_heartbeat(said, now)
        elif isinstance(said, Emcy):
            link.take_emcy(said)
        elif said.request:
            self._tally["sdo_of_others"] += 1
        else:
            link.take_sdo(said)

    def _command(self, what: str, now: int) -> None:
        """Somebody else commands our drives."""
        self._tally["foreign_commands"] += 1
        self._second = (now, what)
        self._note_other(what, now)

    def _note_other(self, what: str, now: int) -> None:
        """Somebody else leads drives; its first frame is kept."""
        self._other = (now, self._other[1] if self._other else what)
        self.leads = self.leads and self._led

    def trouble(self, now: int) -> Iterator[StopRecord]:
        """That there is a second driver on the bus."""
        if self._second is not None and now - self._second[0] < SECOND_DRIVER_TIME:
            yield StopRecord(
                StopReason.SECOND_DRIVER, f"somebody else commands the drives: heard {self._second[1]}", now
            )

    # Before the first word, and the first after a silence.

    def begin(self) -> None:
        """Listen whether somebody else leads the drives, which are to be set up anew."""
        self.alone = self.leads = self._led = False
        self._sent_at = 0
        self._other = self._quiet_since = None
        self._patience = self._least + round(self._delay() * SPREAD)
        for link in self._links.values():
            link.forget()

    def listen(self, now: int, carries: bool, led: bool) -> None:
        """Be alone once no other driver has sent for long enough; a bus that carries nothing proves nothing.

        Two that were started together may both have found the bus quiet, so whoever receives frames of another before
        it has `led` all drives listens again. After that they are its own: its silence would be taken for its death.
        """
        self._led = self._led or led
        if self.alone:
            other = self._other
            if other is not None and not self._led:
                self.begin()
                self._other = other
        elif self._quiet_since is None or not carries:
            self._quiet_since = now
        else:
            self._quiet_since = max(self._quiet_since, self._other[0] if self._other else 0)
            if now - self._quiet_since >= self._patience:
                self.alone, self._other, self._second = True, None, None
                self._sent_at = now

    def note_sent(self, now: int, taken: bool) -> None:
        """A cycle has sent its frames; `taken` where the bus has taken some of them."""
        if taken:
            self.leads, self._sent_at = True, now

    def resume(self, now: int) -> None:
        """Listen again after a silence of one's own, before anything that came in it is read.

        Whatever the reason (a bus that is down or takes no frames, a loop that was held up): after so long no drive
        follows any more, and another driver may have begun to lead them. Before that nobody else has begun.
        """
        if self.alone and now - self._sent_at >= self._least:
            self.begin()

    @property
    def other_driver(self) -> str:
        """Another driver whose frames came while listening, one clause with the mend; empty where none was."""
        if self.alone or self._other is None:
            return ""
        return f"somebody else leads the drives: heard {self._other[1]}; end that driver"
