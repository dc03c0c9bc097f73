"""What the keys of a sweep mean: parameters of the robot, effects, kappa, the manoeuvre and its numbers."""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice
from artibot_sim.model.quantity import Quantity
from artibot_sim.model.robot import Robot
from artibot_sim.planning import manoeuvre_from_dict
from artibot_sim.sweep.axes import Value

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
    keys = [KAPPA, MANOEUVRE, *(key for key, _, _ in base.robot.quantities())]
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
    if key.startswith(_EFFECTS):
        name, _, parameter = key[len(_EFFECTS) :].partition(".")
        effect = EFFECTS.get(name)
        if effect is None or parameter not in effect.parameters:
            return None
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
