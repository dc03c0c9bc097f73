"""The effects' laws as Python runs them: the very lines of `artibot_sim.model.effects`, not compiled.

Test `test/model/test_laws.py` holds each of them against a transcription of its own.
"""

from __future__ import annotations

import dis
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, reduce
from types import CellType, FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.effects import EFFECTS, LAWS, at_work, in_pair
from artibot_sim.model.effects.base import Values
from artibot_sim.model.effects.force_law import MOTION
from artibot_sim.model.effects.hooks import PLACES
from artibot_sim.model.kernels import elementary
from artibot_sim.model.robot.parameters import MotorParams, Params, Train

Law = Callable[..., Any]
Array = NDArray[np.float64]

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
    # not all of `co_names`, which has attributes, too: a law may be named as a parameter that it reads
    called = {one.argval for one in dis.get_instructions(python) if one.opname == "LOAD_GLOBAL"}
    names = {name: known[name] for name in called if name in known}
    pieces = {name: plain(piece) for name, piece in names.items() if _compiled(piece)}
    cells = [cell.cell_contents for cell in python.__closure__ or ()]
    closure = tuple(CellType(plain(piece) if _compiled(piece) else piece) for piece in cells)
    return FunctionType(python.__code__, known | pieces, python.__name__, python.__defaults__, closure)


_PIECES = tuple(_STANDARD)


def _compiled(piece: Any) -> bool:
    return hasattr(piece, "py_func") or piece in _PIECES


@lru_cache
def _answers(place: str) -> Law:
    """The answers of all effects at a place, see `effects.hooks`."""
    laws = dict.fromkeys(effect.hooks[place] for effect in EFFECTS.values() if place in effect.hooks)
    return reduce(PLACES[place].combine, map(plain, laws))


@dataclass(frozen=True)
class PlainEffects:
    """A robot's effects at the time `t` (s); without any the model is the paper's."""

    values: Mapping[str, Values] = field(default_factory=dict)
    t: float = 0.0
    motion: Mapping[str, Array] = field(default_factory=lambda: {name: np.zeros(count) for name, count in MOTION})

    def at(self, t: float) -> PlainEffects:
        """These effects at another time `t`, s."""
        return replace(self, t=t)

    def without_laws(self) -> PlainEffects:
        """All of these that are on the list of effects."""
        working = at_work(self.values)
        return replace(self, values={name: values for name, (_, values) in working.items() if name not in LAWS})

    def with_motion(self, p: Params, q: Array, v: Array) -> PlainEffects:
        """These effects where laws see a rover at q and v (16,)."""
        wheels = [unit.tau * q[c] for unit, c in zip(_motors(p), (6, 7, 14, 15), strict=False)]
        bend = (q[13] - q[5], v[13] - v[5]) if p.two else (0.0, 0.0)
        bodies = [_motion(q[k : k + 8], v[k : k + 8]) for k in (0, 8)[: 2 if p.two else 1]]
        return replace(self, motion=_noted(bodies, wheels, bend))

    def in_pair(self, behind: int) -> PlainEffects:
        """Of these what acts in the pair of the front module and the module `behind`, see `effects.parts`."""
        return replace(self, values={name: values for name, (_, values) in in_pair(self.values, behind).items()})

    def with_motion_of_pair(self, behind: int, p: Train, q: Array, v: Array) -> PlainEffects:
        """What acts in the pair of the front module and that `behind`; laws see it and its joint at q and v (8 n,)."""
        k, places = 8 * behind, (0, behind)
        wheels = [
            motor.tau * q[8 * i + 6 + side]
            for i in places
            for side, motor in enumerate((p.modules[i].right_front, p.modules[i].left_front))
        ]
        bodies = [_motion(q[8 * i : 8 * i + 8], v[8 * i : 8 * i + 8]) for i in places]
        bend = q[k + 5] - q[k - 3], v[k + 5] - v[k - 3]
        return replace(self.in_pair(behind), motion=_noted(bodies, wheels, bend))

    def of_module(self, module: int) -> PlainEffects:
        """As one module of a pair computes, which stands for itself in the place of the front one."""
        return _OfModule(self.values, self.t, self.motion, min(module, 1)) if module else self

    def ask(self, place: str, *about: Any) -> Any:
        """What the effects answer at a place (`effects.hooks`), from what follows the record there."""
        return _answers(place)(self._record, *about)

    @cached_property
    def _record(self) -> SimpleNamespace:
        """Each effect's parameters under its name, as `effects.record` has them for compiled code."""
        working = at_work(self.values)
        known: dict[str, Any] = {"t": self.t}
        for name, effect in EFFECTS.items():
            values = working[name][1] if name in working else {}
            numbers = {key: one.number(values.get(key, one.neutral)) for key, one in effect.parameters.items()}
            known[name] = SimpleNamespace(**numbers)
        known["motion"] = SimpleNamespace(**{name: values.copy() for name, values in self.motion.items()})
        return SimpleNamespace(**known)


_NUMBERED = {
    "centre": 1, "push": 1, "load": 1, "resist": 1, "drag": 2, "shaft": 2, "along": 2, "radius": 4, "across": 4,
}  # fmt: skip
"""Places that are given a module's number, or that of one of its two motors or four wheels: how many a module has."""


@dataclass(frozen=True)
class _OfModule(PlainEffects):
    """The effects for one module of a pair: its parts' numbers are counted on from those of the module ahead."""

    module: int = 0

    def ask(self, place: str, *about: Any) -> Any:
        if place in _NUMBERED:
            about = (about[0] + _NUMBERED[place] * self.module, *about[1:])
        return super().ask(place, *about)


_POSE = ("x", "y", "yaw", "forward", "left", "turn")


def _motors(p: Params) -> list[MotorParams]:
    return [p.right_front, p.left_front, p.right_back, p.left_back][: 4 if p.two else 2]


def _motion(q: Array, v: Array) -> tuple[float, ...]:
    """Pose of a module at q and v (8,) and its velocity in its own yaw frame, in the order of `_POSE`."""
    s, c = math.sin(q[5]), math.cos(q[5])
    return q[0], q[1], q[5], c * v[0] + s * v[1], c * v[1] - s * v[0], v[5]


def _noted(bodies: list[tuple[float, ...]], wheels: list[float], bend: tuple[float, float]) -> dict[str, Array]:
    """What laws see (see `force_law.MOTION`) of modules, of wheels' angles and of the articulation."""
    motion = {name: np.zeros(count) for name, count in MOTION}
    for i, body in enumerate(bodies):
        for name, number in zip(_POSE, body, strict=True):
            motion[name][i] = number
    motion["angle"][: len(wheels)] = wheels
    motion["bend"][0], motion["bend_rate"][0] = bend
    return motion


NEUTRAL = PlainEffects()
