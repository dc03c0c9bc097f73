"""What goes into a cycle of the master and what comes out: frozen values, SI, motor-side, motors as in ``MOTORS``."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from artibot_driver.bus import BusState
from artibot_driver.cia402 import DriveState, StatusBit
from artibot_driver.master.phases import Phase
from artibot_sim.sharing import Law

Pair = tuple[float, float]
"""Right, left."""

Four = tuple[float, float, float, float]
"""In the order of ``MOTORS``."""

WARNING, INTERNAL_LIMIT = int(StatusBit.WARNING), int(StatusBit.INTERNAL_LIMIT)
"""Bits of the statusword as plain numbers: sets of flags take a microsecond each."""

NAN_PAIR: Final = (math.nan, math.nan)
NAN_FOUR: Final = (math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Setpoints:
    """What the rover is to do in the next period.

    Attributes
    ----------
    front_velocity : (float, float)
        Front right and left motor, rad/s.
    stamp_ns : int
        Steady time at which the message that this rests on was received. Set-points that are not younger than the
        last enable do not act.
    back_effort : (float, float)
        Back right and left motor, N m; NaN leaves a motor to eq. 30.
    kappa : float or None
        Share of the front module in the traction torque (eq. 29); None is the robot file's.
    law : Law or None
        How the back motors share the torque; None is eq. 30 in the drives' own counts.
    """

    front_velocity: Pair
    stamp_ns: int
    back_effort: Pair = NAN_PAIR
    kappa: float | None = None
    law: Law | None = None


class StopReason(enum.Enum):
    """Why the rover was stopped."""

    DISABLE = "disable was asked for"
    QUICK_STOP = "quick stop was asked for"
    COMMAND_SILENCE = "no command while driving"
    INVALID_COMMAND = "a command that cannot be followed"
    DRIVE_SILENT = "a drive is silent"
    DRIVE_RESTARTED = "a drive has left operational by itself"
    DRIVE_FAULT = "a drive has a fault"
    DRIVE_STATE = "a drive is not in the state it was led to"
    SECOND_DRIVER = "somebody else commands the drives"
    BUS_LOST = "the bus carries no frames"
    CANNOT_SEND = "frames could not be sent"
    BUS_OVERLOADED = "the bus is flooded"
    OVERRUN = "the driver's loop was held up"
    ENABLE_TIMEOUT = "the drives did not become enabled"

    @property
    def asked_for(self) -> bool:
        """Whether somebody wanted it so: nothing to worry about."""
        return self in (StopReason.DISABLE, StopReason.QUICK_STOP)


@dataclass(frozen=True)
class StopRecord:
    """The first reason of the last stop: kept until the next enable.

    Attributes
    ----------
    text : str
        One sentence for log and diagnostics, with the motor and what was seen.
    at_ns : int
        Steady time at which it was noticed.
    motor : str
        Whose drive it was, empty where it was none's.
    """

    reason: StopReason
    text: str
    at_ns: int
    motor: str = ""


class Feedback(NamedTuple):
    """What the drives have reported; NaN where it is not known (no feedback yet, or silent).

    Attributes
    ----------
    position, velocity, torque : 4 floats
        rad, rad/s, N m. Positions begin at zero, go on beyond the drives' 32 bits and after a drive has rejoined.
    stamp_ns : 4 ints or None
        Steady time of the SYNC that sampled it.
    """

    position: Four = NAN_FOUR
    velocity: Four = NAN_FOUR
    torque: Four = NAN_FOUR
    stamp_ns: tuple[int | None, int | None, int | None, int | None] = (None, None, None, None)


class Commanded(NamedTuple):
    """What the frames of this cycle command, after rounding and limits; NaN where nothing is commanded.

    Attributes
    ----------
    front_velocity, back_effort : (float, float)
        rad/s and N m.
    stamp_ns : int
        Steady time of the SYNC with which it takes effect.
    """

    front_velocity: Pair = NAN_PAIR
    back_effort: Pair = NAN_PAIR
    stamp_ns: int = 0


class SetupStage(enum.Enum):
    """How far a drive is set up."""

    SEEKING = "not heard"
    SETTING = "being set up"
    REFUSED = "refused: not the drive that was configured"
    STARTING = "set up, being started"
    CHECKING = "set up, its settings being read again"
    RUNNING = "set up"


class DriveStatus(NamedTuple):
    """One drive.

    Attributes
    ----------
    state : DriveState or None
        Of CiA 402; None where it is not known.
    trouble : str
        What is wrong with it, one sentence; empty where nothing is.
    emergency : str
        The last emergency in words, until it says that its errors are gone.
    error_code : int
        Object 603Fh.
    heartbeat_age, feedback_age : float
        Since its last heartbeat and its last TPDO1, s; infinite where there was none.
    progress : float
        Of its setting up, 0 to 1.
    remark : str
        What does not fit about it, though it keeps from nothing; mostly empty.
    """

    motor: str
    node: int
    stage: SetupStage
    state: DriveState | None
    trouble: str
    emergency: str
    error_code: int
    statusword: int
    heartbeat_age: float
    feedback_age: float
    progress: float
    remark: str = ""

    @property
    def warns(self) -> bool:
        """Whether its statusword's warning bit is set."""
        return bool(self.statusword & WARNING)

    @property
    def at_limit(self) -> bool:
        """Whether its statusword says that an internal limit acts."""
        return bool(self.statusword & INTERNAL_LIMIT)


class BusStatus(NamedTuple):
    """The bus as the master finds it.

    Attributes
    ----------
    load : float
        Share of the configured bit rate that frames took in the last 50 ms, stuff bits at their most.
    reason : str
        The last thing that went wrong, empty where nothing did.
    """

    state: BusState
    load: float
    tx_errors: int | None
    rx_errors: int | None
    reason: str


class MasterStatus(NamedTuple):
    """All that a diagnosis needs, once a cycle.

    Attributes
    ----------
    stop : StopRecord or None
        Why the rover is not enabled any more; None after an enable, and where it never was.
    armed_ns : int or None
        Steady time of the last enable: set-points have to be younger. None where it is not enabled.
    following : bool
        Whether the set-points handed over act.
    other_driver : str
        Another driver whose frames came while listening, one clause with the mend; else empty.
    refusal : str
        What keeps a drive from being set up for good, as an :class:`ArtibotError` would say it; else empty.
    notice : str
        What became of the last request, one sentence.
    requests : int
        How many requests have been answered.
    drives : 4 DriveStatus
    counters : mapping of str to int
        What has been seen since the start, by kind.
    """

    phase: Phase
    stop: StopRecord | None
    armed_ns: int | None
    following: bool
    refusal: str
    notice: str
    requests: int
    drives: tuple[DriveStatus, ...]
    bus: BusStatus
    counters: Mapping[str, int]
    other_driver: str = ""


class MasterCycle(NamedTuple):
    """What one call of :meth:`Master.cycle` gives."""

    feedback: Feedback
    commanded: Commanded
    status: MasterStatus
