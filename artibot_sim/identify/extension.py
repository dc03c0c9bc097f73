"""An effect as coordinates of a fit: 0 where it is absent, 1 where it is plain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Effect, Search
from artibot_sim.model.quantity import Quantity

Array = NDArray[np.float64]

STEP = 0.02
"""Change of a coordinate for its finite difference."""
SPREAD = 1.5
"""Standard deviation of a coordinate's prior: effects are about as large as what is plain, or a few times so."""
_FARTHEST = 12.0
"""Coordinates end here."""
_SMALLEST = 0.05
"""Least factor by which a logarithmic value can fall."""


@dataclass(frozen=True)
class Extension:
    """One effect in a fit.

    Attributes
    ----------
    id : str
        Of the effect.
    fixed : mapping of str to float or str
        Parameters that are not fitted: which motor, where on the ground.
    reference : float
        What the logarithm of a value without a finite neutral one is taken from (`Search.reference`).
    """

    id: str
    fixed: Mapping[str, float | str] = field(default_factory=dict)
    reference: float = 1.0

    def __len__(self) -> int:
        return len(self.search.sizes) + bool(self.search.direction)

    @property
    def effect(self) -> Effect:
        """Its declaration."""
        return EFFECTS[self.id]

    @cached_property
    def search(self) -> Search:
        """How it is looked for."""
        found = self.effect.search
        if found is None:
            raise ArtibotError(f"effects.{self.id}: has no coordinates; it declares no `search`")
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that are fitted; of a size with a direction its components along x and y."""
        names = tuple(self.search.sizes)
        return tuple(f"{names[0]}_{axis}" for axis in "xy") if self.search.direction else names

    @cached_property
    def _origin(self) -> Array:
        """Values at coordinate 0, shape (sizes,)."""
        neutral = [float(self.effect.parameters[name].neutral) for name in self.search.sizes]
        if self.search.logarithmic:
            return np.array([n if math.isfinite(n) and n > 0.0 else self.reference for n in neutral])
        return np.array(neutral)

    @cached_property
    def _scale(self) -> Array:
        return np.array(list(self.search.sizes.values()))

    def values(self, coordinates: Array) -> dict[str, Any]:
        """Parameters of the effect at coordinates (len,); neutral where it is absent."""
        c = np.asarray(coordinates, float)
        if self.search.direction:
            size = min(float(self._scale[0] * np.hypot(c[0], c[1])), float(self._limits[1][0]))
            turned = {self.search.direction: float(np.arctan2(c[1], c[0])) if size else 0.0}
            return {next(iter(self.search.sizes)): size, **turned, **self.fixed}
        if self.search.logarithmic:
            values = self._origin * np.exp(c * self._scale)
        else:
            values = self._origin + c * self._scale
        low, high = self._limits
        return dict(zip(self.search.sizes, values.clip(low, high).tolist(), strict=True)) | dict(self.fixed)

    def coordinates(self, values: Mapping[str, Any]) -> Array:
        """Coordinates (len,) at parameters of the effect."""
        known = np.array([float(values[name]) for name in self.search.sizes])
        if self.search.direction:
            heading = float(values[self.search.direction])
            return np.asarray(known[0] / self._scale[0] * np.array([np.cos(heading), np.sin(heading)]), float)
        if self.search.logarithmic:
            return np.asarray(np.log(known / self._origin) / self._scale, float)
        return np.asarray((known - self._origin) / self._scale, float)

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """Least and largest values, shape (sizes,) each."""
        quantities = [self.effect.parameters[name].quantity for name in self.search.sizes]
        ends = [(q.low, q.high) for q in quantities if isinstance(q, Quantity)]
        return np.array([low for low, _ in ends]), np.array([high for _, high in ends])

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest coordinates (len,)."""
        if self.search.direction:
            return np.full(2, -_FARTHEST), np.full(2, _FARTHEST)
        ends = np.array(self._limits)
        if self.search.logarithmic:
            ends = np.log(np.maximum(ends / self._origin, _SMALLEST)) / self._scale
        else:
            ends = (ends - self._origin) / self._scale
        least = max(self.search.least, -_FARTHEST) if self.one_sided else -_FARTHEST
        return np.maximum(ends[0], least), np.minimum(ends[1], _FARTHEST)

    @property
    def one_sided(self) -> bool:
        """Whether the coordinates cannot be negative."""
        parameter = self.effect.parameters[next(iter(self.search.sizes))]
        return (
            not self.search.direction and isinstance(parameter.quantity, Quantity)
            and parameter.quantity.low == parameter.neutral
        )  # fmt: skip

    @property
    def label(self) -> str:
        """The effect's id with what is fixed, for messages."""
        said = [f"{v:.2f}" if isinstance(v, float) else str(v) for v in self.fixed.values()]
        return f"{self.id}({', '.join(said)})" if said else self.id

    @property
    def keys(self) -> tuple[str, ...]:
        """Of the coordinates among all of a fit."""
        return tuple(f"effects.{self.id}.{name}" for name in self.names)

    def nearest(self, coordinates: Array) -> Array:
        """The nearest coordinates (len,) within bounds."""
        low, high = self.bounds
        return np.asarray(np.clip(coordinates, low, high), float)
