"""How a physical parameter is declared: once, with its unit, bounds and meaning."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from artibot_sim.errors import ArtibotError


@dataclass(frozen=True)
class Quantity:
    """What a parameter is: unit, bounds and meaning.

    Attributes
    ----------
    unit : str
        SI unit as it stands in a robot file.
    low, high : float
        Bounds; a bound belongs to the allowed range only if the matching ``*_open`` is False.
    doc : str
        One line for a person.
    """

    unit: str
    low: float
    high: float
    doc: str
    low_open: bool = False
    high_open: bool = False

    def check(self, key: str, value: float) -> None:
        """Raise :class:`ArtibotError` unless `value` is finite (or an allowed infinity) and within the bounds."""
        below = value <= self.low if self.low_open else value < self.low
        above = value >= self.high if self.high_open else value > self.high
        if math.isnan(value) or below or above:
            left, right = "(" if self.low_open else "[", ")" if self.high_open else "]"
            unit = "" if self.unit == "-" else f" {self.unit}"
            raise ArtibotError(
                f"{key}: {value:g}{unit} is out of bounds; expected a value in "
                f"{left}{self.low:g}, {self.high:g}{right}{unit} ({self.doc})"
            )


def quantity(
    unit: str,
    low: float,
    high: float,
    doc: str,
    default: float | None = None,
    *,
    low_open: bool = False,
    high_open: bool = False,
) -> Any:
    """Declare a dataclass field that is a physical parameter; with a default it may be absent from a file."""
    metadata = {"quantity": Quantity(unit, low, high, doc, low_open, high_open)}
    return field(metadata=metadata) if default is None else field(default=default, metadata=metadata)


def positive(unit: str, doc: str, default: float | None = None) -> Any:
    """A parameter that is finite and greater than zero."""
    return quantity(unit, 0.0, math.inf, doc, default, low_open=True, high_open=True)


def not_negative(unit: str, doc: str, default: float | None = None) -> Any:
    """A parameter that is finite and zero or more."""
    return quantity(unit, 0.0, math.inf, doc, default, high_open=True)
