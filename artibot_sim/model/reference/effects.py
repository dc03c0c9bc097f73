"""The effects' laws as Python runs them: the very lines of `artibot_sim.model.effects`, not compiled.

Test `test/model/test_laws.py` holds each of them against a transcription of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, reduce
from types import FunctionType, SimpleNamespace
from typing import Any

from artibot_sim.model.effects import EFFECTS, at_work
from artibot_sim.model.effects.base import Values
from artibot_sim.model.effects.hooks import PLACES
from artibot_sim.model.kernels import elementary

Law = Callable[..., Any]

_STANDARD: dict[Law, Law] = {
    elementary.tanh: math.tanh,
    elementary.exp: math.exp,
    elementary.log: math.log,
    elementary.sincos: lambda angle: (math.sin(angle), math.cos(angle)),
}
"""What stands in plain Python for the functions that compiled code has of its own."""


def plain(function: Law) -> Law:
    """A piece of the model as plain Python, with all that it calls."""
    if function in _STANDARD:
        return _STANDARD[function]
    python: Any = getattr(function, "py_func", function)
    known = python.__globals__
    names = {name: known[name] for name in python.__code__.co_names if name in known}
    pieces = {name: plain(piece) for name, piece in names.items() if hasattr(piece, "py_func") or piece in _PIECES}
    return FunctionType(python.__code__, known | pieces, python.__name__, python.__defaults__, python.__closure__)


_PIECES = tuple(_STANDARD)


@lru_cache
def _answers(place: str) -> Law:
    """The answers of all effects at a place, see `effects.hooks`."""
    laws = [plain(effect.hooks[place]) for effect in EFFECTS.values() if place in effect.hooks]
    return reduce(PLACES[place].combine, laws)


@dataclass(frozen=True)
class PlainEffects:
    """A robot's effects at the time `t` (s); without any the model is the paper's."""

    values: Mapping[str, Values] = field(default_factory=dict)
    t: float = 0.0

    def at(self, t: float) -> PlainEffects:
        """These effects at another time `t`, s."""
        return PlainEffects(self.values, t)

    def of_module(self, module: int) -> PlainEffects:
        """These effects as a module computes that stands for itself, in the place of the front one."""
        return _OfModule(self.values, self.t, module) if module else self

    def ask(self, place: str, *about: Any) -> Any:
        """What the effects answer at a place (`effects.hooks`), from what follows the record there."""
        return _answers(place)(self._record, *about)

    @cached_property
    def _record(self) -> SimpleNamespace:
        """As `effects.record`: each effect's parameters under its name."""
        working = at_work(self.values)
        known: dict[str, Any] = {"t": self.t}
        for name, effect in EFFECTS.items():
            values = working[name][1] if name in working else {}
            numbers = {key: one.number(values.get(key, one.neutral)) for key, one in effect.parameters.items()}
            known[name] = SimpleNamespace(**numbers)
        return SimpleNamespace(**known)


_NUMBERED = {"centre": 1, "push": 1, "load": 1, "resist": 1, "drag": 2, "radius": 4}
"""Places that are told a module's number, or that of one of its two motors or four wheels: how many a module has."""


@dataclass(frozen=True)
class _OfModule(PlainEffects):
    """The effects for one module of many: its parts' numbers are counted on from those of the modules ahead."""

    module: int = 0

    def ask(self, place: str, *about: Any) -> Any:
        if place in _NUMBERED:
            about = (about[0] + _NUMBERED[place] * self.module, *about[1:])
        return super().ask(place, *about)


NEUTRAL = PlainEffects()
