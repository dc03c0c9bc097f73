"""A simulated drive: the state machine of CiA 402 and its set-points, around a motor that somebody else turns.

What it does is what CiA 301 and 402 say, of the objects that its EDS names. Call :meth:`SimulatedDrive.step` at 100 Hz
or more; or `run`, and hand over what has come, and `watch`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

from artibot_driver.cia402 import (
    Command,
    DriveEvent,
    DriveState,
    OperationMode,
    StatusBit,
    command_of,
    statusword,
    transition,
)
from artibot_driver.dictionary import load_dictionary
from artibot_driver.frames import Frame, NmtState
from artibot_driver.rig import Rig
from artibot_driver.scaling import INT16, INT32, wrap
from artibot_driver.simulated.motion import (
    FREE,
    QUICK_STOP_AND_STAY,
    SLOW_DOWN_AND_STAY,
    STANDSTILL_RPM,
    Demands,
    Shaft,
)
from artibot_driver.simulated.node import COMMUNICATION, COMMUNICATION_BIT, GENERIC, CanopenNode, require
from artibot_driver.simulated.objects import INVALID_VALUE, Abort
from artibot_sim.errors import ArtibotError

SENSOR: Final = 0x7300
"""Error code of a motor whose position or speed is no number."""

_VOLTAGE_ENABLED, _REMOTE, _INTERNAL_LIMIT, _TARGET_REACHED, _FOLLOWS_COMMAND = (
    int(bit)  # sets of flags take a microsecond each
    for bit in (
        StatusBit.VOLTAGE_ENABLED, StatusBit.REMOTE, StatusBit.INTERNAL_LIMIT, StatusBit.TARGET_REACHED,
        StatusBit.FOLLOWS_COMMAND,
    )
)  # fmt: skip

_QUICK_STOPS: Final = (0, 1, 2, SLOW_DOWN_AND_STAY, QUICK_STOP_AND_STAY)
POWERED: Final = (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE)
"""States in which the motor may have current."""

_NEEDED: Final = (
    0x6007, 0x6040, 0x6041, 0x605A, 0x605E, 0x6060, 0x6061, 0x6064, 0x606B, 0x606C, 0x6071, 0x6072, 0x6074, 0x6077,
    0x6080, 0x6083, 0x6084, 0x6085, 0x6087, 0x60FF, 0x6502,
)  # fmt: skip


class SimulatedDrive(CanopenNode):
    """One drive on a bus.

    Parameters
    ----------
    rig : Rig
        Node id, EDS and scales.
    motor : str
        Which of the rig's motors it drives.
    shaft : Shaft
        The motor.
    send : callable
        Takes each frame that the drive sends.

    Attributes
    ----------
    state : DriveState

    Raises
    ------
    ArtibotError
        When the EDS lacks objects that are simulated.
    """

    def __init__(self, rig: Rig, motor: str, shaft: Shaft, send: Callable[[Frame], object]) -> None:
        scaling, node = rig.scaling[motor], rig.codec.nodes[motor]
        dictionary = load_dictionary(rig.config.eds, node)
        require(dictionary, _NEEDED)
        fixed = {(each.index, each.subindex): each.value for each in rig.settings(motor) if not each.written}
        super().__init__(node, dictionary, fixed, rig.codec.sync_id, rig.codec.emcy_base, send)
        self._scaling = dataclasses.replace(  # what is measured is not cut off at what may be commanded
            scaling,
            velocity=dataclasses.replace(scaling.velocity, low=INT32[0], high=INT32[1]),
            torque=dataclasses.replace(scaling.torque, low=INT16[0], high=INT16[1]),
        )
        self.objects.on_write(0x6040, self._take_controlword)
        self.objects.on_write(0x6060, self._check_mode)
        self.objects.on_write(0x605A, self._check_quick_stop)
        self._motion, self._shaft = Demands(self.objects, scaling), shaft
        self._reset()

    def _reset(self) -> None:
        self.state = DriveState.NOT_READY_TO_SWITCH_ON
        self._controlword = 0
        self._defect = 0
        self._reacting = False
        self._motion.stop()
        self._shaft.command(FREE)

    def _run(self, dt: float) -> None:
        if self.state is DriveState.NOT_READY_TO_SWITCH_ON:
            self._take(DriveEvent.INITIALISED)
        self._move(dt)

    def fail(self, code: int, register: int = GENERIC, *, lasting: bool = False) -> None:
        """Have the drive detect a fault of its own: emergency, fault reaction, fault.

        Parameters
        ----------
        code, register : int
            Error code (603Fh) and bits of the error register.
        lasting : bool
            Whether the cause remains, so that a fault reset does nothing until :meth:`mend`.
        """
        self._defect = code if lasting else self._defect
        self._fault(code, register)

    def let_go(self) -> None:
        """Take the motor's current away as by its STO input, open for a moment: switch on disabled, and no fault."""
        self._take(Command.DISABLE_VOLTAGE)

    def mend(self) -> None:
        """Take away the cause of a lasting fault."""
        self._defect = 0

    def _connection_lost(self, code: int) -> None:
        """What the abort connection option code (6007h) says; an idle drive may leave operational without harm."""
        if code == COMMUNICATION and self.state not in POWERED:
            return
        action = self.objects.values[0x6007, 0]
        if action == 1:
            self._fault(code, GENERIC | COMMUNICATION_BIT)
            return
        self._emergency(code, GENERIC | COMMUNICATION_BIT)
        if action > 1:
            self._take(Command.DISABLE_VOLTAGE if action == 2 else Command.QUICK_STOP)

    def _connection_back(self) -> None:
        if self.state not in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            self._errors_gone()

    def _fault(self, code: int, register: int) -> None:
        self._reacting = self._reacting or self.state in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE)
        self._emergency(code, register)
        self._take(DriveEvent.FAULT)

    def _take_controlword(self, word: int) -> None:
        command, self._controlword = command_of(word, self._controlword), word
        if command is Command.FAULT_RESET and (self._defect or self.master_lost):
            return
        while self._take(command):
            pass

    def _take(self, trigger: Command | DriveEvent | None) -> bool:
        holds = self.objects.values[0x605A, 0] in (SLOW_DOWN_AND_STAY, QUICK_STOP_AND_STAY)
        found = transition(self.state, trigger, holds=holds)
        if found is None:
            return False
        was, self.state = self.state, found.end
        if self.state is DriveState.OPERATION_ENABLED and was is not DriveState.QUICK_STOP_ACTIVE:
            self._refresh()
            self._motion.begin(self.objects.values[0x606C, 0], 0)
        if self.state not in POWERED:
            self._motion.stop()
            self._shaft.command(FREE)
        if trigger is Command.FAULT_RESET:
            self._errors_gone()
        return True

    def _move(self, dt: float) -> None:
        """Ramps and set-points of the states in which the motor has current."""
        values, mode = self.objects.values, self.objects.values[0x6060, 0]
        if self.state is DriveState.OPERATION_ENABLED:
            self._shaft.command(self._motion.follow(mode, dt))
        elif self.state in POWERED:
            reaction = self.state is DriveState.FAULT_REACTION_ACTIVE
            code = values[0x605E if reaction else 0x605A, 0]
            self._refresh()
            command, done = self._motion.ramp_down(mode, code, values[0x606C, 0], dt)
            self._shaft.command(command if not reaction or self._reacting else FREE)
            if done or (reaction and not self._reacting):
                self._take(DriveEvent.FAULT_REACTION_DONE if reaction else DriveEvent.QUICK_STOP_DONE)
                self._reacting = self._reacting and self.state is DriveState.FAULT_REACTION_ACTIVE

    def _check_mode(self, mode: int) -> None:
        known = {int(each) for each in OperationMode if each.supported_bit & self.objects.values[0x6502, 0]}
        if mode and mode not in known:
            raise Abort(INVALID_VALUE)
        if mode != self.objects.values[0x6060, 0] and self.state is DriveState.OPERATION_ENABLED:
            self._refresh()
            self._motion.begin(self.objects.values[0x606C, 0], 0)

    def _check_quick_stop(self, code: int) -> None:
        if code not in _QUICK_STOPS:
            raise Abort(INVALID_VALUE)

    def _refresh(self) -> None:
        """Bring the objects up to what drive and motor do now."""
        values, scaling = self.objects.values, self._scaling
        shaft = self._shaft.state()
        try:
            position = round(shaft.position / scaling.position.step)
            velocity, torque = scaling.velocity.raw(shaft.velocity).raw, scaling.torque.raw(shaft.torque).raw
        except (ArtibotError, ValueError, OverflowError):  # NaN or infinity: the encoder has failed
            if self.state not in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
                self._reacting = False
                self._emergency(SENSOR, GENERIC)
                self._take(DriveEvent.FAULT)
        else:
            values[0x6064, 0], values[0x606C, 0], values[0x6077, 0] = wrap(position), velocity, torque
        values[0x606B, 0], values[0x6074, 0] = round(self._motion.velocity), round(self._motion.torque)
        values[0x6061, 0] = values[0x6060, 0]
        values[0x6041, 0] = statusword(self.state, self._status_bits())

    def _status_bits(self) -> int:
        values, mode = self.objects.values, self.objects.values[0x6060, 0]
        bits = _VOLTAGE_ENABLED
        if self.nmt is NmtState.OPERATIONAL:
            bits |= _REMOTE
        if self.state is DriveState.OPERATION_ENABLED:
            if self._motion.limited:
                bits |= _INTERNAL_LIMIT
            if self._motion.reached(mode):
                bits |= _TARGET_REACHED
            if mode in (OperationMode.CYCLIC_SYNC_VELOCITY, OperationMode.CYCLIC_SYNC_TORQUE):
                bits |= _FOLLOWS_COMMAND
        if mode == OperationMode.PROFILE_VELOCITY:
            slow = abs(values[0x606C, 0]) <= STANDSTILL_RPM * 10.0**-self._scaling.velocity_exponent
            if slow:  # the same bit says: speed is zero
                bits |= _FOLLOWS_COMMAND
        return bits
