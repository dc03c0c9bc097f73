"""A second force that follows a variable, see `force_law`."""

from __future__ import annotations

from artibot_sim.model.effects.force_law import NAMES, declared

EFFECT = declared(NAMES[1])
