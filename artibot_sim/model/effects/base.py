"""The declaration of a model extension."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import parts
from artibot_sim.model.robot.quantity import Quantity

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import MotorParams, Params, SensorErrors

Array = NDArray[np.float64]

Step = Callable[[Array], Array]
"""From a sample of the front motors' speeds (2,), rad/s, to what comes out at that instant; it remembers the last."""

Values = Mapping[str, Any]
"""Parameters of an effect by name: numbers, and names where a parameter is a choice."""


@dataclass(frozen=True)
class Choice:
    """A parameter that is one of several names; compiled code knows it by its place among them.

    Names of parts are those of a pair of modules; a longer robot has more of them (see `parts`).
    """

    names: tuple[str, ...]
    doc: str

    def read(self, entry: Any, key: str) -> str:
        """The name, checked."""
        if isinstance(entry, Mapping):
            entry = entry.get("value")
        if not isinstance(entry, str) or parts.of_pair(entry)[0] not in self.names:
            raise ArtibotError(f"{key}: found {entry!r}, expected one of {', '.join(self.names)} ({self.doc})")
        return str(entry)

    def number(self, name: str) -> float:
        """What compiled code knows a name by, in the pair of its module."""
        return float(self.names.index(parts.of_pair(name)[0]))


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect: its declaration and the value at which the effect is absent."""

    quantity: Quantity | Choice
    neutral: float | str

    def number(self, value: float | str) -> float:
        """`value` as compiled code takes it."""
        return self.quantity.number(str(value)) if isinstance(self.quantity, Choice) else float(value)


@dataclass(frozen=True)
class Search:
    """How a diagnosis looks for an effect: data, no code.

    A fit holds an effect as coordinates that are 0 where it is absent and 1 where it is plainly visible.

    Attributes
    ----------
    sizes : mapping of str to float
        Parameter to how far from neutral it is plain. These are fitted.
    probes : tuple of tuple of float
        Coordinates at which the effect is tried, in the order of `sizes`; what is not smooth at neutral needs them.
    logarithmic : bool
        The coordinate is a logarithm's: value = (neutral or `reference`) · exp(coordinate · size).
    direction : str
        A parameter that says where to the first of `sizes` points (a heading, a phase); both are fitted as two
        components. All other sizes are in `around`.
    around : mapping of str to float
        Those of `sizes` that say nothing of how strong it is (a period, a time constant, a place), the last ones, and
        the value of each at coordinate 0: value = around · exp(coordinate · size) of what is positive, else around +
        coordinate · size, up to coordinates of ±1. The effect is absent where the other coordinates are 0.
    reference : str
        What a limit is measured by: ``"articulation"``, the largest angle seen; ``"acceleration"``, the fastest change
        of a front motor's command.
    forms : mapping of str to tuple of float
        Parameters that are not fitted, but tried at each of these values.
    disc : tuple of str
        Parameters that say where on the ground the effect is: centre (x, y) and radius.
    ridge : mapping of str to float
        Soil parameters that hide the effect best: key to the power of the value with which they change along.
    ridge_from : float
        What is added to the value there: the size that does as much as what the effect stands beside.
    least : float
        Coordinate up to which the effect cannot be simulated or distinguished from neutral.
    channels : tuple of str
        What is measured of it, where it does not change how the rover moves: without any of these it is not looked
        for. ``"pose"`` is a heading that comes with positions.
    back : bool
        Whether it acts on the back module alone: like what acts in the joint it is not looked for without one.
    views : tuple of str
        Where it shows: ``"rotation"`` (measured rotations in, motion and torques out), ``"command"`` (commands in,
        motor speeds out), ``"encoder"`` (recorded angles in, recorded speeds out).
    """

    sizes: Mapping[str, float]
    probes: tuple[tuple[float, ...], ...] = ()
    logarithmic: bool = False
    direction: str = ""
    around: Mapping[str, float] = field(default_factory=dict)
    reference: str = ""
    forms: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    disc: tuple[str, ...] = ()
    ridge: Mapping[str, float] = field(default_factory=dict)
    ridge_from: float = 0.0
    least: float = 0.0
    channels: tuple[str, ...] = ()
    back: bool = False
    views: tuple[str, ...] = ("rotation",)


@dataclass(frozen=True)
class Effect:
    """A physical effect that the paper's model leaves out.

    Attributes
    ----------
    id : str
        Name in robot files and results.
    acts : str
        Where it acts: command, drive, contact, body, joint, environment or sensor; ``"law"`` where it says itself.
    doc : str
        The physics in one sentence.
    parameters : mapping of str to EffectParameter
        The first are those that say how strong it is.
    sizes : int
        How many of them do: the effect is absent where all of these are neutral, whatever the others are.
    adapt : callable, optional
        (Params, values) → Params: what the effect changes in the numbers of the paper's model.
    hooks : mapping of str to compiled function
        What the extended kernel calls, by the hook's name (see `effects.hooks`).
    command : callable, optional
        (values, h, first) → `Step`: what happens to commands on their way to the front motors, sampled each `h` s,
        `first` (2,) having been commanded for long. See `commands.as_executed`.
    sensor : callable, optional
        (SensorErrors, values) → SensorErrors: what the effect changes in what sensors make of the truth.
    law : callable, optional
        values → those of the `force_law` that the effect is: it takes the place of one that the robot does not have.
    check : callable, optional
        (values, path): refuses parameters that do not go together; `path` says where they stand.
    drives_front : bool
        Whether it acts on front motors only where they are driven.
    uniform : bool
        Whether a rover does the same wherever it is and whichever way it heads.
    search : Search, optional
        How a diagnosis looks for it.
    claim : str
        What it says of a rover, to be checked on it: a clause with parameters in braces. ``{x|ahead of|behind}`` is the
        size of x and the first words where it is positive, else the second; ``{scale-1|…|…}`` counts from 1.
    """

    id: str
    acts: str
    doc: str
    parameters: Mapping[str, EffectParameter]
    sizes: int = 1
    adapt: Callable[[Params, Values], Params] | None = None
    hooks: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    command: Callable[[Values, float, Array], Step] | None = None
    sensor: Callable[[SensorErrors, Values], SensorErrors] | None = None
    law: Callable[[Values], Values] | None = None
    check: Callable[[Values, str], None] | None = None
    drives_front: bool = False
    uniform: bool = True
    search: Search | None = None
    claim: str = ""

    def read(self, entries: Any, path: str) -> dict[str, float | str]:
        """Parameter values from a robot file's entry, checked; absent ones are neutral."""
        if not isinstance(entries, Mapping):
            raise ArtibotError(f"{path}: found {entries!r}, expected the parameters {', '.join(self.parameters)}")
        for key in entries:
            if key not in self.parameters:
                raise ArtibotError(f"{path}.{key}: unknown key; expected one of {', '.join(self.parameters)}")
        values = {
            name: _value(entries[name], parameter.quantity, f"{path}.{name}") if name in entries else parameter.neutral
            for name, parameter in self.parameters.items()
        }
        if self.check is not None:
            self.check(values, path)
        return values

    def active(self, values: Values) -> bool:
        """Whether these values make a difference."""
        neutral = self._neutral
        for key, value in values.items():
            name = key if key in self.parameters else parts.of_pair(key)[0]
            if name in neutral and value != neutral[name]:
                return True
        return False

    @cached_property
    def _neutral(self) -> dict[str, float | str]:
        """Neutral values of the parameters that say how strong it is."""
        return {name: self.parameters[name].neutral for name in list(self.parameters)[: self.sizes]}


def number(
    unit: str, low: float, high: float, doc: str, neutral: float = 0.0, *, low_open: bool = False
) -> EffectParameter:
    """Declare a parameter that is a number within bounds (an infinite one only where it is neutral)."""
    return EffectParameter(Quantity(unit, low, high, doc, low_open, math.isinf(high) and neutral != high), neutral)


def choice(names: tuple[str, ...], doc: str) -> EffectParameter:
    """Declare a parameter that is one of several names; the first stands where none is given."""
    return EffectParameter(Choice(names, doc), names[0])


def with_every_motor(p: Params, changed: Callable[[MotorParams], MotorParams]) -> Params:
    """Parameters of a rover all four of whose motors, with gears and wheels, are changed alike."""
    return p._replace(
        right_front=changed(p.right_front), left_front=changed(p.left_front),
        right_back=changed(p.right_back), left_back=changed(p.left_back),
    )  # fmt: skip


def _value(entry: Any, quantity: Quantity | Choice, key: str) -> float | str:
    if isinstance(quantity, Choice):
        return quantity.read(entry, key)
    if isinstance(entry, Mapping):
        if entry.get("unit", quantity.unit) != quantity.unit:
            raise ArtibotError(f"{key}.unit: found '{entry['unit']}', expected '{quantity.unit}'")
        entry = entry.get("value")
    if isinstance(entry, bool) or not isinstance(entry, int | float):
        raise ArtibotError(f"{key}: found {entry!r}, expected a number in {quantity.unit}")
    quantity.check(key, float(entry))
    return float(entry)
