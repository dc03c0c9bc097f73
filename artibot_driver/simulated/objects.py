"""The object dictionary of a simulated drive: its values, what may be written, and the SDO server that gives access."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from canopen.objectdictionary import ObjectDictionary, ODVariable

from artibot_driver.dictionary import FORMATS, NO_REMOTE_FRAME

# ----------------------------------------------------------------------
# The object dictionary of a simulated drive: its values, and what may be written to it.
# ----------------------------------------------------------------------


NO_OBJECT: Final = 0x06020000
NO_SUBINDEX: Final = 0x06090011
READ_ONLY: Final = 0x06010002
WRITE_ONLY: Final = 0x06010001
NOT_MAPPABLE: Final = 0x06040041
PDO_TOO_LONG: Final = 0x06040042
WRONG_LENGTH: Final = 0x06070010
INVALID_VALUE: Final = 0x06090030
TOO_HIGH: Final = 0x06090031
TOO_LOW: Final = 0x06090032
NOT_NOW: Final = 0x08000022

Key = tuple[int, int]
"""Index and subindex."""

_DISABLED = 1 << 31


class Abort(Exception):
    """An access that the drive refuses; `code` is CiA 301's SDO abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort {code:#010x}")
        self.code = code


class PdoSetup(NamedTuple):
    """Identifier, layout and objects of a PDO."""

    cob_id: int
    packing: struct.Struct
    keys: tuple[Key, ...]


class Objects:
    """Values of all objects, as integers (texts as bytes).

    Parameters
    ----------
    dictionary : ObjectDictionary
        The EDS, read for this drive's node id.
    commissioned : mapping of (index, subindex) to int
        What a real drive's maker or owner has set for good: motor and encoder data.
    """

    def __init__(self, dictionary: ObjectDictionary, commissioned: Mapping[Key, int]) -> None:
        self._variables = _variables(dictionary)
        self._rpdos = tuple(index for index in range(0x1400, 0x1600) if index in dictionary)
        self._commissioned = dict(commissioned)
        self._hooks: dict[Key, Callable[[int], None]] = {}
        self._pdos: dict[int, PdoSetup | None] = {}  # as they are set up: each is asked for with every SYNC
        self._receivers: dict[int, tuple[int, ...]] | None = None
        self.values: dict[Key, int] = {}
        self.texts: dict[Key, bytes] = {}
        self.reset()

    def reset(self, communication_only: bool = False) -> None:
        """All objects, or those of communication (1000h to 1FFFh), as after power on."""
        self._forget_pdos()
        for key, variable in self._variables.items():
            if communication_only and not 0x1000 <= key[0] < 0x2000:
                continue
            if isinstance(variable.default, str):
                self.texts[key] = variable.default.encode("ascii")
            else:
                self.values[key] = self._commissioned.get(key, variable.default or 0)

    def on_write(self, index: int, hook: Callable[[int], None], subindex: int = 0) -> None:
        """Have `hook` called with every value written to an object, before it is stored; it may raise Abort."""
        self._hooks[index, subindex] = hook

    def variable(self, key: Key) -> ODVariable:
        """The EDS's entry of an object; raises :class:`Abort` where there is none."""
        found = self._variables.get(key)
        if found is None:
            known = any(index == key[0] for index, _ in self._variables)
            raise Abort(NO_SUBINDEX if known else NO_OBJECT)
        return found

    def read(self, key: Key) -> bytes:
        """An object's bytes, as an SDO upload gives them; raises :class:`Abort`."""
        variable = self.variable(key)
        if not variable.readable:
            raise Abort(WRITE_ONLY)
        if key in self.texts:
            return self.texts[key]
        return struct.pack(f"<{_format(variable)}", self.values[key])

    def size(self, key: Key) -> int:
        """Bytes of a number; raises :class:`Abort` where there is none."""
        return struct.calcsize(f"<{_format(self.variable(key))}")

    def write(self, key: Key, data: bytes) -> None:
        """Take an object's bytes, as an SDO download brings them; raises :class:`Abort`."""
        variable = self.variable(key)
        if not variable.writable:
            raise Abort(READ_ONLY)
        packing = struct.Struct(f"<{_format(variable)}")
        if len(data) != packing.size:
            raise Abort(WRONG_LENGTH)
        self.assign(key, packing.unpack(data)[0])

    def assign(self, key: Key, value: int) -> None:
        """Store a value that came from outside, after its limits and its hook; raises :class:`Abort`."""
        variable = self._variables[key]
        if variable.max is not None and value > variable.max:
            raise Abort(TOO_HIGH)
        if variable.min is not None and value < variable.min:
            raise Abort(TOO_LOW)
        if 0x1400 <= key[0] < 0x1C00:
            self._check_pdo(key, value)
            self._forget_pdos()
        hook = self._hooks.get(key)
        if hook is not None:
            hook(value)
        self.values[key] = value

    def _check_pdo(self, key: Key, value: int) -> None:
        """CiA 301's order: a PDO is switched off, then its mapping emptied, then filled, counted and switched on."""
        index, subindex = key
        is_mapping = bool(index & 0x200)
        communication = (index & ~0x200, 1)
        if not is_mapping:
            enabled = subindex == 1 and not value & _DISABLED
            if enabled and not 0x180 <= value & ~NO_REMOTE_FRAME <= 0x57F:
                raise Abort(INVALID_VALUE)
            return
        if not self.values[communication] & _DISABLED or (subindex and self.values[index, 0]):
            raise Abort(NOT_NOW)
        words = [value] if subindex else [self.values[index, k] for k in range(1, value + 1)]
        if sum(self._mapped_bits(word, index < 0x1800) for word in words if word or not subindex) > 64:
            raise Abort(PDO_TOO_LONG)

    def _mapped_bits(self, word: int, received: bool) -> int:
        """Bits of an object in a PDO; raises :class:`Abort` where it cannot be mapped so."""
        variable = self._variables.get((word >> 16, word >> 8 & 0xFF))
        if variable is None or not variable.pdo_mappable or word & 0xFF != len(variable):
            raise Abort(NOT_MAPPABLE)
        if received and not variable.writable:
            raise Abort(NOT_MAPPABLE)
        return word & 0xFF

    def pdo(self, communication: int) -> PdoSetup | None:
        """A PDO as it is set up now; None where it is off or empty."""
        if communication not in self._pdos:
            self._pdos[communication] = self._pdo(communication)
        return self._pdos[communication]

    def receivers(self, can_id: int) -> tuple[int, ...]:
        """Communication objects (1400h on) of the PDOs that a frame with this identifier is for, as set up now."""
        if self._receivers is None:
            self._receivers = {}
            for communication in self._rpdos:
                found = self.pdo(communication)
                if found is not None:
                    before = self._receivers.get(found.cob_id, ())
                    self._receivers[found.cob_id] = (*before, communication)
        return self._receivers.get(can_id, ())

    def _forget_pdos(self) -> None:
        self._pdos.clear()
        self._receivers = None

    def _pdo(self, communication: int) -> PdoSetup | None:
        cob_id, mapping = self.values[communication, 1], communication + 0x200
        words = [self.values[mapping, k] for k in range(1, self.values[mapping, 0] + 1)]
        if cob_id & _DISABLED or not words:
            return None
        keys = tuple((word >> 16, word >> 8 & 0xFF) for word in words)
        return PdoSetup(
            cob_id & ~NO_REMOTE_FRAME,
            struct.Struct("<" + "".join(_format(self._variables[key]) for key in keys)),
            keys,
        )


def _variables(dictionary: ObjectDictionary) -> dict[Key, ODVariable]:
    found: dict[Key, ODVariable] = {}
    for entry in dictionary.values():
        parts = [entry] if isinstance(entry, ODVariable) else list(entry.values())
        found |= {(part.index, part.subindex): part for part in parts}
    return found


def _format(variable: ODVariable) -> str:
    letter = FORMATS.get(variable.data_type or 0)
    if letter is None:
        raise Abort(WRONG_LENGTH)  # texts are read only: none gets here but by a wrong EDS
    return letter


# ----------------------------------------------------------------------
# The SDO server of a simulated drive (CiA 301): expedited transfers, and segmented reading of texts.
# ----------------------------------------------------------------------


_HEAD = struct.Struct("<BHB")
_DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORT, _BLOCK_UPLOAD = 1, 2, 3, 4, 5

NO_SUCH_COMMAND: Final = 0x05040001
TOGGLE_WRONG: Final = 0x05030000


class SdoServer:
    """Answers a client's requests from a drive's objects."""

    def __init__(self, objects: Objects) -> None:
        self._objects = objects
        self._key = (0, 0)
        self._rest: bytes | None = None
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """The eight bytes to answer a request with; None where none is due."""
        if len(request) != 8:
            return None
        specifier = request[0] >> 5
        if specifier == _ABORT:
            self._rest = None
            return None
        try:
            if specifier == _UPLOAD_SEGMENT:
                return self._next_segment(request[0])
            _, index, subindex = _HEAD.unpack_from(request)
            self._key, self._rest = (index, subindex), None
            if specifier == _DOWNLOAD and request[0] & 0x02:
                return self._download(request)
            if specifier == _UPLOAD or (specifier == _BLOCK_UPLOAD and self._may_switch(request)):
                return self._upload()
            raise Abort(NO_SUCH_COMMAND)
        except Abort as refusal:
            self._rest = None
            return _HEAD.pack(0x80, *self._key) + struct.pack("<I", refusal.code)

    def _may_switch(self, request: bytes) -> bool:
        """Whether a block upload that is begun may be answered by an ordinary one.

        CiA 301 allows that where the object has no more bytes than the protocol switch threshold, byte 5 of the
        request; with a threshold of 0 never.
        """
        begins, threshold = request[0] & 3 == 0, request[5]
        return begins and 0 < len(self._objects.read(self._key)) <= threshold

    def _download(self, request: bytes) -> bytes:
        said = request[0] & 1  # a client need not say the size: then it is the object's own
        length = 4 - (request[0] >> 2 & 3) if said else self._objects.size(self._key)
        self._objects.write(self._key, request[4 : 4 + length])
        return _HEAD.pack(0x60, *self._key) + bytes(4)

    def _upload(self) -> bytes:
        data = self._objects.read(self._key)
        if 0 < len(data) <= 4:
            return _HEAD.pack(0x43 | (4 - len(data)) << 2, *self._key) + data.ljust(4, b"\0")
        self._rest, self._toggle = data, 0
        return _HEAD.pack(0x41, *self._key) + struct.pack("<I", len(data))

    def _next_segment(self, command: int) -> bytes:
        if self._rest is None:
            raise Abort(NO_SUCH_COMMAND)
        if command & 0x10 != self._toggle:
            raise Abort(TOGGLE_WRONG)
        part, rest = self._rest[:7], self._rest[7:]
        head = self._toggle | (7 - len(part)) << 1 | (not rest)
        self._rest, self._toggle = rest or None, self._toggle ^ 0x10
        return bytes((head,)) + part.ljust(7, b"\0")
