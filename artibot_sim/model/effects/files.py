"""Effects of one's own: laws with a name, in files of YAML.

A file says where a force acts, what it follows and in which form (see `force_law`), and which of the law's numbers are
parameters of the effect, with bounds and a typical size::

    id: cold_gear
    description: The front left gear is stiff while it is cold.
    law: {where: front_left_torque, variable: time, form: decaying, times: speed, times_form: coulomb,
          times_scale: 0.02}
    parameters:
      size: {unit: N m, low: 0.0, high: 2.0, typical: 0.13}
      scale: {unit: s, low: 1.0, high: 100.0, typical: 8.0}

Once its file is read an effect is known as the built-in ones are: robot files may name it, a diagnosis looks for it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Choice, Effect, EffectParameter, Search, Values, number
from artibot_sim.model.effects.force_law import PARAMETERS, check, unit_of, variable_words
from artibot_sim.model.effects.parts import of_pair

SUFFIX = ".yaml"

_KEYS = ("id", "description", "law", "parameters")
_NUMBERS = tuple(name for name, one in PARAMETERS.items() if not isinstance(one.quantity, Choice))
_ENTRIES = ("unit", "low", "high", "typical")
_ID = re.compile(r"[a-z][a-z0-9_]*")


def load_folder(folder: Path) -> list[str]:
    """Make every effect in a folder known; their ids.

    Raises
    ------
    ArtibotError
        For a folder that is not there, a file that is no effect, or two that declare the same one.
    """
    if not folder.is_dir():
        raise ArtibotError(f"{folder}: no such folder; expected one with files of effects (*{SUFFIX})")
    found = dict[str, Path]()
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        effect = read_effect(path)
        if effect.id in found:
            raise ArtibotError(f"{path}: id: '{effect.id}' is that of {found[effect.id]}, too; expected another id")
        found[register(effect, path).id] = path
    return [*found]


def register(effect: Effect, path: Path) -> Effect:
    """Make an effect known; `path` says where it is from."""
    before = EFFECTS.get(effect.id)
    if before is not None and before.law is None:
        raise ArtibotError(f"{path}: id: '{effect.id}' is a built-in effect; expected another id")
    EFFECTS[effect.id] = effect
    return effect


def read_effect(path: Path) -> Effect:
    """The effect that a file declares.

    Raises
    ------
    ArtibotError
        One line that names the file, the key, what was found and what is expected.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ArtibotError(f"{path}: cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise ArtibotError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    return effect_of(document, str(path))


def effect_of(document: Any, path: str) -> Effect:
    """The effect that a document declares, see the top of this file."""
    _refuse_other_keys(document, _KEYS, path)
    for key in _KEYS:
        if key not in document:
            raise ArtibotError(f"{path}: {key}: missing; an effect needs {', '.join(_KEYS)}")
    name = str(document["id"])
    if not _ID.fullmatch(name):
        raise ArtibotError(f"{path}: id: found '{name}', expected small letters, digits and _, a letter first")
    doc = str(document["description"] or "").strip()
    if not doc:
        raise ArtibotError(f"{path}: description: found nothing, expected a sentence on what it is")
    given, declared = document["law"], document["parameters"]
    _refuse_other_keys(given, tuple(PARAMETERS), f"{path}: law")
    _refuse_other_keys(declared, _NUMBERS, f"{path}: parameters")
    if "size" not in declared or "size" in given:
        raise ArtibotError(f"{path}: parameters.size: missing; how large the force is, is the effect's first parameter")
    names = ["size", *(key for key in declared if key != "size")]
    for key in names[1:]:
        if key in given:
            raise ArtibotError(f"{path}: law.{key}: is one of the parameters, too; expected it in one of the two")
    fixed = EFFECTS["force_law"].read({"size": 1.0} | dict(given), f"{path}: law")
    parameters = {key: _parameter(key, declared[key], fixed, f"{path}: parameters.{key}") for key in names}
    typical = float(declared["size"]["typical"])
    if typical == 0.0:
        raise ArtibotError(f"{path}: parameters.size.typical: found 0, expected the size at which the force is plain")

    def law(values: Values) -> Values:
        return fixed | {key: float(values[key]) for key in names}

    check(fixed | {key: one.neutral for key, one in parameters.items()}, f"{path}: law")
    return Effect(
        id=name,
        acts="law",
        doc=doc,
        parameters=parameters,
        law=law,
        uniform=not {"place", "heading"} & {fixed["variable"], fixed["times"]},
        search=_search(typical, "phase" in names, of_pair(str(fixed["where"]))[1] > 0),
    )


def _search(typical: float, phase: bool, back: bool) -> Search:
    """How an effect of such a size is looked for; where its phase is another one each time, with that."""
    if phase:
        return Search({"size": abs(typical)}, direction="phase", back=back)
    return Search({"size": typical}, ((0.3,), (1.0,), (2.5,)), back=back)


def effect_document(effect_id: str, description: str, values: Values) -> dict[str, Any]:
    """The document of an effect that is this law, its size a parameter up to ten times as much either way.

    What follows an angle, which is 0 where a recording begins, has another phase in each: that is a parameter, too.
    """
    size, wheel = float(values["size"]), str(values["variable"]).endswith("angle")
    turns = wheel and values["variable"] != "articulation_angle" and values["form"] == "periodic"
    law = {
        key: values[key] if isinstance(one.quantity, Choice) else float(values[key])
        for key, one in PARAMETERS.items()
        if key != "size" and values[key] != one.neutral and not (turns and key == "phase")
    }
    law = {"where": values["where"], "variable": values["variable"], "form": values["form"]} | law
    bounds = {"low": -10.0 * abs(size), "high": 10.0 * abs(size)}
    parameters = {"size": {"unit": unit_of(str(values["where"]))} | bounds | {"typical": size}}
    if turns:
        parameters["phase"] = {"unit": "rad", "low": -math.pi, "high": math.pi, "typical": float(values["phase"])}
    return {"id": effect_id, "description": description, "law": law, "parameters": parameters}


def _parameter(key: str, entry: Any, law: Values, path: str) -> EffectParameter:
    _refuse_other_keys(entry, _ENTRIES, path)
    unit = _unit(key, law)
    if entry.get("unit", unit) != unit:
        raise ArtibotError(f"{path}.unit: found '{entry['unit']}', expected '{unit}'")
    numbers = {}
    for name in ("low", "high", "typical"):
        value = entry.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ArtibotError(f"{path}.{name}: found {value!r}, expected a number in {unit or 'no unit'}")
        numbers[name] = float(value)
    low, high, typical = numbers["low"], numbers["high"], numbers["typical"]
    if not low <= typical <= high or low >= high:
        raise ArtibotError(f"{path}: found {low:g} to {high:g}, typical {typical:g}; expected low < high around it")
    if key == "size" and not low <= 0.0 <= high:
        raise ArtibotError(f"{path}: found {low:g} to {high:g}; expected 0 between, where the effect is absent")
    neutral = 0.0 if key == "size" else typical
    for name in ("low", "high") if key != "size" else ():  # what the law itself can have
        PARAMETERS[key].quantity.check(f"{path}.{name}", numbers[name])  # type: ignore[union-attr]  # none is a choice
    return number(unit, low, high, str(PARAMETERS[key].quantity.doc), neutral)


def _unit(key: str, law: Values) -> str:
    """Unit of a law's number."""
    if key == "size":
        return unit_of(str(law["where"]))
    followed = {"scale": "variable", "times_scale": "times"}
    if key in followed:
        return variable_words(str(law[followed[key]]))[1] or "-"
    return str(PARAMETERS[key].quantity.unit)  # type: ignore[union-attr]  # of _NUMBERS, none is a choice


def _refuse_other_keys(node: Any, keys: tuple[str, ...], path: str) -> None:
    if not isinstance(node, Mapping):
        raise ArtibotError(f"{path}: found {type(node).__name__}, expected the keys {', '.join(keys)}")
    for key in node:
        if key not in keys:
            raise ArtibotError(f"{path}: {key}: unknown key{did_you_mean(str(key), keys)}; expected {', '.join(keys)}")
