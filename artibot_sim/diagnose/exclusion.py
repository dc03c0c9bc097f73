"""From which size on an effect that was not found is excluded: one of that size would have been named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from artibot_sim.diagnose.screen import Trial
from artibot_sim.diagnose.thresholds import Thresholds
from artibot_sim.identify.extension import SPREAD

_MARGIN = 2.0
"""Standard deviations that chance may take from an effect of that size."""
_FAITHFUL = 0.9
"""Share of a size that is found at least."""


def excluded(trials: Sequence[Trial], least: float, thresholds: Thresholds) -> dict[str, float]:
    """Departures from neutral that are excluded, by parameter; of several choices the weakest bound.

    With σ the standard deviation of the effect's coordinate x (the wider of what sensitivities and finite probes say,
    soil free in both), the evidence grows as x²/2σ² less Occam's factor ln(1.5/σ). Excluded is where two deviations
    less than x would still gain what it takes to be named, and be as large as it takes.

    Parameters
    ----------
    trials : sequence of Trial
        The effect's, one for each choice.
    least : float
        Nats that an effect has to gain.
    """
    found: dict[str, float] = {}
    for trial in trials:
        extension = trial.hypothesis.extension
        sd = float(max(np.max(trial.sd), trial.blur))
        if not np.isfinite(sd) or extension.search.reference:
            return {}
        occam = len(extension) * max(0.0, float(np.log(SPREAD / sd)))
        needed = least + thresholds.more(trial.id) + occam
        gained = sd * (float(np.sqrt(2.0 * needed)) + _MARGIN)
        reach = max(gained, float((thresholds.size + _MARGIN * sd) / _FAITHFUL))
        if extension.search.least:  # not smooth at neutral: nothing smaller than its probes was looked for
            reach = max(reach, min(float(np.linalg.norm(probe)) for probe in trial.hypothesis.probes))
        for name, size in extension.search.sizes.items():
            bound = float(np.expm1(reach * size)) if extension.search.logarithmic else reach * size
            found[name] = max(found.get(name, 0.0), bound)
    return found


def excluded_below(trials: Sequence[Trial], least: float, thresholds: Thresholds) -> dict[str, float]:
    """Values below which limits are excluded, by parameter; empty for what is no limit, or where none was tried.

    A limit is told by what goes beyond it: the gentlest of the values at which it was tried that two deviations less
    would still have told, all tighter ones being told as well; of several choices the weakest bound.

    Parameters
    ----------
    trials : sequence of Trial
        The effect's, one for each choice.
    least : float
        Nats that an effect has to gain.
    """
    found: dict[str, float] = {}
    for trial in trials:
        extension = trial.hypothesis.extension
        if not extension.search.reference:
            return {}
        bound: dict[str, float] = {}
        for own, cost in sorted(trial.tested, key=lambda one: float(one[0][0])):
            if np.sqrt(max(cost, 0.0)) - _MARGIN < np.sqrt(2.0 * (least + thresholds.more(trial.id))):
                break
            bound = {name: float(extension.values(own)[name]) for name in extension.search.sizes}
        if not bound:
            return {}
        found = {name: min(found.get(name, value), value) for name, value in bound.items()}
    return found
