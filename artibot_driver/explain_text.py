"""Explained frames as lines: for reading, as JSON, and as CSV with one row an object."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from typing import Final

from artibot_driver.explain import Explained, Heard, Value

SECOND: Final = 1_000_000_000

Line = Callable[[float, int, Heard, Explained], str]
"""Takes seconds since the recording's beginning, the stamp in ns, the frame and what it says; returns its line(s)."""

COLUMNS: Final = (
    "t", "stamp_ns", "id", "data", "node", "kind", "what", "object", "name", "raw", "value", "unit", "text", "note"
)  # fmt: skip
"""Of the CSV: t in s; value in SI units; a frame without objects has one row without them."""


def for_reading(raw: bool = False) -> Line:
    """Lines of columns; with `raw` identifier, bytes and the objects' integers too."""

    def line(t: float, _stamp_ns: int, frame: Heard, found: Explained) -> str:
        said = [_value_text(value, raw) for value in found.values]
        text = ", ".join([*said, *([found.note] if found.note else [])])
        bytes_text = f"{_identifier(frame):>8}  {_data(frame):<16}  " if raw else ""
        return f"{t:12.6f}  {bytes_text}{found.node:<11}  {found.what or found.kind:<9}  {text}".rstrip()

    return line


def as_json(t: float, stamp_ns: int, frame: Heard, found: Explained) -> str:
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


def as_csv(t: float, stamp_ns: int, frame: Heard, found: Explained) -> str:
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


def _identifier(frame: Heard) -> str:
    return f"{frame.can_id:08X}" if frame.is_extended else f"{frame.can_id:03X}"


def _data(frame: Heard) -> str:
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
