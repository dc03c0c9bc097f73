"""The faults that driver and drives have to cope with, single and combined: how each begins, what must follow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from artibot_driver.faults.closed_loop import ClosedLoop
from artibot_driver.faults.simulated_bus import Interference
from artibot_driver.frames import Frame, NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.master import Setpoints, StopReason

# ----------------------------------------------------------------------
# The faults that driver and drives have to cope with: how each comes about, how it ends, and what must follow.
# ----------------------------------------------------------------------


ON_THE_BUS: Final = 0.15
"""A reaction has to begin within this time where the driver can notice, s."""

BY_THE_DRIVES: Final = 0.3
"""A reaction has to begin within this time where only the drives can notice, s."""

_OVER_CURRENT: Final = 0x2310

Act = Callable[[ClosedLoop, str], None]


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes
    ----------
    inject, mend : callable
        Take the loop and the motor that is concerned, where one is.
    stops : bool
        Whether the rover has to stop; else it may also go on as commanded.
    within : float
        The reaction has to begin so soon, s.
    reasons : tuple of StopReason
        What the driver may give as the first reason; empty where it cannot know one.
    own : float
        As `within`, for the drive concerned where it is left to itself, s.
    held : float
        By so much later the rover may be at rest, s.
    silent : bool
        Whether the driver says nothing for so long that another one may lead the drives: at its end it has to listen.
    group : str
        Under which name it is summed up, where not under its own.
    """

    name: str
    inject: Act
    mend: Act
    stops: bool
    within: float
    reasons: tuple[StopReason, ...]
    own: float = 0.0
    held: float = 0.0
    silent: bool = False
    group: str = ""


def _nothing(loop: ClosedLoop, motor: str) -> None:
    """There is nothing to mend."""


def _unplug(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.unplug(motor))


def _plug(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.plug(motor))


def _cut_power(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.cut_power(motor))


def _power(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.power(motor, loop.now))


def _restart(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.drives[motor].power_on(loop.now))


def _restart_unnoticed(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.restart_unnoticed(motor, loop.now))


def _let_go(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.drives[motor].let_go())


def _fail(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.drives[motor].fail(_OVER_CURRENT))


def _fail_for_long(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.drives[motor].fail(_OVER_CURRENT, lasting=True))


def _mend_drive(loop: ClosedLoop, motor: str) -> None:
    loop.with_drives(lambda drive_set: drive_set.drives[motor].mend())


def _emergency(loop: ClosedLoop, motor: str) -> None:
    codec = loop.rig.codec
    loop.inject([codec.emcy(codec.nodes[motor], _OVER_CURRENT, 1)])


def _hang(loop: ClosedLoop, motor: str) -> None:
    loop.hung = True


def _wake(loop: ClosedLoop, motor: str) -> None:
    loop.hung = False


def _replace_driver(loop: ClosedLoop, motor: str) -> None:
    loop.new_master()
    loop.hung = False


def _down(loop: ClosedLoop, motor: str) -> None:
    loop.bus_down()


def _up(loop: ClosedLoop, motor: str) -> None:
    loop.bus_up()


def _off(loop: ClosedLoop, motor: str) -> None:
    loop.bus_off()


def _on(loop: ClosedLoop, motor: str) -> None:
    loop.bus_on()


def _cable_off(loop: ClosedLoop, motor: str) -> None:
    loop.cable_off()


def _cable_on(loop: ClosedLoop, motor: str) -> None:
    loop.cable_on()


def _flood(loop: ClosedLoop, motor: str) -> None:
    loop.flood = loop.full


def _end_flood(loop: ClosedLoop, motor: str) -> None:
    loop.flood = 0.0


def _interfering(interference: Interference) -> Act:
    def inject(loop: ClosedLoop, motor: str) -> None:
        loop.unreliable.interference = interference

    return inject


def _noise(loop: ClosedLoop, motor: str) -> None:
    loop.noise = loop.noise_frames


def _quiet(loop: ClosedLoop, motor: str) -> None:
    loop.noise = 0
    loop.unreliable.interference = Interference()


def _commanding(change: Callable[[Setpoints, ClosedLoop], Setpoints | None]) -> Act:
    """From now on the commands are changed so."""

    def inject(loop: ClosedLoop, motor: str) -> None:
        before = loop.command

        def command(now: int) -> Setpoints | None:
            given = before(now)
            return None if given is None else change(given, loop)

        loop.command = command

    return inject


def _nan(given: Setpoints, loop: ClosedLoop) -> Setpoints:
    return replace(given, front_velocity=(given.front_velocity[0], math.nan))


def _infinite(given: Setpoints, loop: ClosedLoop) -> Setpoints:
    return replace(given, front_velocity=(math.inf, given.front_velocity[1]))


def _too_fast(given: Setpoints, loop: ClosedLoop) -> Setpoints:
    return replace(given, front_velocity=(1.5 * loop.rig.config.max_speed * loop.turn, given.front_velocity[1]))


def _too_strong(given: Setpoints, loop: ClosedLoop) -> Setpoints:
    return replace(given, back_effort=(1.1, math.nan))


def _no_kappa(given: Setpoints, loop: ClosedLoop) -> Setpoints:
    return replace(given, kappa=0.5)


def _old(given: Setpoints, loop: ClosedLoop) -> Setpoints:
    return replace(given, stamp_ns=0)


def _stop_nodes(loop: ClosedLoop, motor: str) -> None:
    loop.inject([nmt(NmtCommand.STOP)])


def _reset_node(loop: ClosedLoop, motor: str) -> None:
    loop.inject([nmt(NmtCommand.RESET_NODE, loop.rig.codec.nodes[motor])])


def _second_driver(loop: ClosedLoop, motor: str) -> None:
    codec = loop.rig.codec
    command = codec.pdo("RPDO1", codec.nodes[motor], (0x0F, 0, 0))
    loop.inject([command, heartbeat(loop.rig.config.driver_id, NmtState.OPERATIONAL)])


def _strange_frames(loop: ClosedLoop, motor: str) -> None:
    node = loop.rig.codec.nodes[motor]
    loop.inject([Frame(0x180 + node, b""), Frame(0x180 + node, bytes(3)), Frame(0x700 + node, b"\x99")])


_R = StopReason
_DRIVE = (_R.DRIVE_FAULT, _R.DRIVE_RESTARTED, _R.DRIVE_STATE, _R.DRIVE_SILENT)
_ANY = tuple(StopReason)

CATALOGUE: Final = (
    Fault("drive unplugged", _unplug, _plug, True, ON_THE_BUS, (_R.DRIVE_SILENT,), own=BY_THE_DRIVES),
    Fault("drive without supply", _cut_power, _power, True, ON_THE_BUS, (_R.DRIVE_SILENT,)),
    Fault("drive restarts", _restart, _nothing, True, ON_THE_BUS, _DRIVE),
    Fault("drive restarts unnoticed", _restart_unnoticed, _nothing, True, ON_THE_BUS, _DRIVE),
    Fault("drive lets go", _let_go, _nothing, True, ON_THE_BUS, (_R.DRIVE_STATE,)),
    Fault("drive fault", _fail, _nothing, True, ON_THE_BUS, (_R.DRIVE_FAULT,)),
    Fault("lasting drive fault", _fail_for_long, _mend_drive, True, ON_THE_BUS, (_R.DRIVE_FAULT,)),
    Fault("emergency message", _emergency, _nothing, True, ON_THE_BUS, (_R.DRIVE_FAULT,)),
    Fault("driver hangs", _hang, _wake, True, BY_THE_DRIVES, (_R.OVERRUN,)),
    Fault("driver killed", _hang, _replace_driver, True, BY_THE_DRIVES, (), silent=True),
    Fault("bus down", _down, _up, True, BY_THE_DRIVES, (_R.BUS_LOST, _R.CANNOT_SEND), silent=True),
    Fault("bus-off", _off, _on, True, BY_THE_DRIVES, (_R.BUS_LOST, _R.CANNOT_SEND), silent=True),
    Fault("cable off", _cable_off, _cable_on, True, BY_THE_DRIVES, (_R.DRIVE_SILENT, _R.CANNOT_SEND), silent=True),
    Fault("bus flooded", _flood, _end_flood, True, ON_THE_BUS, (_R.BUS_OVERLOADED, _R.CANNOT_SEND, *_DRIVE)),
    Fault("somebody stops all nodes", _stop_nodes, _nothing, True, ON_THE_BUS, _DRIVE),
    Fault("somebody resets a node", _reset_node, _nothing, True, ON_THE_BUS, _DRIVE),
    Fault("second driver", _second_driver, _nothing, True, ON_THE_BUS, (_R.SECOND_DRIVER,)),
    Fault("command silence", _commanding(lambda *_: None), _nothing, True, ON_THE_BUS, (_R.COMMAND_SILENCE,)),
    Fault("old commands", _commanding(_old), _nothing, True, ON_THE_BUS, (_R.COMMAND_SILENCE,)),
    Fault("NaN commanded", _commanding(_nan), _nothing, True, ON_THE_BUS, (_R.INVALID_COMMAND,)),
    Fault("infinity commanded", _commanding(_infinite), _nothing, True, ON_THE_BUS, (_R.INVALID_COMMAND,)),
    Fault("speed out of range", _commanding(_too_fast), _nothing, True, ON_THE_BUS, (_R.INVALID_COMMAND,)),
    Fault("effort out of range", _commanding(_too_strong), _nothing, True, ON_THE_BUS, (_R.INVALID_COMMAND,)),
    Fault("kappa out of range", _commanding(_no_kappa), _nothing, True, ON_THE_BUS, (_R.INVALID_COMMAND,)),
    Fault("10 % of frames lost", _interfering(Interference(lost=0.1)), _quiet, False, ON_THE_BUS, _ANY),
    Fault("10 % of frames duplicated", _interfering(Interference(duplicated=0.1)), _quiet, False, ON_THE_BUS, _ANY),
    Fault("10 % of frames reordered", _interfering(Interference(reordered=0.1)), _quiet, False, ON_THE_BUS, _ANY),
    Fault("10 % of frames truncated", _interfering(Interference(truncated=0.1)), _quiet, False, ON_THE_BUS, _ANY),
    Fault(
        "all of these together",
        _interfering(Interference(0.1, 0.1, 0.1, 0.1)),
        _quiet,
        False,
        ON_THE_BUS,
        _ANY,
    ),
    Fault("unknown nodes", _noise, _quiet, False, ON_THE_BUS, _ANY),
    Fault("strange frames", _strange_frames, _nothing, False, ON_THE_BUS, _ANY),
)
"""Every fault."""

ON_A_BUS: Final = (
    "drive unplugged",
    "drive without supply",
    "drive lets go",
    "drive fault",
    "emergency message",
    "driver hangs",
    "driver killed",
    "bus down",
    "bus-off",
    "bus flooded",
    "command silence",
    "NaN commanded",
    "speed out of range",
    "10 % of frames lost",
    "10 % of frames duplicated",
    "10 % of frames reordered",
    "10 % of frames truncated",
    "unknown nodes",
)
"""Those in which the bus has a part, and of the others one of each kind: all are tried in time of their own."""

BY_NAME: Final = {fault.name: fault for fault in CATALOGUE}


# ----------------------------------------------------------------------
# Faults made of others: two at once, and those that pass by before anybody may have noticed.
# ----------------------------------------------------------------------


TWO: Final = "two faults at once"
BRIEFLY: Final = "a fault that passes by"

HELD: Final = 0.3
"""A second fault may hold up the ramp that the first began: until the drives go on with it by themselves, s."""

CAN_PASS: Final = tuple(
    BY_NAME[name]
    for name in (
        "drive unplugged",
        "drive without supply",
        "driver hangs",
        "cable off",
        "bus flooded",
        "all of these together",
    )
)
"""Those that can be over soon."""


def two(one: Fault, other: Fault, delay: float) -> Fault:
    """Both, `delay` seconds apart; the one that has to stop the rover comes first."""
    first, second = (one, other) if one.stops or not other.stops else (other, one)

    def inject(loop: ClosedLoop, motor: str) -> None:
        first.inject(loop, motor)
        loop.run(delay)
        second.inject(loop, motor)

    def mend(loop: ClosedLoop, motor: str) -> None:
        for each in (second, first):
            each.mend(loop, motor)

    known = bool(first.reasons and second.reasons)
    return Fault(
        f"{first.name}, then {second.name}",
        inject,
        mend,
        first.stops,
        max(first.within, second.within),
        (*first.reasons, *second.reasons) if known else (),
        own=max(first.own, second.own),
        held=HELD + delay,
        group=TWO,
    )


def briefly(fault: Fault, time: float) -> Fault:
    """A fault that is over after `time` seconds: the rover stops as it must for the fault, or goes on."""

    def inject(loop: ClosedLoop, motor: str) -> None:
        fault.inject(loop, motor)
        loop.run(time)
        fault.mend(loop, motor)

    return replace(
        fault,
        name=f"{fault.name} for {time:.3f} s",
        inject=inject,
        mend=lambda loop, motor: None,
        stops=False,
        reasons=(),
        held=HELD,
        silent=False,
        group=BRIEFLY,
    )
