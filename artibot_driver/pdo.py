"""Frames ↔ what they mean: PDOs through the drives' object dictionary, and CiA 301's services around them.

:meth:`Codec.decode` takes any frame that a bus can carry and never raises: what is none of ours is
:class:`UnknownFrame`, what ours should look like and does not is :class:`Malformed`, with the reason.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

from canopen.objectdictionary import ObjectDictionary

from artibot_driver import frames
from artibot_driver.dictionary import PdoMap, pdo_maps
from artibot_driver.frames import Frame, Malformed, Service, UnknownFrame
from artibot_sim.errors import ArtibotError


class Pdo(NamedTuple):
    """A PDO of one of our nodes; `values` are integers in the order of ``map.fields``."""

    node: int
    map: PdoMap
    values: tuple[int, ...]

    def value(self, name: str) -> int:
        """The integer of a field: ``pdo.value("statusword")``."""
        return self.values[self.map.position[name]]


Decoded = Pdo | Service


class FrameMessage(Protocol):
    """What is asked of a frame; python-can's Message has it."""

    arbitration_id: int
    data: bytearray
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool
    is_fd: bool


_Reader = Callable[[bytes], Decoded | Malformed]


class Codec:
    """Encodes and decodes the frames of a bus.

    Parameters
    ----------
    dictionary : ObjectDictionary
        The drives' EDS, read for node 0.
    nodes : mapping of str to int
        Motor → node id, for the nodes that PDOs are exchanged with.

    Raises
    ------
    ArtibotError
        Where the EDS maps something that cannot be, or two services share an identifier.
    """

    def __init__(self, dictionary: ObjectDictionary, nodes: Mapping[str, int]) -> None:
        self.nodes = dict(nodes)
        self.maps = {each.name: each for each in pdo_maps(dictionary)}
        self.sync_id = _identifier(dictionary, 0x1005, 0x80)
        self.emcy_base = _identifier(dictionary, 0x1014, 0x80)
        self._readers: dict[int, _Reader] = {}
        self._add("NMT", 0, frames.read_nmt)
        self._add("SYNC", self.sync_id, frames.read_sync)
        for node in frames.NODES:
            self._add("EMCY", self.emcy_base + node, frames.emcy_reader(node))
            self._add("heartbeat", frames.HEARTBEAT_BASE + node, frames.heartbeat_reader(node))
            self._add("SDO", frames.SDO_REQUEST + node, frames.sdo_reader(node, True))
            self._add("SDO", frames.SDO_RESPONSE + node, frames.sdo_reader(node, False))
        for motor, node in self.nodes.items():
            for each in self.maps.values():
                self._add(f"{each.name} of {motor}", each.id_of(node), _pdo_reader(node, each))

    def _add(self, what: str, can_id: int, reader: _Reader) -> None:
        if can_id in self._readers:
            raise ArtibotError(f"{what}: identifier {can_id:#05x} is taken; change node ids or the EDS's COB-IDs")
        self._readers[can_id] = reader

    def knows(self, can_id: int) -> bool:
        """Whether a data frame with this 11-bit identifier is one of ours."""
        return can_id in self._readers

    def decode(self, can_id: int, data: bytes) -> Decoded | UnknownFrame | Malformed:
        """What a data frame with an 11-bit identifier says; never raises."""
        reader = self._readers.get(can_id)
        if reader is None:
            return UnknownFrame(f"identifier {can_id:#05x} is none of ours")
        return reader(data)

    def decode_message(self, message: FrameMessage) -> Decoded | UnknownFrame | Malformed:
        """What any frame says, also an extended, remote, CAN FD or error frame; never raises."""
        if message.is_error_frame:
            return UnknownFrame("error frame")
        if message.is_extended_id or message.is_remote_frame or message.is_fd:
            kind = "extended" if message.is_extended_id else "remote" if message.is_remote_frame else "CAN FD"
            return UnknownFrame(f"{kind} frame {message.arbitration_id:#05x}; CANopen has only plain ones")
        return self.decode(message.arbitration_id, bytes(message.data))

    def pdo(self, name: str, node: int, values: Sequence[int] | Mapping[str, int]) -> Frame:
        """A PDO as a frame.

        Parameters
        ----------
        name : str
            ``RPDO1``, …
        node : int
            Node id.
        values : sequence of int, or mapping by field name
            All of the PDO's fields.

        Raises
        ------
        ArtibotError
            For a PDO that is not mapped, a field that is missing or too much, or a value that does not fit.
        """
        each = self.maps.get(name)
        if each is None:
            raise ArtibotError(f"PDO '{name}': not mapped in the EDS; expected one of {', '.join(self.maps)}")
        try:
            ordered = [values[field.name] for field in each.fields] if isinstance(values, Mapping) else values
            if len(values) == len(each.fields):
                return Frame(each.id_of(node), each.packing.pack(*ordered))
        except (struct.error, KeyError):
            pass
        raise ArtibotError(_why_not(each, values))

    def sync(self) -> Frame:
        """SYNC, without a counter."""
        return Frame(self.sync_id, b"")

    def emcy(self, node: int, code: int, register: int, data: bytes = b"") -> Frame:
        """An emergency message of a node."""
        return frames.emcy(self.emcy_base, node, code, register, data)


def _identifier(dictionary: ObjectDictionary, index: int, default: int) -> int:
    """An 11-bit identifier that the EDS gives, less the node's id."""
    value = getattr(dictionary[index], "default", None) if index in dictionary else None
    return value & 0x7FF if isinstance(value, int) else default


def _why_not(each: PdoMap, values: Sequence[int] | Mapping[str, int]) -> str:
    expected = ", ".join(f"{field.name} ({field.range[0]} to {field.range[1]})" for field in each.fields)
    return f"{each.name}: found {values!r}, expected {expected}"


def _pdo_reader(node: int, each: PdoMap) -> _Reader:
    packing, size = each.packing, each.packing.size

    def read(data: bytes) -> Decoded | Malformed:
        if len(data) != size:
            mapping = "EDS and the drive's own mapping differ, or the frame was cut"
            return frames.wrong_length(node, each.name, data, f"{size}: {mapping}")
        return Pdo(node, each, packing.unpack(data))

    return read
