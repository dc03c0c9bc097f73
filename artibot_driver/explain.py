"""What frames say, in words and SI units, as lines, JSON and CSV: the drive, the service or PDO, and its objects.

Nothing here raises: a frame that is none of ours, or not as it should be, is explained as such.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple, Protocol

from canopen.objectdictionary import ODVariable, datatypes
from canopen.sdo.exceptions import SdoAbortedError

from artibot_driver.bus import read_error_classes
from artibot_driver.cia402 import OperationMode, command_of, state_of
from artibot_driver.dictionary import FORMATS, identifier_name
from artibot_driver.frames import Emcy, Heartbeat, Malformed, Nmt, Sdo, Sync, UnknownFrame, error_text, register_text
from artibot_driver.pdo import Pdo
from artibot_driver.rig import Rig

# ----------------------------------------------------------------------
# What frames say, in words and SI units: the drive that each belongs to, the service or PDO, and the objects in
# it.
# ----------------------------------------------------------------------


KINDS: Final = ("rpdo", "tpdo", "sync", "nmt", "heartbeat", "emcy", "sdo", "error", "malformed", "other")
"""Kinds of frames; `other` are those of other protocols and nodes."""

ALL, DRIVER, NOBODY = "all", "driver", "-"


class AnyFrame(Protocol):
    """What is asked of a frame; a recording's have it."""

    @property
    def can_id(self) -> int: ...
    @property
    def data(self) -> bytes: ...
    @property
    def dlc(self) -> int: ...
    @property
    def is_extended(self) -> bool: ...
    @property
    def is_remote(self) -> bool: ...
    @property
    def is_error(self) -> bool: ...


class Value(NamedTuple):
    """One object in a frame.

    Attributes
    ----------
    key : index and subindex as manuals print them, empty where it is no object.
    raw : the integer on the bus.
    si, unit : SI value, motor-side, with the motor's polarity; None and "" where it is no physical quantity.
    text : what it means, where it is a word of bits or a code.
    """

    name: str
    key: str
    raw: int
    si: float | None = None
    unit: str = ""
    text: str = ""


class Explained(NamedTuple):
    """A frame in words.

    Attributes
    ----------
    kind : one of KINDS.
    node : the motor whose drive it is to or from, `driver`, `all`, `node 17`, or `-`.
    number : its node id; 0 means all, None none.
    what : `TPDO1`, `NMT start`, `SDO upload answer`, …
    values : the objects that it carries.
    note : what else there is to say.
    """

    kind: str
    node: str
    number: int | None
    what: str
    values: tuple[Value, ...] = ()
    note: str = ""


class Explainer:
    """Explains the frames of a rig's bus.

    Parameters
    ----------
    rig : Rig
        Parameters, EDS and robot file that the bus is run with.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._motors = {node: motor for motor, node in rig.codec.nodes.items()}
        self._names = {**self._motors, rig.config.driver_id: DRIVER, 0: ALL}
        self._objects: dict[tuple[int, int], ODVariable | None] = {}

    def name_of(self, node: int) -> str:
        """How a node is called."""
        return self._names.get(node) or f"node {node}"

    def explain(self, frame: AnyFrame) -> Explained:
        """What a frame says."""
        if frame.is_error:
            return Explained(
                "error", NOBODY, None, "error frame", (), read_error_classes(frame.can_id, frame.data).text
            )
        if frame.is_extended or frame.is_remote:
            kind = "extended" if frame.is_extended else "remote"
            return Explained("other", NOBODY, None, f"{kind} frame", (), f"{frame.can_id:#x}; not CANopen's")
        found = self.rig.codec.decode(frame.can_id, frame.data)
        if isinstance(found, Pdo):
            return self._pdo(found)
        if isinstance(found, UnknownFrame):
            return Explained("other", NOBODY, None, "frame", (), found.reason)
        if isinstance(found, Malformed):
            number = found.node or None
            return Explained("malformed", self.name_of(found.node) if number else NOBODY, number, "", (), found.reason)
        return self._service(found, frame.data)

    def _service(self, found: Sync | Nmt | Heartbeat | Emcy | Sdo, data: bytes) -> Explained:
        if isinstance(found, Sync):
            counter = () if found.counter is None else (Value("counter", "", found.counter),)
            return Explained("sync", ALL, 0, "SYNC", counter)
        name = self.name_of(found.node)
        if isinstance(found, Nmt):
            command = Value("command", "", int(found.command), text=_words(found.command.name))
            return Explained("nmt", name, found.node, "NMT", (command,))
        if isinstance(found, Heartbeat):
            state = Value("state", "", int(found.state), text=_words(found.state.name))
            return Explained("heartbeat", name, found.node, "heartbeat", (state,))
        if isinstance(found, Emcy):
            code = Value("error_code", "603Fh", found.code, text=error_text(found.code))
            register = Value("error_register", "1001h", found.register, text=register_text(found.register))
            note = f"manufacturer {found.data.hex()}" if any(found.data) else ""
            return Explained("emcy", name, found.node, "EMCY", (code, register), note)
        return self._sdo(found, data)

    def value(self, motor: str, index: int, subindex: int, raw: int) -> Value:
        """An object of a motor's drive that holds `raw`."""
        variable = self._object(index, subindex)
        label = _label(variable) if variable is not None else "object"
        return self._value(motor, index, label, f"{index:04X}h:{subindex}", raw)

    def _pdo(self, found: Pdo) -> Explained:
        motor = self._motors[found.node]
        fields = zip(found.map.fields, found.values, strict=True)
        values = tuple(self._value(motor, field.index, field.name, field.key, raw) for field, raw in fields)
        return Explained("rpdo" if found.map.to_drive else "tpdo", motor, found.node, found.map.name, values)

    def _value(self, motor: str | None, index: int, name: str, key: str, raw: int) -> Value:
        if (words := _TEXTS.get(index)) is not None:
            return Value(name, key, raw, text=words(raw))
        scale = self.rig.scaling[motor].of_object(index) if motor else None
        return (
            Value(name, key, raw) if scale is None else Value(name, key, raw, scale.si(raw) + 0.0, scale.unit)
        )  # no -0.0

    def _sdo(self, found: Sdo, data: bytes) -> Explained:
        name = self.name_of(found.node)
        what = f"SDO {found.service} {'request' if found.request else 'answer'}"
        if found.index is None or found.subindex is None:
            return Explained("sdo", name, found.node, what, (), found.data.hex())
        key = f"{found.index:04X}h:{found.subindex}"
        variable = self._object(found.index, found.subindex)
        label = _label(variable) if variable is not None else "object"
        if found.service == "abort":
            code = int.from_bytes(found.data, "little")
            return Explained("sdo", name, found.node, what, (Value(label, key, code, text=_abort_text(code)),))
        carries = found.request == (found.service == "download")
        if not carries:
            return Explained("sdo", name, found.node, what, (), f"{key} {label}")
        head = data[0]
        if not head & 2:
            total = f"{int.from_bytes(found.data, 'little')} bytes" if head & 1 else "its bytes"
            return Explained("sdo", name, found.node, what, (), f"{key} {label}: {total} follow")
        content = found.data[: 4 - (head >> 2 & 3)] if head & 1 else found.data
        raw, text = _read(variable, content)
        value = self._value(self._motors.get(found.node), found.index, label, key, raw)
        return Explained("sdo", name, found.node, what, (value._replace(text=value.text or text),))

    def _object(self, index: int, subindex: int) -> ODVariable | None:
        """An object of the EDS, None for one that it does not have."""
        key = (index, subindex)
        if key not in self._objects:
            entry: Any = self.rig.dictionary.get(index)
            if entry is not None and not isinstance(entry, ODVariable):
                entry = entry.get(subindex)
            self._objects[key] = entry
        return self._objects[key]


def _label(variable: ODVariable) -> str:
    """An object's name; of a record's parts with that of the whole, for those are called alike."""
    whole = variable.parent
    own = identifier_name(variable.name)
    if whole is None or not getattr(whole, "subindices", None):
        return own
    return f"{identifier_name(whole.name)}.{own}"


def _read(variable: ODVariable | None, content: bytes) -> tuple[int, str]:
    """The integer in an expedited transfer, and the text where the object holds one."""
    letter = FORMATS.get(variable.data_type or 0, "") if variable is not None else ""
    text = ""
    if variable is not None and variable.data_type == datatypes.VISIBLE_STRING:
        text = repr(content.rstrip(b"\0").decode("ascii", "replace"))
    return int.from_bytes(content, "little", signed=letter.islower() and letter != ""), text


def _abort_text(code: int) -> str:
    return f"{code:08X}h {SdoAbortedError.CODES.get(code, 'no reason of CiA 301')}"


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _state_text(word: int) -> str:
    state = state_of(word)
    return "no state" if state is None else str(state)


def _command_text(word: int) -> str:
    command = command_of(word)
    return "no command" if command is None else str(command)


def _mode_text(mode: int) -> str:
    return _words(OperationMode(mode).name) if mode in _MODES else "none of ours" if mode else "no mode"


_MODES: Final = tuple(int(mode) for mode in OperationMode)
_TEXTS: Final[dict[int, Callable[[int], str]]] = {
    0x1001: register_text,
    0x603F: error_text,
    0x6040: _command_text,
    0x6041: _state_text,
    0x6060: _mode_text,
    0x6061: _mode_text,
}
"""Objects whose integers are words of bits or codes."""


def matches(explained: Explained, nodes: frozenset[str], kinds: frozenset[str]) -> bool:
    """Whether a frame is of one of the nodes (names or numbers) and kinds; an empty set lets all pass."""
    if kinds and explained.kind not in kinds:
        return False
    return not nodes or explained.node in nodes or str(explained.number) in nodes


def names(rig: Rig) -> Iterator[str]:
    """The names of a rig's nodes."""
    yield from rig.codec.nodes
    yield from (DRIVER, ALL)


# ----------------------------------------------------------------------
# Explained frames as lines: for reading, as JSON, and as CSV with one row an object.
# ----------------------------------------------------------------------


Line = Callable[[float, int, AnyFrame, Explained], str]
"""Takes seconds since the recording's beginning, the stamp in ns, the frame and what it says; returns its line(s)."""

COLUMNS: Final = (
    "t", "stamp_ns", "id", "data", "node", "kind", "what", "object", "name", "raw", "value", "unit", "text", "note"
)  # fmt: skip
"""Of the CSV: t in s; value in SI units; a frame without objects has one row without them."""


def for_reading(raw: bool = False) -> Line:
    """Lines of columns; with `raw` identifier, bytes and the objects' integers too."""

    def line(t: float, _stamp_ns: int, frame: AnyFrame, found: Explained) -> str:
        said = [_value_text(value, raw) for value in found.values]
        text = ", ".join([*said, *([found.note] if found.note else [])])
        bytes_text = f"{_identifier(frame):>8}  {_data(frame):<16}  " if raw else ""
        return f"{t:12.6f}  {bytes_text}{found.node:<11}  {found.what or found.kind:<9}  {text}".rstrip()

    return line


def as_json(t: float, stamp_ns: int, frame: AnyFrame, found: Explained) -> str:
    """One object a frame."""
    return json.dumps(
        {
            "t": round(t, 9),
            "stamp_ns": stamp_ns,
            "id": frame.can_id,
            "extended": frame.is_extended,
            "remote": frame.is_remote,
            "error": frame.is_error,
            "dlc": frame.dlc,
            "data": frame.data.hex(),
            "node": found.node,
            "kind": found.kind,
            "what": found.what,
            "values": {
                value.name: {"object": value.key, "raw": value.raw, "value": value.si, "unit": value.unit,
                             "text": value.text} for value in found.values
            },
            "note": found.note,
        }
    )  # fmt: skip


def as_csv(t: float, stamp_ns: int, frame: AnyFrame, found: Explained) -> str:
    """Rows of COLUMNS."""
    sink = io.StringIO()
    rows = csv.writer(sink, lineterminator="\n")
    head = (f"{t:.9f}", stamp_ns, _identifier(frame), _data(frame), found.node, found.kind, found.what)
    for value in found.values:
        si = "" if value.si is None else repr(value.si)
        rows.writerow([*head, value.key, value.name, value.raw, si, value.unit, value.text, found.note])
    if not found.values:
        rows.writerow([*head, "", "", "", "", "", "", found.note])
    return sink.getvalue().rstrip("\n")


def _identifier(frame: AnyFrame) -> str:
    return f"{frame.can_id:08X}" if frame.is_extended else f"{frame.can_id:03X}"


def _data(frame: AnyFrame) -> str:
    return f"R{frame.dlc}" if frame.is_remote else bytes(frame.data).hex().upper()


def _value_text(value: Value, raw: bool) -> str:
    """``velocity_actual_value 12.3 rad/s``."""
    name = f"{value.key} {value.name}" if value.key.partition(":")[1] else value.name
    if value.si is not None:
        own = f" [{value.raw}]" if raw else ""
        return f"{name} {value.si:.6g} {value.unit}{own}"
    if value.text:
        return f"{name} {value.text}" + (f" [{value.raw:#x}]" if raw else "")
    return f"{name} {value.raw}"


def setting_text(value: Value) -> str:
    """``6072h:0         1000       0x3e8  max_torque  0.6 N m``."""
    meaning = value.text if value.si is None else f"{value.si:.6g} {value.unit}"
    return f"{value.key:<8}  {value.raw:>11}  {value.raw & 0xFFFFFFFF:>#10x}  {value.name}  {meaning}".rstrip()
