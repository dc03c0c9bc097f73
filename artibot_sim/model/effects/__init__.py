"""Model extensions: what the paper's model leaves out, each in one place.

An effect is declared and computed in one file of this package; at its neutral value the model is bit-identical
to the paper's. A robot file names the ones at work under ``effects``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects.base import Effect
from artibot_sim.model.effects.slope import SLOPE

EFFECTS: dict[str, Effect] = {effect.id: effect for effect in (SLOPE,)}
"""Every effect by id."""


def effects_from_dict(document: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Check the ``effects`` section of a robot file.

    Each effect's parameters stand as numbers or as ``{value, unit, source}``; a parameter that is not given has
    its neutral value.
    """
    return {name: _effect(name).read(entries, f"effects.{name}") for name, entries in document.items()}


def _effect(name: str) -> Effect:
    if name not in EFFECTS:
        raise ArtibotError(f"effects.{name}: unknown effect; this version simulates {', '.join(sorted(EFFECTS))}")
    return EFFECTS[name]
