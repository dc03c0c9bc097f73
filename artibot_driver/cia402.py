"""The CiA 402 state machine (IEC 61800-7-201) as one table of data, and pure functions that look things up in it.

A drive reports its state in the statusword (6041h) and is led through the states by the controlword (6040h). Nothing
here keeps a state: the driver holds the last statusword, a simulated drive its own state.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Iterator
from functools import lru_cache
from typing import Final, NamedTuple


class Pattern(NamedTuple):
    """Bits of a word that decide, and what they must be."""

    mask: int
    value: int

    def matches(self, word: int) -> bool:
        """Whether `word` has these bits."""
        return word & self.mask == self.value


class DriveState(enum.Enum):
    """State of a drive, with the statusword pattern that reports it; the standard's names."""

    NOT_READY_TO_SWITCH_ON = Pattern(0x4F, 0x00)
    SWITCH_ON_DISABLED = Pattern(0x4F, 0x40)
    READY_TO_SWITCH_ON = Pattern(0x6F, 0x21)
    SWITCHED_ON = Pattern(0x6F, 0x23)
    OPERATION_ENABLED = Pattern(0x6F, 0x27)
    QUICK_STOP_ACTIVE = Pattern(0x6F, 0x07)
    FAULT_REACTION_ACTIVE = Pattern(0x4F, 0x0F)
    FAULT = Pattern(0x4F, 0x08)

    __hash__ = object.__hash__  # members are single; enum's own hashes their names, in Python

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


class Command(enum.Enum):
    """Command of a controlword, with its pattern; `FAULT_RESET` is the rising edge of its bit.

    Switch on and disable operation have the same bits: the state distinguishes them, so they are one command here.
    """

    SHUTDOWN = Pattern(0x87, 0x06)
    SWITCH_ON = Pattern(0x8F, 0x07)
    ENABLE_OPERATION = Pattern(0x8F, 0x0F)
    DISABLE_VOLTAGE = Pattern(0x82, 0x00)
    QUICK_STOP = Pattern(0x86, 0x02)
    FAULT_RESET = Pattern(0x80, 0x80)

    __hash__ = object.__hash__

    @property
    def controlword(self) -> int:
        """The plainest controlword that gives this command: all bits zero that do not matter."""
        return self.value.value

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


class DriveEvent(enum.Enum):
    """What happens inside a drive, without a command."""

    INITIALISED = "self-test and initialisation done"
    FAULT = "fault detected"
    FAULT_REACTION_DONE = "fault reaction done"
    QUICK_STOP_DONE = "standstill after a quick stop"

    __hash__ = object.__hash__


class Transition(NamedTuple):
    """One arrow of the state machine: its number in the standard, its ends, and what triggers it."""

    number: int
    start: DriveState
    end: DriveState
    triggers: tuple[Command | DriveEvent, ...]
    needs_hold: bool = False
    """Only where the quick stop option code (605Ah, 5 to 8) keeps the drive in quick stop active."""


_S, _C, _E = DriveState, Command, DriveEvent
_ENABLED_OR_BEFORE = tuple(state for state in DriveState if state not in (_S.FAULT_REACTION_ACTIVE, _S.FAULT))

TRANSITIONS: Final = (
    # 0 is power on, into NOT_READY_TO_SWITCH_ON: it has no start
    Transition(1, _S.NOT_READY_TO_SWITCH_ON, _S.SWITCH_ON_DISABLED, (_E.INITIALISED,)),
    Transition(2, _S.SWITCH_ON_DISABLED, _S.READY_TO_SWITCH_ON, (_C.SHUTDOWN,)),
    # enable operation is "switch on" and, by the same controlword in the state after it, transition 4
    Transition(3, _S.READY_TO_SWITCH_ON, _S.SWITCHED_ON, (_C.SWITCH_ON, _C.ENABLE_OPERATION)),
    Transition(4, _S.SWITCHED_ON, _S.OPERATION_ENABLED, (_C.ENABLE_OPERATION,)),
    Transition(5, _S.OPERATION_ENABLED, _S.SWITCHED_ON, (_C.SWITCH_ON,)),
    Transition(6, _S.SWITCHED_ON, _S.READY_TO_SWITCH_ON, (_C.SHUTDOWN,)),
    Transition(7, _S.READY_TO_SWITCH_ON, _S.SWITCH_ON_DISABLED, (_C.DISABLE_VOLTAGE, _C.QUICK_STOP)),
    Transition(8, _S.OPERATION_ENABLED, _S.READY_TO_SWITCH_ON, (_C.SHUTDOWN,)),
    Transition(9, _S.OPERATION_ENABLED, _S.SWITCH_ON_DISABLED, (_C.DISABLE_VOLTAGE,)),
    Transition(10, _S.SWITCHED_ON, _S.SWITCH_ON_DISABLED, (_C.DISABLE_VOLTAGE, _C.QUICK_STOP)),
    Transition(11, _S.OPERATION_ENABLED, _S.QUICK_STOP_ACTIVE, (_C.QUICK_STOP,)),
    Transition(12, _S.QUICK_STOP_ACTIVE, _S.SWITCH_ON_DISABLED, (_C.DISABLE_VOLTAGE, _E.QUICK_STOP_DONE)),
    *(Transition(13, state, _S.FAULT_REACTION_ACTIVE, (_E.FAULT,)) for state in _ENABLED_OR_BEFORE),
    Transition(14, _S.FAULT_REACTION_ACTIVE, _S.FAULT, (_E.FAULT_REACTION_DONE,)),
    Transition(15, _S.FAULT, _S.SWITCH_ON_DISABLED, (_C.FAULT_RESET,)),
    Transition(16, _S.QUICK_STOP_ACTIVE, _S.OPERATION_ENABLED, (_C.ENABLE_OPERATION,), needs_hold=True),
)
"""Every transition of the standard but power on (0); 13 stands once for each state that it leaves."""

_BY_TRIGGER = {(row.start, trigger): row for row in TRANSITIONS for trigger in row.triggers}

_STATE_BITS = 0x6F
_STATES = tuple(next((s for s in DriveState if s.value.matches(word)), None) for word in range(_STATE_BITS + 1))


def state_of(statusword: int) -> DriveState | None:
    """The state that a statusword (6041h) reports, or None for bits that no state has."""
    return _STATES[statusword & _STATE_BITS]


@lru_cache(maxsize=256)
def command_of(controlword: int, previous: int = 0) -> Command | None:
    """The command that a controlword (6040h) gives.

    Parameters
    ----------
    controlword : int
    previous : int
        The controlword before it: fault reset is an edge of bit 7.

    Returns
    -------
    Command or None
        None where the bits are no command: bit 7 held high, above all.
    """
    for command in Command:
        if command.value.matches(controlword):
            return None if command is Command.FAULT_RESET and Command.FAULT_RESET.value.matches(previous) else command
    return None


def transition(state: DriveState, trigger: Command | DriveEvent | None, *, holds: bool = False) -> Transition | None:
    """The one transition that `trigger` makes a drive in `state` take, or None where it stays.

    A drive asks once more with the same controlword after each transition: enable operation leads from ready to
    switch on through switched on, as the standard allows.

    Parameters
    ----------
    holds : bool
        Whether the quick stop option code (605Ah) is 5 to 8: the drive stays in quick stop active at standstill.
    """
    if trigger is None:
        return None
    found = _BY_TRIGGER.get((state, trigger))
    if found is None or (found.needs_hold and not holds) or (holds and trigger is DriveEvent.QUICK_STOP_DONE):
        return None
    return found


TARGETS: Final = (
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
    DriveState.QUICK_STOP_ACTIVE,
)
"""States that a master can ask for."""

_HOLDING: Final = {
    DriveState.SWITCH_ON_DISABLED: Command.DISABLE_VOLTAGE,
    DriveState.READY_TO_SWITCH_ON: Command.SHUTDOWN,
    DriveState.SWITCHED_ON: Command.SWITCH_ON,
    DriveState.OPERATION_ENABLED: Command.ENABLE_OPERATION,
    DriveState.QUICK_STOP_ACTIVE: Command.QUICK_STOP,
}
"""Command that keeps a drive in a state (and cannot lead it nearer to operation than that)."""


@lru_cache(maxsize=256)
def next_command(state: DriveState, target: DriveState, *, reset_faults: bool = False) -> Command:
    """The command for the next step from `state` to `target`, or the one that holds it there.

    Operation is never enabled on the way to another state: a quick stop asked of a drive that is not enabled removes
    its voltage. Quick stop active is left through switch on disabled, never by transition 16. Where a drive goes on
    by itself (not ready, fault reaction) the command is disable voltage.

    Parameters
    ----------
    reset_faults : bool
        Whether a drive in fault is to be reset. That is a person's decision: otherwise it is left there.

    Raises
    ------
    ValueError
        When `target` is none of :data:`TARGETS`.
    """
    if target not in TARGETS:
        raise ValueError(f"a master cannot ask for '{target}'; expected one of {', '.join(map(str, TARGETS))}")
    if state is target:
        return _HOLDING[target]
    barred = () if reset_faults else (Command.FAULT_RESET,)
    queue: deque[tuple[DriveState, Command | None]] = deque([(state, None)])
    seen = {state}
    while queue:
        here, first = queue.popleft()
        for command, end in _commanded(here):
            if command in barred:
                continue
            if end is target:
                return first or command
            if end not in seen and end not in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE):
                seen.add(end)
                queue.append((end, first or command))
    return Command.QUICK_STOP if target is DriveState.QUICK_STOP_ACTIVE else Command.DISABLE_VOLTAGE


def _commanded(state: DriveState) -> Iterator[tuple[Command, DriveState]]:
    for row in TRANSITIONS:
        for trigger in row.triggers:
            if row.start is state and isinstance(trigger, Command) and not row.needs_hold:
                yield trigger, row.end


def controlword_for(state: DriveState, target: DriveState, previous: int = 0, *, reset_faults: bool = False) -> int:
    """The controlword to send next to lead a drive from `state` to `target`.

    Parameters
    ----------
    previous : int
        The controlword sent before: a fault reset needs its bit low once, so that there is an edge.
    reset_faults : bool
        As in :func:`next_command`.

    Raises
    ------
    ValueError
        When `target` is none of :data:`TARGETS`.
    """
    command = next_command(state, target, reset_faults=reset_faults)
    if command is Command.FAULT_RESET and Command.FAULT_RESET.value.matches(previous):
        return Command.DISABLE_VOLTAGE.controlword
    return command.controlword


class StatusBit(enum.IntFlag):
    """Statusword bits beside those of the state."""

    VOLTAGE_ENABLED = 1 << 4
    WARNING = 1 << 7
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    INTERNAL_LIMIT = 1 << 11
    FOLLOWS_COMMAND = 1 << 12
    """In the cyclic synchronous modes; in profile velocity the bit says that the speed is zero."""


HALT: Final = 1 << 8
"""Controlword bit: slow down and stop, in the profile modes."""


def statusword(state: DriveState, bits: int = 0) -> int:
    """A statusword that reports `state`, with further bits of :class:`StatusBit`."""
    word = state.value.value
    if state is DriveState.FAULT_REACTION_ACTIVE or state is DriveState.NOT_READY_TO_SWITCH_ON:
        return word | bits & ~_STATE_BITS
    no_quick_stop = 0 if state is DriveState.QUICK_STOP_ACTIVE else 1 << 5
    return word | no_quick_stop | bits & ~_STATE_BITS


class OperationMode(enum.IntEnum):
    """Modes of operation (6060h, 6061h) that artibot uses."""

    PROFILE_VELOCITY = 3
    PROFILE_TORQUE = 4
    CYCLIC_SYNC_VELOCITY = 9
    CYCLIC_SYNC_TORQUE = 10

    @property
    def supported_bit(self) -> int:
        """Its bit in the supported drive modes (6502h)."""
        return 1 << (self - 1)

    @property
    def is_velocity(self) -> bool:
        """Whether the set-point is the target velocity (60FFh); else it is the target torque (6071h)."""
        return self in (OperationMode.PROFILE_VELOCITY, OperationMode.CYCLIC_SYNC_VELOCITY)
