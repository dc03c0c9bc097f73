"""Evidence from outside the fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from artibot_sim.diagnose.diagnosis import Found


@dataclass(frozen=True)
class Other:
    """What the view driven by commands says of one effect.

    Attributes
    ----------
    nats : float
        Log Bayes factor.
    found : mapping of str to Found
        Its parameters there.
    excluded_above : mapping of str to float
        Departures from neutral that it excludes, by parameter.
    note : str
        Why it says nothing, where it cannot.
    excluded_below : mapping of str to float
        Values below which it excludes limits, by parameter.
    """

    nats: float
    found: Mapping[str, Found]
    excluded_above: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    excluded_below: Mapping[str, float] = field(default_factory=dict)
