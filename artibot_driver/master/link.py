"""One drive as the master knows it: what it has said last, how long ago, and the frames that command it."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from artibot_driver.cia402 import DriveState, controlword_for, state_of
from artibot_driver.frames import Emcy, Frame, Heartbeat, NmtState, Sdo, error_text
from artibot_driver.master.setup import DriveSetup
from artibot_driver.master.values import INTERNAL_LIMIT, WARNING, DriveStatus, SetupStage
from artibot_driver.pdo import Pdo
from artibot_driver.rig import Rig
from artibot_driver.scaling import unwrap

CONTROLWORD, TARGET_VELOCITY, TARGET_TORQUE = 0x6040, 0x60FF, 0x6071
STATUSWORD, VELOCITY, TORQUE, POSITION, MODE, ERROR_CODE = 0x6041, 0x606C, 0x6077, 0x6064, 0x6061, 0x603F

IN_FAULT: Final = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
POWERED: Final = (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE)

MISMATCHES_MOST: Final = 3
"""Statuswords in a row that report another state than the one a drive was led to: fewer may be frames out of order."""

TWICE_MOST: Final = 10
"""Periods in which a PDO came twice, less those in which none did: more than that is no accident of a late reading."""

_STARTED: Final = (SetupStage.STARTING, SetupStage.CHECKING, SetupStage.RUNNING)


def is_warning(code: int) -> bool:
    """Whether an emergency code reports something that the drive goes on after.

    Those are protocol errors (82xxh: a frame was cut or refused), an overrun, error passive, a recovery from bus-off
    and the I²t warning.
    """
    return code >> 8 == 0x82 or code in (0x8110, 0x8120, 0x8140, 0x2351)


@dataclass
class Received:
    """What a drive has sent last; times are steady ns, None where it has sent none since it was sought.

    Attributes
    ----------
    mismatches : int
        Periods in a row in which it was not as it was led to be.
    mismatch : str
        How it was instead in the last of them.
    """

    operational_ns: int | None = None
    heartbeat_ns: int | None = None
    nmt: NmtState | None = None
    feedback_ns: int | None = None
    sampled_ns: int | None = None
    position_ns: int | None = None
    objects: dict[int, int] = field(default_factory=dict)
    emergency: Emcy | None = None
    mismatches: int = 0
    mismatch: str = ""


class Link:
    """One drive.

    Attributes
    ----------
    received : Received
    setup : DriveSetup
    state : DriveState or None
        Of CiA 402, as it reported it last.
    restarted : str
        How it was noticed that the drive left operational by itself, until the master has dealt with it.
    alarm : Emcy or None
        A severe emergency that the master has not dealt with yet.
    doubtful : bool
        Whether it has left its state by itself: it may have restarted, and its settings are to be read again.
    shares_id : bool
        Whether a second node answers under its id.
    """

    def __init__(self, rig: Rig, motor: str, tally: Counter[str]) -> None:
        self.motor, self.node, self._tally = motor, rig.codec.nodes[motor], tally
        self.scaling = rig.scaling[motor]
        self.setup = DriveSetup(rig, motor, tally)
        self.received = Received()
        self.state: DriveState | None = None
        self.restarted = ""
        self.alarm: Emcy | None = None
        self.doubtful = self.shares_id = False
        self._twice = 0
        self._came_twice = self._missed_beat = False
        self._mode = int(rig.config.mode(motor))
        self._rpdos = tuple(
            (each.id_of(self.node), each.packing, each.objects) for each in rig.codec.maps.values() if each.to_drive
        )
        self._controlword = 0
        self._total: int | None = None
        self._origin = 0
        self._anew = True
        self._in_period: list[str] = []

    # What it sends.

    def take_pdo(self, pdo: Pdo, now: int, sampled: int) -> None:
        """A TPDO that was sampled with the SYNC at `sampled`."""
        name = pdo.map.name
        if self.setup.stage not in _STARTED:
            self._tally["feedback_too_early"] += 1  # of a drive that is not set up: its mapping may be another
            return
        if name in self._in_period:
            self._tally["duplicate"] += 1
            self._came_twice = True
        elif self._in_period and self._in_period[-1] > name:
            self._tally["out_of_order"] += 1
        self._in_period.append(name)
        received, mapped = self.received, pdo.map.objects
        objects = received.objects
        for index, value in zip(mapped, pdo.values, strict=True):
            if index is not None:
                objects[index] = value
        if STATUSWORD in mapped:
            self.state = state_of(objects[STATUSWORD])
            received.feedback_ns, received.sampled_ns = now, sampled
            received.operational_ns = received.operational_ns or now
            self.setup.started()
        if POSITION in mapped:
            received.position_ns = now
            self._count_on(objects[POSITION])

    def _count_on(self, raw: int) -> None:
        if self._total is None or self._anew:
            self._origin += raw - (self._total if self._total is not None else 0)
            self._total, self._anew = raw, False
        self._total = unwrap(raw, self._total)

    def take_heartbeat(self, beat: Heartbeat, now: int) -> None:
        """A heartbeat; one that says that the drive is not operational any more has it set up again."""
        self.received.heartbeat_ns, self.received.nmt = now, beat.state
        self._missed_beat = False
        if beat.state is NmtState.BOOT_UP:
            self._left("has restarted")
        elif beat.state is not NmtState.OPERATIONAL and self.setup.stage in (SetupStage.CHECKING, SetupStage.RUNNING):
            self._left(f"is {beat.state.name.lower().replace('_', '-')}, no longer operational")

    def _left(self, how: str) -> None:
        if self.setup.stage is SetupStage.RUNNING:
            self.restarted = how
            self._tally["drive_restarts"] += 1
        self.forget()

    def take_emcy(self, emcy: Emcy) -> None:
        """An emergency message."""
        self._tally["emergencies"] += 1
        self.received.emergency = emcy if emcy.code else None
        if emcy.code and not is_warning(emcy.code):
            self.alarm = emcy

    def take_sdo(self, answer: Sdo) -> None:
        """An answer to a request; one that shows that settings are lost has the drive sought anew."""
        was = self.setup.stage
        self.setup.take(answer)
        if self.setup.stage is SetupStage.SEEKING and was is not SetupStage.SEEKING:
            self.forget()

    def forget(self) -> None:
        """The drive is gone, or has lost its settings: seek it and set it up from the beginning."""
        self.setup.restart()
        emergency = self.received.emergency
        self.received, self.state = Received(emergency=emergency), None
        self._anew, self.doubtful = True, False

    def end_period(self, expected: DriveState | None) -> None:
        """Before the next SYNC: count what did not come, and feedback that is not what was asked for."""
        if self.setup.stage is SetupStage.RUNNING and self.received.feedback_ns is not None and not self._in_period:
            self._tally["missed_feedback"] += 1
        if self._in_period:
            wrong = "" if expected is None else self._mismatch(expected)
            self.received.mismatches, self.received.mismatch = (self.received.mismatches + 1 if wrong else 0), wrong
            self.doubtful = self.doubtful or self.received.mismatches >= MISMATCHES_MOST
            self._count_status_bits()
        self._twice = min(self._twice + 1, 2 * TWICE_MOST) if self._came_twice else max(self._twice - 1, 0)
        self.shares_id = self._twice > (0 if self.shares_id else TWICE_MOST)
        self._came_twice = False
        self._in_period.clear()

    def _mismatch(self, expected: DriveState) -> str:
        """What of state and mode is not as it was led to be; empty where all is."""
        wrong = []
        if self.state is not expected:
            wrong.append(f"is in state '{self.state}', expected '{expected}'")
        if not self.mode_fits:
            wrong.append(f"reports mode of operation {self.received.objects[MODE]} (6061h), expected {self._mode}")
        if wrong and self._came_twice:
            wrong.append("its feedback comes twice: a second node may have its id")
        return "; ".join(wrong)

    # What is known of it.

    @property
    def mode_fits(self) -> bool:
        """Whether its mode of operation is the one that was set, as far as it reports it."""
        return self.received.objects.get(MODE, self._mode) == self._mode

    @property
    def in_fault(self) -> bool:
        """Whether it reports a fault."""
        return self.state in IN_FAULT

    def feedback_age(self, now: int) -> float:
        """Since its last statusword, s."""
        then = self.received.feedback_ns
        return math.inf if then is None else max(0.0, 1e-9 * (now - then))

    def heartbeat_age(self, now: int) -> float:
        """Since its last heartbeat, s."""
        then = self.received.heartbeat_ns
        return math.inf if then is None else max(0.0, 1e-9 * (now - then))

    def misses_heartbeat(self, now: int, timeout: float) -> bool:
        """Whether it is operational, but no heartbeat has come for `timeout` (s), or none since it became so."""
        since = self.received.heartbeat_ns or self.received.operational_ns
        return self.setup.stage is SetupStage.RUNNING and since is not None and _age(since, now) > timeout

    def doubt_once(self) -> None:
        """Have the settings read again where heartbeats begin to be missed: their period is one of them."""
        self.doubtful = self.doubtful or not self._missed_beat
        self._missed_beat = True

    def _count_status_bits(self) -> None:
        word = self.received.objects.get(STATUSWORD, 0)
        self._tally["drive_warns"] += bool(word & WARNING)
        self._tally["drive_at_limit"] += bool(word & INTERNAL_LIMIT)

    def fault_text(self) -> str:
        """What its fault is, as far as it has reported it."""
        emergency, code = self.received.emergency, self.received.objects.get(ERROR_CODE, 0)
        if emergency is not None and (not code or emergency.code == code):
            return emergency.text
        return error_text(code) if code else "no error code"

    def position(self, now: int, timeout: float) -> float:
        """Turn since its first feedback, rad; NaN before, and once none has come for `timeout` seconds.

        It may come in another PDO than the statusword, and be lost alone.
        """
        if self._total is None or _age(self.received.position_ns, now) > timeout:
            return math.nan
        return self.scaling.position.si(self._total - self._origin)

    def quantity(self, index: int) -> float:
        """Velocity (606Ch) or torque (6077h) actual value, SI; NaN before the first feedback."""
        raw = self.received.objects.get(index)
        scale = self.scaling.velocity if index == VELOCITY else self.scaling.torque
        return math.nan if raw is None else scale.si(raw)

    # What it is sent.

    def frames(
        self, target: DriveState, velocity: int, torque: int, reset_faults: bool, hold: bool = False
    ) -> list[Frame]:
        """Its RPDOs for this cycle; what they map beside controlword and set-points is zero.

        With `hold` the drive is kept in the target, but not led there: one that has left it by itself stays off, and
        one of which a statusword comes late is not taken out of it.
        """
        state = self.state
        if state is None or self.setup.stage is not SetupStage.RUNNING:
            state, target = DriveState.SWITCH_ON_DISABLED, DriveState.SWITCH_ON_DISABLED
        elif hold and not self.in_fault:
            state = target
        self._controlword = controlword_for(state, target, self._controlword, reset_faults=reset_faults)
        given: dict[int | None, int] = {
            CONTROLWORD: self._controlword,
            TARGET_VELOCITY: velocity,
            TARGET_TORQUE: torque,
        }
        return [
            Frame(can_id, packing.pack(*(given.get(index, 0) for index in objects)))
            for can_id, packing, objects in self._rpdos
        ]

    def status(self, now: int, trouble: str) -> DriveStatus:
        """All about it, for a person."""
        emergency = self.received.emergency
        return DriveStatus(
            motor=self.motor,
            node=self.node,
            stage=self.setup.stage,
            state=self.state,
            trouble=trouble,
            emergency="" if emergency is None else emergency.text,
            error_code=self.received.objects.get(ERROR_CODE, 0),
            statusword=self.received.objects.get(STATUSWORD, 0),
            heartbeat_age=self.heartbeat_age(now),
            feedback_age=self.feedback_age(now),
            progress=self.setup.progress,
            remark=self.setup.remark,
        )


def _age(then: int | None, now: int) -> float:
    return math.inf if then is None else max(0.0, 1e-9 * (now - then))
