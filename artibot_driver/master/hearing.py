"""Every frame that comes, handed to whom it concerns; what concerns nobody is counted by kind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from artibot_driver.frames import Emcy, Heartbeat, Malformed, Nmt, Sdo, Sync, Unknown
from artibot_driver.master.link import Link
from artibot_driver.master.values import Reason, Stop
from artibot_driver.pdo import Message, Pdo
from artibot_driver.rig import Rig

SECOND_DRIVER_TIME: Final = 1_000_000_000
"""So long after somebody else's commands the bus is not taken to be ours, ns."""

LISTEN_TIME: Final = 200_000_000
"""A driver says nothing before it has heard no other for so long, ns: several periods of SYNC at any usual rate, and
longer than drives put up with a driver that has fallen silent."""

KINDS: Final = (
    "malformed", "unknown_frames", "unknown_nodes", "duplicate", "out_of_order", "missed_feedback",
    "feedback_too_early", "emergencies", "drive_restarts", "settings_lost", "sdo_repeats", "sdo_unexpected",
    "sdo_of_others", "foreign_sync", "foreign_nmt", "foreign_commands", "reads_cut_short", "not_sent", "stops",
    "setpoints_missing", "setpoints_stale", "setpoints_invalid", "saturated_velocity", "saturated_torque",
)  # fmt: skip
"""All that is counted."""


class Hearing:
    """Reads frames for the drives of a rig."""

    def __init__(self, rig: Rig, links: Sequence[Link], tally: Counter[str]) -> None:
        self._codec, self._driver = rig.codec, rig.config.driver_id
        self._links = {link.node: link for link in links}
        self._tally = tally
        self._second: tuple[int, str] | None = None
        self._other: tuple[int, str] | None = None
        self._quiet_since: int | None = None

    def take(self, message: Message, now: int, sampled: int) -> None:
        """Take a frame; feedback in it was sampled with the SYNC at `sampled`."""
        said = self._codec.decode_message(message)
        if isinstance(said, Pdo):
            if said.map.to_drive:
                self._command(f"{said.map.name} for node {said.node}", now)
            else:
                self._links[said.node].take_pdo(said, now, sampled)
        elif isinstance(said, (Heartbeat, Emcy, Sdo)):
            self._take_service(said, now)
        elif isinstance(said, (Unknown, Malformed)):
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
        """Somebody else leads drives; what was heard of it first is kept."""
        self._other = (now, self._other[1] if self._other else what)

    def trouble(self, now: int) -> Iterator[Stop]:
        """That there is a second driver on the bus."""
        if self._second is not None and now - self._second[0] < SECOND_DRIVER_TIME:
            yield Stop(Reason.SECOND_DRIVER, f"somebody else commands the drives: heard {self._second[1]}", now)

    # Before the first word.

    def begin(self) -> None:
        """Listen whether somebody else leads the drives, from the next :meth:`is_alone` on."""
        self._other = self._quiet_since = None

    def is_alone(self, now: int, carries: bool) -> bool:
        """Whether no other driver has been heard for long enough; a bus that carries nothing tells nothing."""
        if self._quiet_since is None or not carries:
            self._quiet_since = now
        elif self._other is not None:
            self._quiet_since = max(self._quiet_since, self._other[0])
        return now - self._quiet_since >= LISTEN_TIME

    @property
    def rival(self) -> str:
        """Another driver that was heard since :meth:`begin`, one clause with the mend; empty where none was."""
        return f"somebody else leads the drives: heard {self._other[1]}; end that driver" if self._other else ""
