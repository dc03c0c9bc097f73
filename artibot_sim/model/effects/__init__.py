"""Model extensions: what the paper's model leaves out, each in one place.

An effect is declared and computed in one file of this package, which ends in ``EFFECT = Effect(…)``; being there is
enough to be known. At its neutral value the model is bit-identical to the paper's. A robot file names the ones at
work under ``effects``.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import force_law, parts
from artibot_sim.model.effects.base import Effect, Values

_NOT_EFFECTS = ("base", "files", "hooks", "parts")


def _found() -> dict[str, Effect]:
    names = sorted(module.name for module in pkgutil.iter_modules(__path__) if module.name not in _NOT_EFFECTS)
    effects = [importlib.import_module(f"{__name__}.{name}").EFFECT for name in names]
    return {effect.id: effect for effect in effects}


EFFECTS: dict[str, Effect] = _found()
"""Every effect by id."""


def effects_from_dict(
    document: Mapping[str, Any], own: Mapping[str, Values] | None = None
) -> dict[str, dict[str, float | str]]:
    """Check the ``effects`` section of a robot file.

    Each effect's parameters stand as numbers or as ``{value, unit, source}``; a parameter that is not given has
    its neutral value, or that of the effects that the robot has by itself (`own`).
    """
    given = dict(document)
    for name, values in (own or {}).items():
        entries = given.get(name, {})
        given[name] = {**values, **entries} if isinstance(entries, Mapping) else entries
    return {name: _effect(name).read(entries, f"effects.{name}") for name, entries in given.items()}


def at_work(effects: Mapping[str, Values]) -> dict[str, tuple[Effect, Values]]:
    """Those of a robot's effects that make a difference, in the order of `EFFECTS`.

    Effects that are laws with a name stand as the laws that they are.
    """
    if not effects:
        return {}
    working = {
        name: (effect, effects[name])
        for name, effect in EFFECTS.items()
        if name in effects and effect.active(effects[name])
    }
    named = [name for name, (effect, _) in working.items() if effect.law is not None]
    if not named:
        return working
    free = [name for name in LAWS if name not in working]
    if len(named) > len(free):
        raise ArtibotError(f"effects: {', '.join(named)}: a robot has at most {len(LAWS)} laws at work")
    for name, place in zip(named, free, strict=False):
        effect, values = working.pop(name)
        if effect.law is not None:
            working[place] = (EFFECTS[place], effect.law(values))
    return working


LAWS = force_law.NAMES
"""The effects that are laws: only robots that have one are simulated by code that knows of them."""

_RECORDED = {name: effect for name, effect in EFFECTS.items() if effect.hooks and name not in LAWS}


def _fields(effects: Mapping[str, Effect]) -> list[tuple[str, Any]]:
    return [(name, [(key, np.float64) for key in effect.parameters]) for name, effect in effects.items()]


_FIELDS: list[tuple[str, Any]] = [("t", np.float64), *_fields(_RECORDED)]

RECORD_DTYPE = np.dtype(_FIELDS, align=True)
"""What compiled code takes of the effects: the time (s), and each one's parameters under its name."""

LAW_DTYPE = np.dtype(
    [
        *_fields({name: EFFECTS[name] for name in LAWS}),
        ("motion", [(name, np.float64, (count,)) for name, count in force_law.MOTION]),
        *_FIELDS,
    ],
    align=True,
)
"""What compiled code takes of the effects of a robot with laws: these, what the rover as a whole does at an instant,
which laws follow, and the fields of RECORD_DTYPE.

These come first: numba takes a record that begins as another does for one of the same kind."""


def has_laws(effects: Mapping[str, Values]) -> bool:
    """Whether a robot has laws at work."""
    return any(name in LAWS for name in at_work(effects))


def has_memory(effects: Mapping[str, Values]) -> bool:
    """Whether the wheels of a robot remember anything: forces that lag, bristles (see `layout.MEMORY`)."""
    return any({"follow_rate", "windup", "bristle"} & effect.hooks.keys() for effect, _ in at_work(effects).values())


def record(effects: Mapping[str, Values], t: float) -> np.void | None:
    """A robot's effects for the extended kernel at the time `t` (s); None where the paper's model does."""
    working = _asked(at_work(effects))
    return _filled(working, any(name in LAWS for name in working), t) if working else None


def in_pair(effects: Mapping[str, Values], behind: int) -> dict[str, tuple[Effect, Values]]:
    """The effects at work in the pair of a robot's front module and the module `behind` (see `parts`)."""
    return _in_pair(at_work(effects), behind)


def _in_pair(working: Mapping[str, tuple[Effect, Values]], behind: int) -> dict[str, tuple[Effect, Values]]:
    """Those of the effects at work that act in the pair of the front module and the module `behind`."""
    found: dict[str, tuple[Effect, Values]] = {}
    for name, (effect, values) in working.items():
        seen = parts.for_pair(values, behind)
        if seen is not None and effect.active(seen):
            found[name] = effect, seen
    return found


def records(effects: Mapping[str, Values], t: float, modules: int) -> NDArray[np.void] | None:
    """A robot's effects for the extended kernels of so many modules at the time `t` (s).

    None where the paper's model does. Each module has what acts in its pair, the front one what acts in the first.
    """
    working = _asked(at_work(effects))
    pairs = [_in_pair(working, max(i, 1)) for i in range(modules)] if working else []
    if not any(pairs):
        return None
    laws = any(name in LAWS for pair in pairs for name in pair)
    found = np.full(modules, _NEUTRAL_LAWS if laws else _NEUTRAL)
    found["t"] = t
    for fx, pair in zip(found, pairs, strict=True):
        for name, (effect, values) in pair.items():
            fx[name] = _numbers(effect, values)
    return found


def _asked(working: Mapping[str, tuple[Effect, Values]]) -> dict[str, tuple[Effect, Values]]:
    """Those of the effects at work that compiled code asks."""
    return {name: one for name, one in working.items() if one[0].hooks}


def _filled(working: Mapping[str, tuple[Effect, Values]], laws: bool, t: float) -> np.void:
    fx: np.void = (_NEUTRAL_LAWS if laws else _NEUTRAL).copy()
    fx["t"] = t
    for name, (effect, values) in working.items():
        fx[name] = _numbers(effect, values)
    return fx


def _numbers(effect: Effect, values: Values) -> tuple[float, ...]:
    """An effect's parameters as compiled code takes them; those that are not given are neutral."""
    return tuple(one.number(values.get(key, one.neutral)) for key, one in effect.parameters.items())


def _neutral(dtype: np.dtype[np.void]) -> np.void:
    """The record of a robot without any effect, of one of the two types."""
    fx: np.void = np.zeros(1, dtype=dtype)[0]
    for name in dtype.names or ():
        if name in EFFECTS:
            fx[name] = _numbers(EFFECTS[name], {})
    return fx


_NEUTRAL, _NEUTRAL_LAWS = _neutral(RECORD_DTYPE), _neutral(LAW_DTYPE)


def _effect(name: str) -> Effect:
    if name not in EFFECTS:
        raise ArtibotError(
            f"effects.{name}: unknown effect{did_you_mean(name, EFFECTS)}; "
            f"this version simulates {', '.join(sorted(EFFECTS))}; files of your own are read by --effects DIR"
        )
    return EFFECTS[name]
