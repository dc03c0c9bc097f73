"""Robot files: YAML in, :class:`Robot` out, and back.

Every number stands as ``{value, unit, source}``, optionally with ``ci95``. A wrong unit, a missing or unknown
key, a value out of bounds is refused with the key's path.
"""

from __future__ import annotations

import dataclasses
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from artibot_sim.documents import did_you_mean, load_document
from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.model.robot.quantity import Quantity
from artibot_sim.model.robot.robot import (
    Contact,
    Control,
    Drive,
    Drives,
    Hitch,
    Module,
    Motor,
    Polarity,
    Readings,
    Robot,
    Sensors,
    Trailing,
    Wheel,
    WheelOdometry,
    module_name,
)

SOURCES = (
    "stated",
    "table 2",
    "table 3",
    "table 4",
    "datasheet:",
    "inferred:",
    "assumed:",
    "identified:",
    "diagnosed:",
)
"""How a source must begin."""

_ENTRY = ("value", "unit", "source", "ci95")
_SECTIONS: dict[str, type] = {"front": Module, "wheel": Wheel, "contact": Contact, "control": Control}
_OPTIONAL: dict[str, type] = {"motor": Motor, "sensors": Sensors, "odometry": WheelOdometry}
_NESTED: dict[str, type] = {"polarity": Polarity, "hitch": Hitch}


def load_robot(robot: str | os.PathLike[str]) -> Robot:
    """Read a robot file.

    Parameters
    ----------
    robot : str or path
        A name (``"agriq"``: a file shipped with artibot) or the path of a YAML file.

    Raises
    ------
    ArtibotError
        Naming the file, the key, what was found, what was expected and the mend.
    """
    return load_document("robots", robot, "robot", robot_from_dict)


def robot_from_dict(document: Any, name: str = "robot") -> Robot:
    """Build a robot from the mapping that a robot file holds; errors name the key's path."""
    top = _mapping(document, "the file")
    behind = _trailing_names(top)
    known = {*_SECTIONS, *_OPTIONAL, "back", *behind, "drive"}
    known |= {"name", "description", "suspension", "readings", "effects"}
    _refuse_unknown(top, known, "")
    reader = _Reader()
    parts = {key: reader.section(cls, _required(top, key), key) for key, cls in _SECTIONS.items()}
    parts |= {key: reader.section(cls, top[key], key) for key, cls in _OPTIONAL.items() if top.get(key) is not None}
    back = reader.section(Module, top["back"], "back") if top.get("back") is not None else None
    drive = _mapping(_required(top, "drive"), "drive")
    _refuse_unknown(drive, {"front", "back", *behind}, "drive.")
    drives = Drives(
        reader.section(Drive, _required(drive, "front", "drive."), "drive.front"),
        reader.section(Drive, drive["back"], "drive.back") if drive.get("back") is not None else None,
        tuple(
            reader.section(Drive, drive[name], f"drive.{name}") if drive.get(name) is not None else None
            for name in behind
        ),
    )
    readings = _mapping(top.get("readings") or {}, "readings")
    _refuse_unknown(readings, {entry.name for entry in dataclasses.fields(Readings)}, "readings.")
    for key, value in readings.items():
        if not isinstance(value, bool):
            raise ArtibotError(f"readings.{key}: found {value!r}, expected true or false")
    return Robot(
        name=str(top.get("name", name)),
        description=str(top.get("description", "")),
        suspension=str(top.get("suspension", "")),
        back=back,
        trailing=tuple(reader.section(Trailing, top[name], name) for name in behind),
        drive=drives,
        readings=Readings(**readings),
        effects=reader.effects(_mapping(top.get("effects") or {}, "effects")),
        sources=reader.sources,
        intervals=reader.intervals,
        **parts,
    )


def _trailing_names(top: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the sections of modules behind `back`, from there on; a gap in their numbers is refused."""
    found = [str(key) for key in top if str(key).startswith("module_")]
    names = tuple(module_name(i + 2) for i in range(len(found)))
    for name in names:
        if name not in found:
            have = ", ".join(found)
            raise ArtibotError(f"{name}: missing beside {have}; number the modules behind `back` from module_3 on")
    return names


class _Reader:
    """Turns sections into dataclasses and collects each number's source and interval on the way."""

    def __init__(self) -> None:
        self.sources: dict[str, str] = {}
        self.intervals: dict[str, tuple[float, float]] = {}

    def section(self, cls: type, node: Any, path: str) -> Any:
        entries = _mapping(node, path)
        fields = {entry.name: entry for entry in dataclasses.fields(cls)}
        _refuse_unknown(entries, set(fields), f"{path}.")
        values: dict[str, Any] = {}
        for name, entry in fields.items():
            key = f"{path}.{name}"
            if name in entries:
                nested = _NESTED.get(name)
                values[name] = (
                    self.section(nested, entries[name], key)
                    if nested
                    else self.number(entries[name], entry.metadata["quantity"], key)
                )
            elif entry.default is dataclasses.MISSING and entry.default_factory is dataclasses.MISSING:
                if name in _NESTED:
                    within = "l: {value: …, unit: m, source: …}"
                    raise ArtibotError(f"{key}: missing; add {{{within}}}, where its joint sits on the module ahead")
                quantity: Quantity = entry.metadata["quantity"]
                raise ArtibotError(
                    f"{key}: missing; add {{value: …, unit: {quantity.unit}, source: …}} ({quantity.doc})"
                )
        return cls(**values)

    def number(self, node: Any, quantity: Quantity, key: str) -> float:
        example = f"{{value: …, unit: {quantity.unit}, source: …}}"
        if not isinstance(node, Mapping):
            raise ArtibotError(f"{key}: found {node!r}, expected {example}")
        _refuse_unknown(node, set(_ENTRY), f"{key}.")
        for part in ("value", "unit", "source"):
            if part not in node:
                raise ArtibotError(f"{key}.{part}: missing; every number stands as {example}")
        unit = str(node["unit"])
        if unit != quantity.unit:
            raise ArtibotError(f"{key}.unit: found '{unit}', expected '{quantity.unit}' ({quantity.doc})")
        self._note(node, key)
        value = _float(node["value"], f"{key}.value")
        quantity.check(key, value)
        return value

    def effects(self, node: Mapping[str, Any]) -> Mapping[str, Any]:
        """The section as it is: its numbers may stand bare, the others' sources and intervals are noted."""
        for name, entries in node.items():
            for parameter, entry in entries.items() if isinstance(entries, Mapping) else ():
                key = f"effects.{name}.{parameter}"
                if isinstance(entry, Mapping):
                    _refuse_unknown(entry, set(_ENTRY), f"{key}.")
                    self._note({"source": "assumed: not said"} | dict(entry), key)
        return node

    def _note(self, node: Mapping[str, Any], key: str) -> None:
        source = str(node["source"])
        if not source.startswith(SOURCES):
            raise ArtibotError(f"{key}.source: found '{source}', expected it to begin with one of {', '.join(SOURCES)}")
        self.sources[key] = source
        if "ci95" in node:
            low, high = (_float(bound, f"{key}.ci95") for bound in _pair(node["ci95"], f"{key}.ci95"))
            self.intervals[key] = (low, high)


def robot_to_dict(robot: Robot) -> dict[str, Any]:
    """The mapping that a robot file holds; :func:`robot_from_dict` gives the robot back."""
    document: dict[str, Any] = {"name": robot.name, "description": robot.description}
    document |= {"suspension": robot.suspension} if robot.suspension else {}
    usual = {f"{section}.{name}": value for section, cls in _OPTIONAL.items() for name, value in vars(cls()).items()}
    for key, quantity, value in (*robot.quantities(), *robot.sensor_quantities()):
        # an unlimited motor is one whose limit is not in the file
        if key in robot.sources or (value != usual[key] if key in usual else math.isfinite(value)):
            _enter(document, robot, key, quantity, value)
    document["readings"] = dataclasses.asdict(robot.readings)
    if effects := robot.effects_beside:
        document["effects"] = {name: _effect_entries(robot, name, values) for name, values in effects.items()}
    return document


def _enter(document: dict[str, Any], robot: Robot, key: str, quantity: Quantity, value: float) -> None:
    """Put a number into the section that its key names."""
    *path, name = key.split(".")
    node = document
    for part in path:
        node = node.setdefault(part, {})
    entry = {"value": value, "unit": quantity.unit, "source": robot.sources.get(key, "assumed: default")}
    node[name] = entry | ({"ci95": list(robot.intervals[key])} if key in robot.intervals else {})


def _effect_entries(robot: Robot, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for parameter, value in values.items():
        key, quantity = f"effects.{name}.{parameter}", EFFECTS[name].parameters[parameter].quantity
        unit = {} if isinstance(quantity, Choice) else {"unit": quantity.unit}
        interval = {"ci95": [float(bound) for bound in robot.intervals[key]]} if key in robot.intervals else {}
        source = robot.sources.get(key, "assumed: set by hand")
        entries[parameter] = {"value": value} | unit | {"source": source} | interval
    return entries


def save_robot(robot: Robot, path: str | os.PathLike[str]) -> None:
    """Write a robot file that :func:`load_robot` reads; whole or not at all."""
    target = Path(path)
    text = yaml.safe_dump(robot_to_dict(robot), sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        os.chmod(temporary, 0o644)
        os.replace(temporary, target)
    except OSError as error:
        os.unlink(temporary)
        raise ArtibotError(f"{target}: cannot be written: {error.strerror}") from error


def _mapping(node: Any, path: str) -> Mapping[str, Any]:
    if not isinstance(node, Mapping):
        raise ArtibotError(f"{path}: found {type(node).__name__}, expected a mapping of keys")
    return node


def _required(node: Mapping[str, Any], key: str, path: str = "") -> Any:
    if key not in node:
        raise ArtibotError(f"{path}{key}: missing; a robot file needs this section")
    return node[key]


def _refuse_unknown(node: Mapping[str, Any], known: set[str], path: str) -> None:
    for key in node:
        if key not in known:
            raise ArtibotError(
                f"{path}{key}: unknown key{did_you_mean(key, known)}; expected one of {', '.join(sorted(known))}"
            )


def _float(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ArtibotError(f"{key}: found {value!r}, expected a number")
    return float(value)


def _pair(value: Any, key: str) -> tuple[Any, Any]:
    if not isinstance(value, list) or len(value) != 2:
        raise ArtibotError(f"{key}: found {value!r}, expected two numbers, the interval's ends")
    return value[0], value[1]
