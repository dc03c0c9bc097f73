"""The drives' object dictionary: an EDS file read by canopen, and the PDOs that it maps."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from configparser import Error as ConfigParserError
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from canopen.objectdictionary import ObjectDictionary, ODVariable, datatypes, import_od

from artibot_sim.errors import ArtibotError
from artibot_sim.resources import config_names, config_path

FORMATS: Final = {
    datatypes.BOOLEAN: "?",
    datatypes.INTEGER8: "b",
    datatypes.INTEGER16: "h",
    datatypes.INTEGER32: "i",
    datatypes.INTEGER64: "q",
    datatypes.UNSIGNED8: "B",
    datatypes.UNSIGNED16: "H",
    datatypes.UNSIGNED32: "I",
    datatypes.UNSIGNED64: "Q",
}
"""Data types that a PDO can hold here, as struct's format letters; all are whole bytes."""

PDO_LENGTH: Final = 8
"""Bytes that a PDO has at most."""

_DISABLED, _FRAME_29_BIT, _ID = 1 << 31, 1 << 29, 0x7FF

NO_REMOTE_FRAME: Final = 1 << 30
"""Bit of a PDO's COB-ID that says nothing about the identifier: no remote frame is answered (TPDO), reserved (RPDO)."""


@dataclass(frozen=True)
class Field:
    """One object in a PDO."""

    index: int
    subindex: int
    name: str
    """Its ParameterName in lower case with underscores: ``velocity_actual_value``."""
    bits: int
    signed: bool
    format: str

    @property
    def range(self) -> tuple[int, int]:
        """Smallest and largest integer that it holds."""
        low = -(1 << self.bits - 1) if self.signed else 0
        return low, low + (1 << self.bits) - 1

    @property
    def key(self) -> str:
        """Index and subindex as manuals print them: ``606Ch`` or ``608Fh:1``."""
        return f"{self.index:04X}h" + (f":{self.subindex}" if self.subindex else "")


@dataclass(frozen=True)
class PdoMap:
    """One PDO as the dictionary maps it.

    Attributes
    ----------
    name : str
        ``RPDO1`` (to the drive), ``TPDO2`` (from it).
    cob_id : int
        CAN identifier, without the node's id where `relative`.
    fields : tuple of Field
        In the order of their bytes, little endian.
    flags : int
        Bits of the COB-ID beside the identifier that the EDS sets: :data:`NO_REMOTE_FRAME` or 0.
    """

    name: str
    cob_id: int
    relative: bool
    fields: tuple[Field, ...]
    flags: int = 0

    @cached_property
    def to_drive(self) -> bool:
        """Whether the drives receive it."""
        return self.name.startswith("R")

    @cached_property
    def packing(self) -> struct.Struct:
        """The layout of its bytes."""
        return struct.Struct("<" + "".join(field.format for field in self.fields))

    @cached_property
    def position(self) -> dict[str, int]:
        """Field's name → its position among the values."""
        return {field.name: k for k, field in enumerate(self.fields)}

    @cached_property
    def objects(self) -> tuple[int | None, ...]:
        """Index of each field; None for a part of an object that has several."""
        return tuple(field.index if field.subindex == 0 else None for field in self.fields)

    def id_of(self, node: int) -> int:
        """CAN identifier of a node's PDO."""
        return self.cob_id + (node if self.relative else 0)


def load_dictionary(eds: str | os.PathLike[str] = "drive", node: int = 0) -> ObjectDictionary:
    """Read an EDS file.

    Parameters
    ----------
    eds : str or path
        A name (``"drive"``: the file shipped with artibot) or the path of an EDS.
    node : int
        Node id that ``$NODEID`` stands for; with 0 identifiers are relative.

    Raises
    ------
    ArtibotError
        Naming the file, what was found and the mend.
    """
    path = _find(eds)
    try:
        with open(path, encoding="utf-8") as stream:
            dictionary = import_od(stream, node)
    except OSError as error:
        raise ArtibotError(f"{path}: cannot be read: {error.strerror}") from error
    except (ConfigParserError, UnicodeDecodeError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise ArtibotError(f"{path}: not an EDS file: {reason}; give the drive's electronic data sheet") from error
    if 0x6040 not in dictionary or 0x6041 not in dictionary:
        raise ArtibotError(f"{path}: has no objects 6040h and 6041h; expected the EDS of a CiA 402 drive")
    return dictionary


def _find(eds: str | os.PathLike[str]) -> Path:
    text = os.fspath(eds)
    path = Path(text)
    if path.suffix.lower() in (".eds", ".dcf") or os.sep in text:
        return path
    if text not in config_names("eds"):
        names = ", ".join(config_names("eds"))
        raise ArtibotError(f"eds '{text}': unknown; expected one of {names} or the path of an EDS file")
    return config_path("eds", text)


def pdo_maps(dictionary: ObjectDictionary) -> tuple[PdoMap, ...]:
    """All enabled PDOs of a dictionary read for node 0 that map anything, RPDOs first.

    Raises
    ------
    ArtibotError
        Where a mapping names an object that is not there, cannot be mapped, or does not fit.
    """
    return tuple(_pdo_maps(dictionary))


def _pdo_maps(dictionary: ObjectDictionary) -> Iterator[PdoMap]:
    for letter, communication in (("R", 0x1400), ("T", 0x1800)):
        for number in range(512):
            if communication + number not in dictionary:
                continue
            identifier = _entry(dictionary, communication + number, 1)
            cob_id = _default(identifier)
            if cob_id & _DISABLED:
                continue
            name = f"{letter}PDO{number + 1}"
            if cob_id & _FRAME_29_BIT or not 0x180 <= cob_id & _ID <= 0x57F:
                raise ArtibotError(
                    f"{communication + number:04X}h:1: {name} has identifier {cob_id:#x}; "
                    "expected an 11-bit one from 0x180 to 0x57F"
                )
            fields = tuple(_fields(dictionary, communication + 0x200 + number, name))
            if not fields:
                continue  # CiA 301: a PDO that maps nothing is none, though its identifier may be enabled
            yield PdoMap(name, cob_id & _ID, _is_relative(identifier), fields, cob_id & NO_REMOTE_FRAME)


def _is_relative(variable: ODVariable) -> bool:
    """Whether the EDS adds the node's id, however it spells ``$NODEID``; canopen knows capital letters only."""
    return "$NODEID" in str(getattr(variable, "default_raw", "")).upper() or bool(variable.relative)


def _fields(dictionary: ObjectDictionary, mapping: int, name: str) -> Iterator[Field]:
    total, names = 0, set()
    for subindex in range(1, _default(_entry(dictionary, mapping, 0)) + 1):
        where = f"{mapping:04X}h:{subindex}"
        word = _default(_entry(dictionary, mapping, subindex))
        field = _field(dictionary, word, f"{where}: {name}")
        total += field.bits
        if total > 8 * PDO_LENGTH:
            raise ArtibotError(f"{where}: {name} maps {total} bits; expected at most {8 * PDO_LENGTH}")
        if field.name in names:
            raise ArtibotError(f"{where}: {name} maps '{field.name}' twice; expected each object once")
        names.add(field.name)
        yield field


def _field(dictionary: ObjectDictionary, word: int, where: str) -> Field:
    """The field that a mapping entry (index, subindex, bits in one word) stands for."""
    index, subindex, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
    variable = _entry(dictionary, index, subindex, where)
    letter = FORMATS.get(variable.data_type or 0)
    if letter is None or bits != 8 * struct.calcsize(f"<{letter}"):
        raise ArtibotError(
            f"{where} maps {bits} bits of {index:04X}h '{variable.name}', which has data type "
            f"{variable.data_type}; expected a whole number of 8, 16, 32 or 64 bits"
        )
    if not variable.pdo_mappable:
        raise ArtibotError(f"{where} maps {index:04X}h '{variable.name}', whose PDOMapping is 0; expected 1")
    return Field(index, subindex, identifier_name(variable.name), bits, letter.islower(), letter)


def _entry(dictionary: ObjectDictionary, index: int, subindex: int, where: str = "") -> ODVariable:
    where = where or f"{index:04X}h:{subindex}"
    if index not in dictionary:
        raise ArtibotError(f"{where}: object {index:04X}h is not in the EDS; add it or change the mapping")
    entry = dictionary[index]
    if isinstance(entry, ODVariable):
        return entry
    if subindex not in entry:
        raise ArtibotError(f"{where}: object {index:04X}h has no subindex {subindex} in the EDS")
    return entry[subindex]


def _default(variable: ODVariable) -> int:
    value = variable.value if variable.value is not None else variable.default
    if not isinstance(value, int):
        raise ArtibotError(f"{variable.index:04X}h:{variable.subindex}: the EDS gives no DefaultValue; add it")
    return value


def identifier_name(name: str) -> str:
    """A ParameterName as one lower-case word: ``Velocity actual value`` → ``velocity_actual_value``."""
    return re.sub(r"[^0-9a-z]+", "_", name.lower()).strip("_")
