"""CiA 301's services: what their frames say, how they are read, and how they are made.

Readers take the data of a frame with their service's identifier and never raise: what is not as it should be is
:class:`Malformed`, with the reason.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from artibot_driver.emcy import error_text, register_text


class NmtState(enum.IntEnum):
    """State of a node, as its heartbeat reports it."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(enum.IntEnum):
    """What the master can tell nodes."""

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


class Unknown(NamedTuple):
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
