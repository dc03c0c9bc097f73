"""Axes of a sweep: what its keys mean, and which values each takes."""

from __future__ import annotations

import copy
import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.model.robot.quantity import Quantity
from artibot_sim.model.robot.robot import MOTOR_EFFECTS, Robot
from artibot_sim.planning import manoeuvre_from_dict

# ----------------------------------------------------------------------
# Axes of a sweep: what a key takes one value after another of.
# ----------------------------------------------------------------------


Value = float | str
SCALES = ("linear", "log")
_RANGE = ("from", "to", "count", "scale")
_MOST = 1_000_000
"""Values of one axis of a grid at most."""


@dataclass(frozen=True)
class Axis:
    """A key with its values: a list, or a range.

    Attributes
    ----------
    key : str
        What is varied: ``contact.mu_s``, ``kappa``, ``effects.slope.grade``, ``manoeuvre``, …
    values : tuple
        Numbers (SI) or names; empty for a range.
    low, high : float
        Ends of a range, both taken.
    count : int or None
        Values that a grid takes from a range.
    scale : {"linear", "log"}
        How a range is divided.
    """

    key: str
    values: tuple[Value, ...] = ()
    low: float = 0.0
    high: float = 0.0
    count: int | None = None
    scale: str = "linear"

    @property
    def is_text(self) -> bool:
        """Whether the values are names."""
        return bool(self.values) and isinstance(self.values[0], str)

    @property
    def ends(self) -> tuple[Value, ...]:
        """Values whose bounds stand for all others': those of a list, or the ends of a range."""
        return self.values or (self.low, self.high)

    def points(self) -> tuple[Value, ...]:
        """What a grid takes, in order."""
        if self.values:
            return self.values
        if self.count is None:
            raise ArtibotError(
                f"axes.{self.key}: a range without count; add how many values the grid takes (count: 10)"
            )
        return tuple(self.at(np.linspace(0.0, 1.0, self.count) if self.count > 1 else np.zeros(1)))

    def at(self, share: NDArray[np.float64]) -> list[Value]:
        """Values at shares (n,) of the axis, 0 to 1: what a hypercube takes. The ends are met exactly."""
        if self.values:
            places = np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)
            return [self.values[i] for i in places.tolist()]
        if self.scale == "log":
            found = np.exp(np.log(self.low) + share * (np.log(self.high) - np.log(self.low)))
        else:
            found = self.low + share * (self.high - self.low)
        found = np.where(share == 0.0, self.low, np.where(share == 1.0, self.high, found))
        return list(np.clip(found, min(self.low, self.high), max(self.low, self.high)).tolist())

    def as_dict(self) -> Any:
        """As a plan file has it."""
        if self.values:
            return list(self.values)
        ends: dict[str, Any] = {"from": self.low, "to": self.high}
        counted = {} if self.count is None else {"count": self.count}
        return ends | counted | ({} if self.scale == "linear" else {"scale": self.scale})


def axis_from_node(key: str, node: Any) -> Axis:
    """An axis from what a plan file holds under ``axes.KEY``: a list, a range, or one value."""
    path = f"axes.{key}"
    if isinstance(node, Mapping):
        return _range(key, node)
    items = list(node) if isinstance(node, list) else [node]
    if not items:
        raise ArtibotError(
            f"{path}: no value; give at least one, such as [0.4, 0.6], or {{from: 0.4, to: 0.9, count: 6}}"
        )
    values = tuple(_value(item, path) for item in items)
    if len({isinstance(value, str) for value in values}) > 1:
        raise ArtibotError(f"{path}: numbers and names in one list; expected one kind")
    if len(set(values)) < len(values):
        twice = next(value for value in values if values.count(value) > 1)
        raise ArtibotError(f"{path}: {twice!r} stands twice; leave one out, or its runs are repeated")
    return Axis(key, values)


def axis_from_text(text: str) -> Axis:
    """An axis from a flag: ``KEY=0.4:0.9:6``, ``KEY=1e3:1e5:5:log``, ``KEY=0.4:0.9`` or ``KEY=a,b,c``."""
    key, equals, rest = text.partition("=")
    key, rest = key.strip(), rest.strip()
    if not equals or not key or not rest:
        raise ArtibotError(
            f"--axis {text}: expected KEY=FROM:TO:COUNT or KEY=VALUE,VALUE, such as contact.mu_s=0.4:0.9:6"
        )
    if ":" not in rest:
        return axis_from_node(key, [_scalar(word) for word in rest.split(",")])
    parts = rest.split(":")
    scale = [parts.pop()] if parts[-1] in SCALES else []
    if len(parts) not in (2, 3):
        raise ArtibotError(f"--axis {text}: expected FROM:TO:COUNT, with :log behind it for equal ratios")
    node: dict[str, Any] = {"from": _scalar(parts[0]), "to": _scalar(parts[1])}
    node |= {"count": _scalar(parts[2])} if len(parts) == 3 else {}
    return _range(key, node | ({"scale": scale[0]} if scale else {}))


def setting_from_text(text: str) -> tuple[str, Value]:
    """A fixed value from a flag ``KEY=VALUE``."""
    key, equals, rest = text.partition("=")
    if not equals or not key.strip() or not rest.strip():
        raise ArtibotError(f"--set {text}: expected KEY=VALUE, such as contact.mu_s=0.6")
    return key.strip(), _value(_scalar(rest), key.strip())


def _range(key: str, node: Mapping[str, Any]) -> Axis:
    path = f"axes.{key}"
    for word in node:
        if word not in _RANGE:
            raise ArtibotError(
                f"{path}.{word}: unknown key{did_you_mean(word, _RANGE)}; expected from, to, count, scale"
            )
    for word in ("from", "to"):
        if word not in node:
            raise ArtibotError(f"{path}.{word}: missing; a range is {{from: 0.4, to: 0.9, count: 6}}")
    low, high = (_number(node[word], f"{path}.{word}") for word in ("from", "to"))
    scale, count = node.get("scale", "linear"), node.get("count")
    if scale not in SCALES:
        raise ArtibotError(f"{path}.scale: found {scale!r}, expected one of {', '.join(SCALES)}")
    if scale == "log" and not (low > 0 and high > 0):
        raise ArtibotError(f"{path}: from {low:g} to {high:g} on a log scale; both ends must be above 0")
    if isinstance(count, float) and count.is_integer():
        count = int(count)
    if count is not None and (isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= _MOST):
        raise ArtibotError(f"{path}.count: found {count!r}, expected a whole number from 1 to {_MOST}")
    if low == high and count != 1:
        raise ArtibotError(f"{path}: from and to are both {low:g}; give it under 'set', or two different ends")
    return Axis(key, (), low, high, count, scale)


def _number(node: Any, path: str) -> float:
    value = _value(node, path)
    if isinstance(value, str) or not math.isfinite(value):
        raise ArtibotError(f"{path}: found {node!r}, expected a finite number")
    return value


def _value(node: Any, path: str) -> Value:
    """A number or a name; YAML's 1e3 without a point is text and is taken for the number it looks like."""
    if isinstance(node, bool) or not isinstance(node, int | float | str):
        raise ArtibotError(f"{path}: found {node!r}, expected a number or a name")
    value = _scalar(node) if isinstance(node, str) else float(node)
    if isinstance(value, float) and math.isnan(value):
        raise ArtibotError(f"{path}: found {node!r}, expected a number")
    return value


def _scalar(word: str) -> Value:
    try:
        return float(word)
    except ValueError:
        return word.strip()


# ----------------------------------------------------------------------
# What the keys of a sweep mean: parameters of the robot, effects, kappa, the manoeuvre and its numbers.
# ----------------------------------------------------------------------


KAPPA = "kappa"
MANOEUVRE = "manoeuvre"
_INSIDE = f"{MANOEUVRE}."
_EFFECTS = "effects."
_PLACE = re.compile(r"([^.\[\]]+)|\[(\d+)\]")

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Base:
    """What a sweep departs from.

    Attributes
    ----------
    robot : Robot
    manoeuvres : mapping of str to mapping
        By name, each as its file holds it; the first is driven where none is chosen.
    """

    robot: Robot
    manoeuvres: Mapping[str, Document]


def known_keys(base: Base) -> list[str]:
    """Every key that may be an axis."""
    sensors = {key for key, (effect, _) in MOTOR_EFFECTS.items() if EFFECTS[effect].acts == "sensor"}
    keys = [KAPPA, MANOEUVRE, *(key for key, _, _ in base.robot.quantities() if key not in sensors)]
    keys += [
        f"{_EFFECTS}{name}.{parameter}"
        for name, effect in EFFECTS.items()
        if effect.acts != "sensor"
        for parameter in effect.parameters
    ]
    for document in base.manoeuvres.values():
        keys += [_INSIDE + path for path in _leaves(document)]
    return list(dict.fromkeys(keys))


def unit_of(key: str, base: Base) -> str:
    """The unit of a key's values, "" for names and shares."""
    declared = _declared(key, base)
    if isinstance(declared, Quantity):
        return "" if declared.unit == "-" else declared.unit
    return _unit_by_suffix(key) if key.startswith(_INSIDE) else ""


def check_value(key: str, value: Value, base: Base) -> None:
    """Refuse an unknown key, a name where a number is expected, and a value out of bounds (ArtibotError)."""
    if key == MANOEUVRE:
        if value not in base.manoeuvres:
            raise ArtibotError(f"{key}: '{value}' was not loaded; expected one of {', '.join(base.manoeuvres)}")
        return
    if key.startswith(_INSIDE):
        _check_inside(key, value, base)
        return
    declared = _declared(key, base)
    if declared is None:
        known = known_keys(base)
        raise ArtibotError(
            f"{key}: unknown parameter{did_you_mean(key, known)}; expected one of robot '{base.robot.name}' "
            "(contact.mu_s, …), kappa, manoeuvre, manoeuvre.segments[…]… or effects.ID.PARAMETER "
            "(`artibot sweep --keys` lists all)"
        )
    if isinstance(declared, Choice):
        declared.read(value, key)
    elif isinstance(value, str):
        raise ArtibotError(f"{key}: found '{value}', expected a number{_in(declared)}")
    else:
        declared.check(key, value)


def _in(declared: Quantity) -> str:
    return "" if declared.unit == "-" else f" in {declared.unit}"


def _declared(key: str, base: Base) -> Quantity | Choice | None:
    """The declaration of a robot's or an effect's parameter."""
    if key == KAPPA:
        key = "control.kappa"
    name, parameter = MOTOR_EFFECTS.get(key, ("", ""))
    if key.startswith(_EFFECTS):
        name, _, parameter = key[len(_EFFECTS) :].partition(".")
    effect = EFFECTS.get(name)
    if effect is not None and parameter in effect.parameters:
        if effect.acts == "sensor":
            raise ArtibotError(f"{key}: acts on what sensors record, which a sweep does not simulate; leave it out")
        return effect.parameters[parameter].quantity
    return {name: declared for name, declared, _ in base.robot.quantities()}.get(key)


def robot_with(robot: Robot, values: Mapping[str, Value]) -> Robot:
    """The robot with a run's values, all checked together.

    Raises
    ------
    ArtibotError
        Where they contradict each other, such as mu_d above mu_s.
    """
    changes: dict[str, Value] = {}
    effects: dict[str, dict[str, Any]] = {name: dict(entries) for name, entries in robot.effects.items()}
    for key, value in values.items():
        if key.startswith(_EFFECTS):
            name, _, parameter = key[len(_EFFECTS) :].partition(".")
            effects.setdefault(name, {})[parameter] = value
        elif key == KAPPA:
            changes["control.kappa"] = value
        elif key != MANOEUVRE and not key.startswith(_INSIDE):
            changes[key] = value
    if changes:
        robot = robot.replace(changes, source="assumed: sweep")
    return robot if effects == robot.effects else dataclasses.replace(robot, effects=effects)


def manoeuvre_document(base: Base, values: Mapping[str, Value]) -> tuple[str, Document]:
    """Name and content of the manoeuvre that a run drives, with the run's numbers in it."""
    name = str(values.get(MANOEUVRE, next(iter(base.manoeuvres))))
    inside = {key[len(_INSIDE) :]: value for key, value in values.items() if key.startswith(_INSIDE)}
    if not inside:
        return name, base.manoeuvres[name]
    document = copy.deepcopy(dict(base.manoeuvres[name]))
    for path, value in inside.items():
        _put(document, path, value)
    return name, document


def _check_inside(key: str, value: Value, base: Base) -> None:
    """A number inside the manoeuvre: its place must be there, and the manoeuvre must hold with it."""
    for name in base.manoeuvres:
        try:
            manoeuvre_from_dict(manoeuvre_document(base, {MANOEUVRE: name, key: value})[1], name)
        except (LookupError, TypeError, ArtibotError) as error:
            leaves = [_INSIDE + path for path in _leaves(base.manoeuvres[name])]
            said = str(error) if isinstance(error, ArtibotError) else f"no such place{did_you_mean(key, leaves)}"
            raise ArtibotError(f"{key} = {value}: manoeuvre '{name}': {said}") from error


def _put(document: Any, path: str, value: Value) -> None:
    """Set a leaf by its path, ``segments[2].arc.radius_m``; all of it but the last word must be there."""
    steps = [int(number) if number else word for word, number in _PLACE.findall(path)]
    for step in steps[:-1]:
        document = document[step]
    if not isinstance(document, dict):
        raise TypeError(path)
    whole = isinstance(document.get(steps[-1]), int) and isinstance(value, float) and value.is_integer()
    document[steps[-1]] = int(value) if whole else value  # a number of repetitions is a whole one


def _leaves(node: Any, path: str = "") -> Iterator[str]:
    """Paths of the numbers in a manoeuvre."""
    if isinstance(node, Mapping):
        for key, below in node.items():
            yield from _leaves(below, f"{path}.{key}" if path else str(key))
    elif isinstance(node, list):
        for i, below in enumerate(node):
            yield from _leaves(below, f"{path}[{i}]")
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield path


_UNITS = {
    "_m": "m", "_s": "s", "_hz": "Hz", "_deg": "°", "_per_m": "1/m", "_m_s": "m/s", "_rad_s": "rad/s",
    "_m_s2": "m/s²", "_rad_s2": "rad/s²",
}  # fmt: skip


def _unit_by_suffix(key: str) -> str:
    for suffix in sorted(_UNITS, key=len, reverse=True):
        if key.endswith(suffix):
            return _UNITS[suffix]
    return ""
