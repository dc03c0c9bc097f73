"""A CANopen master that knows frames only, on a real bus: what a driver does, in as few lines as it takes."""

from __future__ import annotations

import time
from collections.abc import Callable

from canopen.objectdictionary import ODVariable

from artibot_driver.bus import Bus
from artibot_driver.cia402 import DriveState, controlword_for, state_of
from artibot_driver.frames import SDO_REQUEST, Emcy, Frame, Heartbeat, NmtCommand, NmtState, Sdo, heartbeat, nmt
from artibot_driver.pdo import Pdo
from artibot_driver.rig import Rig, Setting
from artibot_sim.model import MOTORS

SetPoints = dict[str, float]
"""Motor → rad/s of a front motor, N m of a back one."""


class FrameMaster:
    """Four drives' master, in the thread of whoever calls it.

    Attributes
    ----------
    fields : dict
        Motor → fields of its last PDOs, as integers.
    latency : list of float
        From each SYNC to the last of the PDOs that answer it, s.
    unanswered : int
        Cycles in which a PDO did not come.
    boots : list of str
        Motors whose drives have said that they boot.
    """

    def __init__(self, bus: Bus, rig: Rig) -> None:
        self.bus, self.rig = bus, rig
        self.fields: dict[str, dict[str, int]] = {motor: {} for motor in MOTORS}
        self.controlwords = dict.fromkeys(MOTORS, 0x06)
        self.latency: list[float] = []
        self.unanswered = 0
        self.emergencies: list[tuple[str, int]] = []
        self.boots: list[str] = []
        self.beating = True
        self._motor_of = {node: motor for motor, node in rig.codec.nodes.items()}
        self._sdo: list[Sdo] = []
        self._waiting: set[tuple[str, str]] = set()
        self._next = self._beat_at = 0.0

    def si(self, motor: str, name: str) -> float:
        """A measured field in SI units: ``position``, ``velocity`` or ``torque``."""
        scale = getattr(self.rig.scaling[motor], name)
        return float(scale.si(self.fields[motor][f"{name}_actual_value"]))

    def state(self, motor: str) -> DriveState | None:
        """What the drive's last statusword says."""
        word = self.fields[motor].get("statusword")
        return None if word is None else state_of(word)

    def receive(self, until: float) -> bool:
        """Take one frame, waiting for it until then (steady s)."""
        message = self.bus.receive(max(0.0, until - time.monotonic()))
        if message is None:
            return False
        found = self.rig.codec.decode_message(message)
        motor = self._motor_of.get(getattr(found, "node", 0), "")
        if isinstance(found, Pdo):
            self.fields[motor] |= dict(zip(found.map.position, found.values, strict=True))
            self._waiting.discard((motor, found.map.name))
        elif isinstance(found, Emcy):
            self.emergencies.append((motor, found.code))
        elif isinstance(found, Heartbeat) and found.state is NmtState.BOOT_UP:
            self.boots.append(motor)
        elif isinstance(found, Sdo) and not found.request:
            self._sdo.append(found)
        return True

    def access(self, motor: str, index: int, subindex: int = 0, value: int | None = None, size: int = 4) -> int:
        """Read an object (or write `value` of `size` bytes) by SDO; what was read, and the answer within 1 s."""
        self._sdo.clear()
        head = 0x40 if value is None else 0x23 | (4 - size) << 2
        data = bytes((head, index & 0xFF, index >> 8, subindex)) + ((value or 0) & 0xFFFFFFFF).to_bytes(4, "little")
        assert self.bus.send(Frame(SDO_REQUEST + self.rig.codec.nodes[motor], data))
        begun = time.monotonic()
        while not self._sdo:
            assert time.monotonic() < begun + 1.0, f"{motor} {index:04X}h: no answer"
            self.receive(begun + 1.0)
        answer = self._sdo.pop()
        assert answer.service != "abort", (motor, hex(index), subindex, answer.data[::-1].hex())
        return int.from_bytes(answer.data, "little")

    def set_up(self) -> None:
        """Write all settings of the rig, start all nodes."""
        for motor in MOTORS:
            for each in self.rig.settings(motor):
                if each.written:
                    self.access(motor, each.index, each.subindex, each.value, _size(self.rig, each))
        self.bus.send(nmt(NmtCommand.START))

    def cycle(self, given: SetPoints | None = None) -> None:
        """One period: set-points, SYNC, and what comes until the next is due."""
        period, now = 1.0 / self.rig.config.sync_rate, time.monotonic()
        self._next = max(self._next, now - period)
        if self.beating and now >= self._beat_at:
            self.bus.send(heartbeat(self.rig.config.driver_id, NmtState.OPERATIONAL))
            self._beat_at = now + self.rig.config.driver_period
        for motor, node in self.rig.codec.nodes.items():
            value, scale = (given or {}).get(motor, 0.0), self.rig.scaling[motor]
            front = motor.startswith("front")
            raw = (scale.velocity if front else scale.torque).raw(value).raw
            targets = (raw, 0) if front else (0, raw)
            self.bus.send(self.rig.codec.pdo("RPDO1", node, (self.controlwords[motor], *targets)))
        self._waiting = {(motor, name) for motor in MOTORS for name in ("TPDO1", "TPDO2")}
        begun = time.monotonic()
        self.bus.send(self.rig.codec.sync())
        self._next += period
        while time.monotonic() < self._next:
            waited = bool(self._waiting)
            if self.receive(self._next) and waited and not self._waiting:
                self.latency.append(time.monotonic() - begun)
        self.unanswered += bool(self._waiting)

    def lead_to(self, target: DriveState, given: SetPoints | None = None, *, reset_faults: bool = False) -> None:
        """Bring all drives to a state, from statuswords alone."""
        for _ in range(60):
            self.cycle(given)
            states = {motor: self.state(motor) for motor in MOTORS}
            if all(state is target for state in states.values()):
                return
            for motor, state in states.items():
                if state is not None:
                    word = controlword_for(state, target, self.controlwords[motor], reset_faults=reset_faults)
                    self.controlwords[motor] = word
        raise AssertionError(f"{states} on the way to {target}")

    def run(self, seconds: float, given: Callable[[float], SetPoints]) -> None:
        """Cycles for so long, with set-points as a function of the time since the beginning (s), whatever the delay."""
        begin = time.monotonic()
        while (now := time.monotonic() - begin) < seconds:
            self.cycle(given(now))


def _size(rig: Rig, setting: Setting) -> int:
    """Bytes of an object."""
    entry = rig.dictionary[setting.index]
    variable = entry[setting.subindex] if not isinstance(entry, ODVariable) else entry
    return len(variable) // 8
