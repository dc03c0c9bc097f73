"""The CANopen half of a simulated drive: CiA 301's network management, heartbeats, SDO, PDOs and emergencies.

It has no clock and no thread: whoever runs it hands over frames as they come and calls ``step`` often, both with
steady time in integer nanoseconds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Final

from canopen.objectdictionary import ObjectDictionary

from artibot_driver.frames import (
    HEARTBEAT_BASE,
    SDO_REQUEST,
    SDO_RESPONSE,
    Frame,
    NmtCommand,
    NmtState,
    emcy,
    heartbeat,
)
from artibot_driver.simulated.objects import INVALID_VALUE, Abort, Key, Objects, SdoServer
from artibot_sim.errors import ArtibotError

HEARTBEAT_LOST, COMMUNICATION, REFUSED_VALUE, PDO_SHORT, PDO_LONG = 0x8130, 0x8100, 0x8200, 0x8210, 0x8220
"""Error codes that a node itself reports (CiA 301)."""

GENERIC, COMMUNICATION_BIT = 0x01, 0x10
"""Bits of the error register (1001h)."""

_WARNING_PAUSE: Final = 100_000_000
"""A warning is not repeated within this time, ns: a flood of bad frames is not answered by one of emergencies."""

_NEEDED: Final = (0x1001, 0x1003, 0x1016, 0x1017, 0x1029, 0x603F)


class CanopenNode(ABC):
    """One node on a bus.

    Parameters
    ----------
    node : int
        Node id.
    dictionary : ObjectDictionary
        The EDS, read for this id.
    fixed : mapping of (index, subindex) to int
        Values that the EDS has otherwise and nobody can write.
    sync_id, emcy_base : int
        Identifiers of SYNC, and of emergencies less the node's id.
    send : callable
        Takes each frame that the node sends.

    Attributes
    ----------
    nmt : NmtState
        BOOT_UP until :meth:`power_on`.
    """

    def __init__(
        self,
        node: int,
        dictionary: ObjectDictionary,
        fixed: Mapping[Key, int],
        sync_id: int,
        emcy_base: int,
        send: Callable[[Frame], object],
    ) -> None:
        require(dictionary, _NEEDED)
        self.node = node
        self.nmt = NmtState.BOOT_UP
        self.objects = Objects(dictionary, fixed)
        self.objects.on_write(0x1016, self._watch_anew, 1)
        self.objects.on_write(0x1003, self._clear_errors)
        self._sdo = SdoServer(self.objects)
        self._tpdos = tuple(index for index in range(0x1800, 0x1A00) if index in dictionary)
        self._sync_id, self._emcy_base, self._send = sync_id, emcy_base, send
        self._now = self._last_step = 0
        self._restart()

    def _restart(self) -> None:
        self._pending: dict[int, bytes] = {}
        self._heard: int | None = None
        self.master_lost = False
        self._warned: dict[int, int] = {}
        self._syncs: dict[int, int] = {}
        self._next_heartbeat = self._now

    # What the application above has to do.

    @abstractmethod
    def _reset(self) -> None:
        """Begin anew, after power on or a reset of the node; the objects are reset already."""

    @abstractmethod
    def _refresh(self) -> None:
        """Bring the objects up to date before somebody reads them."""

    @abstractmethod
    def _connection_lost(self, code: int) -> None:
        """React to a master that no longer commands this node."""

    @abstractmethod
    def _connection_back(self) -> None:
        """Notice that heartbeats of the master, once lost, come again."""

    @abstractmethod
    def _run(self, dt: float) -> None:
        """Let `dt` seconds pass."""

    def power_on(self, now: int) -> None:
        """Start, or start again: all objects as the EDS says, boot-up message, pre-operational."""
        self._now = self._last_step = now
        self._restart()
        self.objects.reset()
        self._reset()
        self._boot()

    def _boot(self) -> None:
        self.nmt = NmtState.BOOT_UP
        self._send(heartbeat(self.node, self.nmt))
        self.nmt, self._next_heartbeat = NmtState.PRE_OPERATIONAL, self._now
        self._watch_anew(0)

    def step(self, now: int) -> None:
        """Let time pass: heartbeats, the watch on the master, the application."""
        self.watch(now)
        self.run(now)

    def watch(self, now: int) -> None:
        """Send heartbeats, and look whether the master's come; frames that have come are to be handed over before."""
        if self.nmt is not NmtState.BOOT_UP:
            self._now = max(now, self._now)
            self._watch_master()
            self._send_heartbeat()

    def run(self, now: int) -> None:
        """Let time pass for the application alone."""
        if self.nmt is not NmtState.BOOT_UP:
            self._now = max(now, self._now)
            dt, self._last_step = 1e-9 * (self._now - self._last_step), self._now
            self._run(dt)

    def receive(self, can_id: int, data: bytes, now: int) -> None:
        """Take a data frame with an 11-bit identifier, whatever it is."""
        if self.nmt is NmtState.BOOT_UP:
            return
        self._now = max(now, self._now)
        if receivers := self.objects.receivers(can_id):
            if self.nmt is NmtState.OPERATIONAL:
                for communication in receivers:
                    self._take_rpdo(communication, data)
        elif can_id == self._sync_id:
            if self.nmt is NmtState.OPERATIONAL:
                self._take_sync()
        elif can_id == 0:
            self._take_nmt(data)
        elif can_id == SDO_REQUEST + self.node and self.nmt is not NmtState.STOPPED:
            self._refresh()
            answer = self._sdo.answer(data)
            if answer is not None:
                self._send(Frame(SDO_RESPONSE + self.node, answer))
        elif can_id > HEARTBEAT_BASE and len(data) == 1 and can_id == HEARTBEAT_BASE + self._master:
            was_lost, self._heard, self.master_lost = self.master_lost, self._now, False
            if was_lost:
                self._connection_back()

    @property
    def _master(self) -> int:
        """Whose heartbeats it watches."""
        return self.objects.values[0x1016, 1] >> 16 & 0x7F

    def _take_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node):
            return
        if data[0] == NmtCommand.RESET_NODE:
            self.power_on(self._now)
        elif data[0] == NmtCommand.RESET_COMMUNICATION:
            self._leave_operational(NmtState.BOOT_UP)
            self.objects.reset(communication_only=True)
            self._boot()
        elif data[0] == NmtCommand.START:
            self.nmt = NmtState.OPERATIONAL
        elif data[0] == NmtCommand.STOP:
            self._leave_operational(NmtState.STOPPED)
        elif data[0] == NmtCommand.ENTER_PRE_OPERATIONAL:
            self._leave_operational(NmtState.PRE_OPERATIONAL)

    def _leave_operational(self, into: NmtState) -> None:
        """Without PDOs nobody commands the node any more: the same as a lost connection."""
        was, self.nmt = self.nmt, into
        self._pending.clear()
        if was is NmtState.OPERATIONAL:
            self._connection_lost(COMMUNICATION)

    def _take_rpdo(self, communication: int, data: bytes) -> None:
        """Keep a PDO for the next SYNC; of several the last."""
        found = self.objects.pdo(communication)
        assert found is not None
        size = found.packing.size
        if len(data) < size:
            self._warn(PDO_SHORT)
            return
        if len(data) > size:
            self._warn(PDO_LONG)
        self._pending[communication] = bytes(data[:size])

    def _take_sync(self) -> None:
        for communication, data in self._pending.items():
            self._apply(communication, data)
        self._pending.clear()
        self._refresh()
        values = self.objects.values
        for communication in self._tpdos:
            count = self._syncs.get(communication, 0) + 1
            due = count >= values[communication, 2]
            self._syncs[communication] = 0 if due else count
            found = self.objects.pdo(communication) if due else None
            if found is not None:
                cob_id, packing, keys = found
                self._send(Frame(cob_id, packing.pack(*map(values.__getitem__, keys))))

    def _apply(self, communication: int, data: bytes) -> None:
        found = self.objects.pdo(communication)
        if found is None or found[1].size != len(data):
            return  # mapped anew between the frame and its SYNC
        _, packing, keys = found
        for key, value in zip(keys, packing.unpack(data), strict=True):
            try:
                self.objects.assign(key, value)
            except Abort:
                self._warn(REFUSED_VALUE)

    def _send_heartbeat(self) -> None:
        period = 1_000_000 * self.objects.values[0x1017, 0]
        if period and self._now >= self._next_heartbeat:
            self._send(heartbeat(self.node, self.nmt))
            self._next_heartbeat += period
            if self._next_heartbeat <= self._now:  # late by more than a period: what was missed is not made up for
                self._next_heartbeat = self._now + period

    def _watch_anew(self, _: int) -> None:
        self._heard, self.master_lost = None, False  # CiA 301: watching begins with the first heartbeat

    def _watch_master(self) -> None:
        timeout = 1_000_000 * (self.objects.values[0x1016, 1] & 0xFFFF)
        if self._heard is None or not timeout or self._now - self._heard <= timeout:
            return
        self._heard, self.master_lost = None, True
        self._pending.clear()
        was = self.nmt
        self.nmt = (NmtState.PRE_OPERATIONAL, was, NmtState.STOPPED)[self.objects.values[0x1029, 1]]
        if was is not NmtState.OPERATIONAL and self.nmt is NmtState.PRE_OPERATIONAL:
            self.nmt = was
        self._connection_lost(HEARTBEAT_LOST)

    def _emergency(self, code: int, register: int) -> None:
        values = self.objects.values
        values[0x1001, 0] |= register
        values[0x603F, 0] = code
        for k in range(8, 1, -1):
            values[0x1003, k] = values[0x1003, k - 1]
        values[0x1003, 1], values[0x1003, 0] = code, min(8, values[0x1003, 0] + 1)
        self._send(emcy(self._emcy_base, self.node, code, values[0x1001, 0]))

    def _errors_gone(self) -> None:
        """Say that no error is left (CiA 301: error code 0)."""
        self.objects.values[0x1001, 0] = self.objects.values[0x603F, 0] = 0
        self._send(emcy(self._emcy_base, self.node, 0, 0))

    def _warn(self, code: int) -> None:
        """An emergency that changes nothing in the drive."""
        last = self._warned.get(code)
        if last is None or self._now - last >= _WARNING_PAUSE:
            self._warned[code] = self._now
            self._send(emcy(self._emcy_base, self.node, code, self.objects.values[0x1001, 0] | COMMUNICATION_BIT))

    def _clear_errors(self, count: int) -> None:
        if count:
            raise Abort(INVALID_VALUE)
        for k in range(1, 9):
            self.objects.values[0x1003, k] = 0


def require(dictionary: ObjectDictionary, indices: tuple[int, ...]) -> None:
    """Raise :class:`ArtibotError` unless the EDS has all these objects."""
    if missing := [f"{index:04X}h" for index in indices if index not in dictionary]:
        raise ArtibotError(f"eds: a simulated drive needs objects {', '.join(missing)}; use the EDS 'drive' with it")
