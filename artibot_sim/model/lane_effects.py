"""Effects' parameters of one lane (`lanes`), under the names by which hooks ask for them."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.compiled import inlined
from artibot_sim.model.effects import RECORD_DTYPE

EFFECT_VALUES = RECORD_DTYPE.itemsize // np.dtype(np.float64).itemsize
"""How many numbers a record of effects holds; the first is the time."""


def flat(record: Any) -> NDArray[np.float64]:
    """Records of effects as rows of numbers, shape (n, EFFECT_VALUES)."""
    values: NDArray[np.float64] = np.ascontiguousarray(record).view(np.float64).reshape(-1, EFFECT_VALUES)
    return values


def reader(lanes: int) -> Callable[..., Any]:
    """A function that puts together from a block what `effects.record` would be for one lane.

    Named tuples of what hooks read: the compiler leaves out all that they do not. It is written out here because
    compiled code cannot go through names.
    """
    known: dict[str, Any] = {}
    place, entries = 1, ["t"]
    names = RECORD_DTYPE.names or ()
    for name in names[1:]:
        fields = RECORD_DTYPE[name].names or ()
        known[f"_{name}"] = namedtuple(name, fields)
        numbers = ", ".join(f"S[at + {(place + k) * lanes}]" for k in range(len(fields)))
        entries.append(f"_{name}({numbers})")
        place += len(fields)
    known["_Effects"] = namedtuple("Effects", names)
    exec(f"def lane_effects(S, at, t):\n    return _Effects({', '.join(entries)})\n", known)
    return inlined(known["lane_effects"])
