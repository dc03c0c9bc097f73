"""Effects' parameters of one lane (`lanes`), under the names by which hooks ask for them."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.compiled import inlined
from artibot_sim.model.effects import EFFECTS, RECORD_DTYPE, at_work
from artibot_sim.model.effects.base import Values

EFFECT_VALUES = RECORD_DTYPE.itemsize // np.dtype(np.float64).itemsize
"""How many numbers a record of effects holds; the first is the time."""


def flat(record: Any) -> NDArray[np.float64]:
    """Records of effects as rows of numbers, shape (n, EFFECT_VALUES)."""
    values: NDArray[np.float64] = np.ascontiguousarray(record).view(np.float64).reshape(-1, EFFECT_VALUES)
    return values


SLOW_HOOKS = {"friction", "lead", "follow_rate", "resist"}
"""Hooks whose answers cost more than all others together: exponentials, roots and quotients for every wheel."""

LIGHT, FULL = (1.0,), (1.0, 1.0)
"""Stand for the extended model as `fx` of lanes: without effects that answer SLOW_HOOKS, and with them."""


def extension(effects: Mapping[str, Values]) -> tuple[float, ...] | None:
    """What of the model a robot's effects need: None, LIGHT or FULL."""
    hooks = {hook for effect, _ in at_work(effects).values() for hook in effect.hooks}
    return None if not hooks else FULL if hooks & SLOW_HOOKS else LIGHT


def reader(lanes: int, full: bool) -> Callable[..., Any]:
    """A function that puts together from a block what `effects.record` would be for one lane.

    Named tuples of what hooks read: the compiler leaves out all that they do not, and all that comes of effects which
    are neutral here because it is not the `full` model. It is written out because compiled code cannot go through
    names.
    """
    known: dict[str, Any] = {}
    place, entries = 1, ["t"]
    names = RECORD_DTYPE.names or ()
    for name in names[1:]:
        parameters = EFFECTS[name].parameters
        known[f"_{name}"] = namedtuple(name, parameters)
        numbers = [f"S[at + {(place + k) * lanes}]" for k in range(len(parameters))]
        if not full and SLOW_HOOKS & set(EFFECTS[name].hooks):
            numbers = [repr(parameter.number(parameter.neutral)) for parameter in parameters.values()]
        entries.append(f"_{name}({', '.join(numbers)})")
        place += len(parameters)
    known["_Effects"] = namedtuple("Effects", names)
    exec(f"def lane_effects(S, at, t):\n    return _Effects({', '.join(entries)})\n", known)
    return inlined(known["lane_effects"])
