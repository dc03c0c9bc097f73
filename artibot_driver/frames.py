"""CiA 301's services: what their frames say, how they are read and made, and emergency codes in words.

Readers take the data of a frame with their service's identifier and never raise: what is not as it should be is
:class:`Malformed`, with the reason.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

# ----------------------------------------------------------------------
# Emergency messages in words: error codes of CiA 301 and CiA 402, and the bits of the error register (1001h).
# ----------------------------------------------------------------------


ERRORS: Final = {
    0x0000: "no error, or errors reset",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current on the input side",
    0x2110: "short circuit or earth leakage, input side",
    0x2120: "earth leakage, input side",
    0x2130: "short circuit, input side",
    0x2200: "current inside the device",
    0x2211: "over-current inside the device, 1",
    0x2212: "over-current inside the device, 2",
    0x2213: "over-current in a ramp",
    0x2214: "over-current in a sequence",
    0x2220: "continuous over-current inside the device",
    0x2230: "short circuit or earth leakage inside the device",
    0x2240: "earth leakage inside the device",
    0x2250: "short circuit inside the device",
    0x2300: "current on the output side",
    0x2310: "continuous over-current, motor side",
    0x2320: "short circuit or earth leakage, motor side",
    0x2330: "earth leakage, motor side",
    0x2340: "short circuit, motor side",
    0x2350: "load too high (I²t, thermal state)",
    0x2351: "load high, a warning (I²t, thermal state)",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3200: "DC link voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3230: "load error",
    0x3300: "output voltage",
    0x3310: "output over-voltage",
    0x3320: "armature circuit",
    0x3330: "field circuit",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4110: "ambient temperature too high",
    0x4120: "ambient temperature too low",
    0x4200: "temperature of the device",
    0x4210: "device too hot",
    0x4220: "device too cold",
    0x4300: "temperature of the drive",
    0x4310: "drive too hot",
    0x4320: "drive too cold",
    0x4400: "temperature of the supply",
    0x5000: "device hardware",
    0x5100: "supply of the electronics",
    0x5110: "supply of the electronics, low voltage",
    0x5200: "control hardware",
    0x5210: "measuring circuit",
    0x5220: "computing circuit",
    0x5300: "operating unit",
    0x5400: "power section",
    0x5410: "output stages",
    0x5420: "brake chopper",
    0x5430: "input stages",
    0x5440: "contacts",
    0x5450: "fuses",
    0x5500: "data storage",
    0x5510: "working memory",
    0x5520: "program memory",
    0x5530: "non-volatile memory",
    0x6000: "device software",
    0x6010: "software reset by the watchdog",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data record",
    0x6310: "parameters lost",
    0x6320: "parameter error",
    0x7000: "additional modules",
    0x7100: "additional modules, power",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7122: "motor error or wrong commutation",
    0x7123: "motor tilted",
    0x7200: "measuring circuit of an additional module",
    0x7300: "sensor",
    0x7301: "tachometer",
    0x7302: "tachometer, wrong polarity",
    0x7303: "resolver 1",
    0x7304: "resolver 2",
    0x7305: "incremental encoder 1",
    0x7306: "incremental encoder 2",
    0x7310: "speed sensor",
    0x7320: "position sensor",
    0x7400: "computing circuit of an additional module",
    0x7500: "communication of an additional module",
    0x7600: "data storage of an additional module",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun, messages lost",
    0x8120: "CAN error passive",
    0x8130: "heartbeat or life guarding missed",
    0x8140: "recovered from bus-off",
    0x8150: "CAN identifier collision",
    0x8200: "protocol",
    0x8210: "PDO too short, not processed",
    0x8220: "PDO too long",
    0x8230: "multiplexed PDO not processed, destination missing",
    0x8240: "SYNC of unexpected length",
    0x8250: "RPDO timeout",
    0x8300: "torque control",
    0x8311: "torque too high",
    0x8312: "difficult start-up",
    0x8313: "standstill torque",
    0x8321: "torque too low",
    0x8331: "torque fault",
    0x8400: "velocity controller",
    0x8500: "position controller",
    0x8600: "positioning",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "synchronisation",
    0x8800: "winding",
    0x8900: "process data monitoring",
    0x8A00: "control monitoring",
    0x9000: "external error",
    0xF000: "additional functions",
    0xF001: "deceleration",
    0xF002: "sub-synchronous run",
    0xF003: "stroke operation",
    0xF004: "control of an additional function",
    0xFF00: "manufacturer's own",
}
"""Error code → words; a code that is not here has those of its group."""

REGISTER: Final = (
    "generic",
    "current",
    "voltage",
    "temperature",
    "communication",
    "profile",
    "reserved",
    "manufacturer",
)
"""Bits of the error register, lowest first."""


def error_text(code: int) -> str:
    """An error code in words: ``8130h heartbeat or life guarding missed``.

    Codes between those of the standards are named after their group, the nearest code with zeros at the end.
    """
    for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000):
        if code & mask in ERRORS and (mask == 0xFFFF or code & mask):
            return f"{code:04X}h {ERRORS[code & mask]}"
    return f"{code:04X}h " + (ERRORS[0] if code < 0x100 else "reserved")


def register_text(register: int) -> str:
    """The error register in words: ``generic, communication``, or ``none``."""
    return ", ".join(name for bit, name in enumerate(REGISTER) if register >> bit & 1) or "none"


# ----------------------------------------------------------------------
# CiA 301's services: what their frames say, how they are read, and how they are made.
# ----------------------------------------------------------------------


class NmtState(enum.IntEnum):
    """State of a node, as its heartbeat reports it."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(enum.IntEnum):
    """What the master can command nodes."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class Frame(NamedTuple):
    """A CAN frame to send: 11-bit identifier and data."""

    can_id: int
    data: bytes


class Sync(NamedTuple):
    """SYNC, with its counter where it has one."""

    counter: int | None


class Nmt(NamedTuple):
    """A command of the master; node 0 means all."""

    command: NmtCommand
    node: int


class Heartbeat(NamedTuple):
    """A node's sign of life."""

    node: int
    state: NmtState


class Emcy(NamedTuple):
    """An emergency message; `data` are the manufacturer's five bytes."""

    node: int
    code: int
    register: int
    data: bytes

    @property
    def text(self) -> str:
        """What it says, in words."""
        return f"{error_text(self.code)} (error register: {register_text(self.register)})"


@dataclass(frozen=True)
class Sdo:
    """One frame of an SDO transfer; index and subindex are None in those that carry none.

    `data` are the last four bytes where there is an index (an abort code, or what is written or read), else all but
    the first.
    """

    node: int
    request: bool
    service: str
    index: int | None
    subindex: int | None
    data: bytes


class UnknownFrame(NamedTuple):
    """A frame that is none of ours."""

    reason: str


class Malformed(NamedTuple):
    """A frame of one of our services that is not as it should be; node 0 where it has none."""

    node: int
    reason: str


Service = Sync | Nmt | Heartbeat | Emcy | Sdo
"""A frame of one of CiA 301's services, read."""

Reader = Callable[[bytes], Service | Malformed]

_REQUESTS = ("download segment", "download", "upload", "upload segment", "abort", "block upload", "block download")
_RESPONSES = ("upload segment", "download segment", "upload", "download", "abort", "block download", "block upload")
_WITH_INDEX = ("download", "upload", "abort")

_EMCY = struct.Struct("<HB5s")
_SDO = struct.Struct("<BHB4s")
NODES: Final = range(1, 128)
"""Node ids that there can be."""

HEARTBEAT_BASE, SDO_REQUEST, SDO_RESPONSE = 0x700, 0x600, 0x580
_NMT_STATES: Final = {int(state): state for state in NmtState}
_NMT_COMMANDS: Final = {int(command): command for command in NmtCommand}


def nmt(command: NmtCommand, node: int = 0) -> Frame:
    """A command of the master to one node, or to all (0)."""
    return Frame(0, bytes((command, node)))


def heartbeat(node: int, state: NmtState) -> Frame:
    """A node's sign of life."""
    return Frame(HEARTBEAT_BASE + node, bytes((state,)))


def emcy(base: int, node: int, code: int, register: int, data: bytes = b"") -> Frame:
    """An emergency message of a node; `base` is its identifier less the node's id."""
    return Frame(base + node, _EMCY.pack(code, register, data))


def wrong_length(node: int, what: str, data: bytes, expected: str) -> Malformed:
    return Malformed(node, f"{what} of {len(data)} bytes, expected {expected}")


def read_sync(data: bytes) -> Service | Malformed:
    if not data:
        return Sync(None)
    return Sync(data[0]) if len(data) == 1 else wrong_length(0, "SYNC", data, "0, or 1 with a counter")


def read_nmt(data: bytes) -> Service | Malformed:
    if len(data) != 2:
        return wrong_length(0, "NMT", data, "2")
    command = _NMT_COMMANDS.get(data[0])
    if command is None or data[1] > NODES[-1]:
        return Malformed(0, f"NMT command {data[0]} for node {data[1]}; expected 1, 2, 128, 129 or 130 for 0 to 127")
    return Nmt(command, data[1])


def heartbeat_reader(node: int) -> Reader:
    def read(data: bytes) -> Service | Malformed:
        state = _NMT_STATES.get(data[0]) if len(data) == 1 else None
        if state is None:
            return Malformed(node, f"heartbeat {data.hex() or 'without data'}; expected one byte, 0, 4, 5 or 127")
        return Heartbeat(node, state)

    return read


def emcy_reader(node: int) -> Reader:
    def read(data: bytes) -> Service | Malformed:
        if len(data) != 8:
            return wrong_length(node, "EMCY", data, "8")
        return Emcy(node, *_EMCY.unpack(data))

    return read


def sdo_reader(node: int, request: bool) -> Reader:
    services = _REQUESTS if request else _RESPONSES

    def read(data: bytes) -> Service | Malformed:
        if len(data) != 8:
            return wrong_length(node, "SDO", data, "8")
        specifier = data[0] >> 5
        if specifier >= len(services):
            return Malformed(node, f"SDO command {data[0]:#04x}; none of CiA 301 begins so")
        service = services[specifier]
        if service not in _WITH_INDEX:
            return Sdo(node, request, service, None, None, data[1:])
        _, index, subindex, rest = _SDO.unpack(data)
        return Sdo(node, request, service, index, subindex, rest)

    return read
