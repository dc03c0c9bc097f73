"""The declaration of a model extension."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.model.quantity import Quantity


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect: its declaration and the value at which the effect is absent."""

    quantity: Quantity
    neutral: float


@dataclass(frozen=True)
class Effect:
    """A physical effect that the paper's model leaves out.

    Attributes
    ----------
    id : str
        Name in robot files and results.
    acts : str
        Where it acts: command, drive, contact, body, joint, environment or sensor.
    doc : str
        The physics in one sentence.
    parameters : mapping of str to EffectParameter
    """

    id: str
    acts: str
    doc: str
    parameters: Mapping[str, EffectParameter]

    def read(self, entries: Any, path: str) -> dict[str, float]:
        """Parameter values from a robot file's entry, checked; absent ones are neutral."""
        if not isinstance(entries, Mapping):
            raise ArtibotError(f"{path}: found {entries!r}, expected the parameters {', '.join(self.parameters)}")
        for key in entries:
            if key not in self.parameters:
                raise ArtibotError(f"{path}.{key}: unknown key; expected one of {', '.join(self.parameters)}")
        return {
            name: _value(entries[name], parameter.quantity, f"{path}.{name}") if name in entries else parameter.neutral
            for name, parameter in self.parameters.items()
        }


def _value(entry: Any, quantity: Quantity, key: str) -> float:
    if isinstance(entry, Mapping):
        if entry.get("unit", quantity.unit) != quantity.unit:
            raise ArtibotError(f"{key}.unit: found '{entry['unit']}', expected '{quantity.unit}'")
        entry = entry.get("value")
    if isinstance(entry, bool) or not isinstance(entry, int | float):
        raise ArtibotError(f"{key}: found {entry!r}, expected a number in {quantity.unit}")
    quantity.check(key, float(entry))
    return float(entry)
