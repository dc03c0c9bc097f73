"""Axes of a sweep: what a key takes one value after another of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.documents import did_you_mean
from artibot_sim.errors import ArtibotError

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
