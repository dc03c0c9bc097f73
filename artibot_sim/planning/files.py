"""Manoeuvre files: YAML in, :class:`Manoeuvre` out, and back.

A file holds ``description``, optionally ``a_max_m_s2`` and ``blend_m``, and ``segments``: a list in which each item
is a kind of segment with its numbers, ``- arc: {radius_m: 2.0, angle_deg: 270}``, or a kind alone (``- stop``). Each
key ends with its unit; angles are in degrees. A wrong, unknown or missing key is refused with its path and the mend.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Mapping
from typing import Any

from artibot_sim.documents import did_you_mean, load_document
from artibot_sim.errors import ArtibotError
from artibot_sim.model.robot.quantity import Quantity
from artibot_sim.planning.manoeuvre import SEGMENTS, Manoeuvre, Repeat, Segment
from artibot_sim.resources import config_names

_SUFFIX = {"m": "_m", "s": "_s", "Hz": "_hz", "rad": "_deg", "1/m": "_per_m", "m/s": "_m_s", "rad/s": "_rad_s"}
_SUFFIX |= {"m/s^2": "_m_s2", "rad/s^2": "_rad_s2", "": ""}


def load_manoeuvre(manoeuvre: str | os.PathLike[str]) -> Manoeuvre:
    """Read a manoeuvre.

    Parameters
    ----------
    manoeuvre : str or path
        A name (``"table6_agriq"``: a file shipped with artibot) or the path of a YAML file.

    Raises
    ------
    ArtibotError
        Naming the file, the key, what was found, what was expected and the mend.
    """
    return load_document("manoeuvres", manoeuvre, "manoeuvre", manoeuvre_from_dict)


def manoeuvre_names() -> tuple[str, ...]:
    """Names of the manoeuvres shipped with artibot."""
    return config_names("manoeuvres")


def manoeuvre_from_dict(document: Any, name: str = "manoeuvre") -> Manoeuvre:
    """Build a manoeuvre from the mapping that a file holds; errors name the key's path."""
    if not isinstance(document, Mapping):
        raise ArtibotError(f"found {_what(document)}, expected a mapping with the key 'segments'")
    numbers = _numbers(Manoeuvre)
    _refuse_unknown(document, [*numbers, "description", "segments"], "")
    if "segments" not in document:
        raise ArtibotError(
            "segments: missing; add a list of segments, such as '- straight: {length_m: 2.0, speed_m_s: 0.5}'"
        )
    description = document.get("description", "")
    if not isinstance(description, str):
        raise ArtibotError(f"description: found {_what(description)}, expected text")
    values = _read(document, numbers, "")
    segments = _segments(document["segments"], "segments")
    return Manoeuvre(name, segments, description=" ".join(description.split()), **values)


def _segments(node: Any, path: str) -> tuple[Segment, ...]:
    if not isinstance(node, list) or not node:
        raise ArtibotError(f"{path}: found {_what(node)}, expected a list of at least one segment")
    return tuple(_segment(item, f"{path}[{i}]") for i, item in enumerate(node))


def _segment(node: Any, path: str) -> Segment:
    if isinstance(node, str):
        node = {node: None}
    if not isinstance(node, Mapping) or len(node) != 1:
        raise ArtibotError(
            f"{path}: found {_what(node)}, expected one kind of segment, such as 'straight: {{length_m: 2.0}}'"
        )
    kind, body = next(iter(node.items()))
    if kind not in SEGMENTS:
        raise ArtibotError(
            f"{path}.{kind}: unknown segment{did_you_mean(kind, SEGMENTS)}; expected one of {', '.join(SEGMENTS)}"
        )
    cls, path = SEGMENTS[kind], f"{path}.{kind}"
    body = {} if body is None else body
    if not isinstance(body, Mapping):
        raise ArtibotError(f"{path}: found {_what(body)}, expected {{{_example(cls)}}}")
    if cls is Repeat:
        return _repeat(body, path)
    numbers = _numbers(cls)
    flags = [entry.name for entry in dataclasses.fields(cls) if "flag" in entry.metadata]
    _refuse_unknown(body, [*numbers, *flags], f"{path}.")
    values = _read(body, numbers, f"{path}.")
    for flag in flags:
        if flag in body:
            if not isinstance(body[flag], bool):
                raise ArtibotError(f"{path}.{flag}: found {_what(body[flag])}, expected true or false")
            values[flag] = body[flag]
    return _build(cls, values, path)


def _repeat(body: Mapping[str, Any], path: str) -> Repeat:
    _refuse_unknown(body, ["times", "segments"], f"{path}.")
    for key in ("times", "segments"):
        if key not in body:
            raise ArtibotError(f"{path}.{key}: missing; a repetition is {{times: 3, segments: [...]}}")
    times = body["times"]
    if isinstance(times, bool) or not isinstance(times, int):
        raise ArtibotError(f"{path}.times: found {_what(times)}, expected a whole number")
    return _build(Repeat, {"times": times, "segments": _segments(body["segments"], f"{path}.segments")}, path)


def _build(cls: type[Segment], values: dict[str, Any], path: str) -> Any:
    try:
        return cls(**values)
    except ArtibotError as error:
        raise ArtibotError(f"{path}.{error}") from error


def _numbers(cls: type) -> dict[str, dataclasses.Field[Any]]:
    """Key in a file → field, for the numbers of a dataclass."""
    return {
        entry.name + _SUFFIX[entry.metadata["quantity"].unit]: entry
        for entry in dataclasses.fields(cls)
        if "quantity" in entry.metadata
    }


def _read(node: Mapping[str, Any], numbers: Mapping[str, dataclasses.Field[Any]], path: str) -> dict[str, float]:
    values: dict[str, float] = {}
    for key, entry in numbers.items():
        spec: Quantity = entry.metadata["quantity"]
        if key not in node:
            if entry.default is dataclasses.MISSING:
                raise ArtibotError(f"{path}{key}: missing; add it ({spec.doc})")
            continue
        value = _float(node[key], f"{path}{key}")
        value = math.radians(value) if spec.unit == "rad" else value
        spec.check(path + key, value)
        values[entry.name] = value
    return values


def _float(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        hint = ""
        if isinstance(value, str):
            try:
                hint = f"; write {float(value)!r}"  # YAML takes 1e-3 and "2.0" for text
            except ValueError:
                hint = ""
        raise ArtibotError(f"{key}: found {_what(value)}, expected a number{hint}")
    return float(value)


def _refuse_unknown(node: Mapping[str, Any], known: Iterable[str], path: str) -> None:
    known = list(known)
    for key in node:
        if key not in known:
            raise ArtibotError(
                f"{path}{key}: unknown key{did_you_mean(key, known)}; expected {', '.join(known) or 'none here'}"
            )


def _example(cls: type) -> str:
    return ", ".join(f"{key}: …" for key, entry in _numbers(cls).items() if entry.default is dataclasses.MISSING)


def _what(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return f"a mapping of {', '.join(map(str, value)) or 'nothing'}"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def manoeuvre_to_dict(manoeuvre: Manoeuvre) -> dict[str, Any]:
    """The mapping that a file holds; :func:`manoeuvre_from_dict` gives the manoeuvre back (angles to rounding)."""
    document: dict[str, Any] = {"description": manoeuvre.description} if manoeuvre.description else {}
    return document | _written(manoeuvre) | {"segments": [_segment_to_dict(part) for part in manoeuvre.segments]}


def _segment_to_dict(segment: Segment) -> dict[str, Any]:
    if isinstance(segment, Repeat):
        body: dict[str, Any] = {
            "times": segment.times,
            "segments": [_segment_to_dict(part) for part in segment.segments],
        }
    else:
        body = _written(segment)
    return {segment.kind: body}


def _written(node: Any) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, entry in _numbers(type(node)).items():
        value = getattr(node, entry.name)
        if value is not None and value != entry.default:
            out[key] = math.degrees(value) if entry.metadata["quantity"].unit == "rad" else value
    flags = [entry for entry in dataclasses.fields(node) if "flag" in entry.metadata]
    return out | {
        entry.name: getattr(node, entry.name) for entry in flags if getattr(node, entry.name) != entry.default
    }
