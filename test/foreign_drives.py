"""Drives that are not artibot's: canopen's own nodes (SDO server, NMT, heartbeat) with a CiA 402 state machine on top.

Each test says in what a drive differs from artibot's own: the text of its EDS, objects that cannot be written, values
that it rounds, heartbeats that it does not send.
"""

from __future__ import annotations

import contextlib
import itertools
import random
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import canopen
from canopen.objectdictionary import ODVariable, import_od

from artibot_driver.bus import open_bus
from artibot_driver.cia402 import DriveEvent, DriveState, command_of, statusword, transition
from artibot_driver.config import config_from_parameters
from artibot_driver.master import Master, MasterCycle, Phase, Setpoints
from artibot_driver.rig import Rig, load_rig
from artibot_sim.resources import config_path


def eds_with(folder: Path, *changes: tuple[str, str], added: str = "") -> str:
    """The shipped EDS with texts changed, each of which has to be there, and a text added."""
    text = config_path("eds", "drive").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "foreign.eds"
    path.write_text(text + added, encoding="utf-8")
    return str(path)


_NUMBER = itertools.count()


class ForeignDrive:
    """One of canopen's local nodes, made a CiA 402 drive.

    Parameters
    ----------
    network : canopen.Network
    rig : Rig
        What is commissioned (rated torque, encoder …) is taken from it.
    motor, eds : str
    fixed : tuple of int
        Objects that are read only.
    rounds : mapping of int to callable
        Object → what it holds of a value that is written.
    bits : int
        Further bits of its statusword.
    beats : bool
        Whether it sends heartbeats.
    mode : int, optional
        What it shows as its mode of operation, whatever it was set to.
    """

    def __init__(
        self,
        network: canopen.Network,
        rig: Rig,
        motor: str,
        eds: str,
        fixed: tuple[int, ...] = (),
        rounds: Mapping[int, Callable[[int], int]] | None = None,
        bits: int = 0,
        beats: bool = True,
        mode: int | None = None,
    ) -> None:
        self._mode = mode
        self.id, self.bits, self.state, self.controlword = (
            rig.codec.nodes[motor],
            bits,
            DriveState.SWITCH_ON_DISABLED,
            0,
        )
        self.written: list[tuple[int, int]] = []
        self._rounds = rounds or {}
        with open(eds, encoding="utf-8") as stream:
            dictionary = import_od(stream, self.id)
        for index in fixed:
            entry = dictionary[index]
            for part in [entry] if isinstance(entry, ODVariable) else entry.values():
                part.access_type = "ro"
        self.node = canopen.LocalNode(self.id, dictionary)
        for each in rig.settings(motor):
            if not each.written and each.index != 0x1018:
                self.node.set_data(
                    each.index, each.subindex, each.value.to_bytes(self._size(each.index, each.subindex), "little")
                )
        self.node.add_write_callback(lambda index, subindex, od, data: self.written.append((index, subindex)))
        self.node.add_read_callback(self._rounded)
        if not beats:
            self.node.nmt.start_heartbeat = lambda *_: None  # type: ignore[method-assign]
        network.add_node(self.node)
        self._network = network
        self.node.nmt.state = "PRE-OPERATIONAL"
        network.subscribe(0x80, self._sync)
        network.subscribe(self._object(0x1400, 1) & 0x7FF, self._command)

    def _size(self, index: int, subindex: int) -> int:
        entry = self.node.object_dictionary[index]
        return len(entry if isinstance(entry, ODVariable) else entry[subindex]) // 8

    def _rounded(self, index: int, subindex: int, od: ODVariable) -> int | None:
        if index not in self._rounds:
            return None
        stored = self.node.data_store.get(index, {}).get(subindex)
        return self._rounds[index](int.from_bytes(stored, "little") if stored else od.default or 0)

    def _object(self, index: int, subindex: int = 0) -> int:
        return int.from_bytes(self.node.get_data(index, subindex), "little")

    def _command(self, _id: int, data: bytearray, _stamp: float) -> None:
        before, self.controlword = self.controlword, int.from_bytes(data[:2], "little")
        command = command_of(self.controlword, before)
        while (found := transition(self.state, command)) is not None:
            self.state = found.end
        if self.state is DriveState.QUICK_STOP_ACTIVE:
            self.state = transition(self.state, DriveEvent.QUICK_STOP_DONE).end  # type: ignore[union-attr]

    def _sync(self, _id: int, _data: bytearray, _stamp: float) -> None:
        if self.node.nmt.state != "OPERATIONAL":
            return
        for communication in (0x1800, 0x1801):
            cob_id = self._object(communication, 1)
            if cob_id >> 31:
                continue
            data = b""
            for k in range(1, self._object(communication + 0x200) + 1):
                word = self._object(communication + 0x200, k)
                data += self._value(word >> 16).to_bytes((word & 0xFF) // 8, "little")
            self._network.send_message(cob_id & 0x7FF, data)

    def _value(self, index: int) -> int:
        if index == 0x6041:
            return statusword(self.state, self.bits)
        shown = self._object(0x6060) if self._mode is None else self._mode
        return shown if index == 0x6061 else 0


class Foreign:
    """A master in real time, and four foreign drives on python-can's bus inside one process."""

    def __init__(self, master: Master, rig: Rig, drives: dict[str, ForeignDrive]) -> None:
        self.master, self.rig, self.drives = master, rig, drives
        self.cycle: MasterCycle | None = None
        self.phases: list[Phase] = []

    def run(self, seconds: float, until: Callable[[MasterCycle], bool] = lambda cycle: False) -> bool:
        """Periods for so long, or until something is so."""
        end = time.monotonic() + seconds
        due = time.monotonic_ns()
        while time.monotonic() < end:
            self.cycle = self.master.cycle(time.monotonic_ns(), Setpoints((0.0, 0.0), time.monotonic_ns()))
            phase = self.cycle.status.phase
            if not self.phases or self.phases[-1] is not phase:
                self.phases.append(phase)
            if until(self.cycle):
                return True
            due += 1000 * self.rig.config.sync_period_us
            time.sleep(max(0.0, 1e-9 * (due - time.monotonic_ns())))
        return False

    def is_ready(self, seconds: float = 30.0) -> bool:
        """Whether all drives are set up within that time; one that is refused ends the waiting."""
        self.run(seconds, lambda cycle: cycle.status.phase is Phase.READY or bool(cycle.status.refusal))
        return self.status.phase is Phase.READY

    @property
    def status(self):  # type: ignore[no-untyped-def]
        """The master's last."""
        assert self.cycle is not None
        return self.cycle.status


@contextlib.contextmanager
def foreign_drives(eds: str, drive_eds: str = "", **others: object) -> Iterator[Foreign]:
    """Four of them and a master that was given `eds`; theirs is `drive_eds`, by default the same."""
    channel = f"foreign-{next(_NUMBER)}"
    with contextlib.ExitStack() as stack:
        given = {"eds": eds, "bus.interface": "virtual", "bus.channel": channel, "sync_rate": 50.0}
        rig = load_rig(config_from_parameters(given))
        network = canopen.Network()
        network.connect(interface="virtual", channel=channel)
        stack.callback(network.disconnect)
        drives = {m: ForeignDrive(network, rig, m, drive_eds or eds, **others) for m in rig.codec.nodes}  # type: ignore[arg-type]
        bus = stack.enter_context(open_bus("virtual", channel))
        yield Foreign(Master(bus, rig, delay=random.Random(1).random), rig, drives)
