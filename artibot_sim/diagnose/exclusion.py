"""From which size on an effect that was not found is excluded: one of that size would have been named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from artibot_sim.diagnose.patches import RADII, told_along
from artibot_sim.diagnose.screen import Around, Trial
from artibot_sim.diagnose.thresholds import Thresholds
from artibot_sim.identify.extension import SPREAD, Extension

_MARGIN = 2.0
"""Standard deviations that chance may take from an effect of that size."""
_FAITHFUL = 0.9
"""Share of a size that is found at least."""
_GROUND = 0.9
"""Share of the ground driven on for which a patch is excluded."""
_FARTHEST = 20.0
"""Plain sizes from which on nothing is excluded: a rover not pushed by 700 N is no news."""


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
        reach = _reach(sd, len(extension), least + thresholds.more(trial.id), thresholds)
        if extension.search.least:  # not smooth at neutral: nothing smaller than its probes was looked for
            reach = max(reach, min(float(np.linalg.norm(probe)) for probe in trial.hypothesis.probes))
        if reach > _FARTHEST:
            return {}
        for name, size in extension.search.sizes.items():
            bound = float(np.expm1(reach * size)) if extension.search.logarithmic else reach * size
            found[name] = max(found.get(name, 0.0), bound)
    return found


def excluded_patch(base: Around, effect: str, least: float, thresholds: Thresholds) -> dict[str, float]:
    """The same of a disc on the ground, which may lie anywhere: the departure that nine tenths of the ground exclude.

    Parameters
    ----------
    base : Around
        The fit that leaves nothing to be named.
    effect : str
    least : float
        Nats that it has to gain.
    """
    told = told_along(base, effect)
    here = np.sort(told)[int(np.ceil(_GROUND * len(told))) - 1] if len(told) else np.inf
    if not np.isfinite(here):
        return {}
    among = float(np.log(len(told) * len(RADII)))
    reach, extension = _reach(float(here), 1, least + thresholds.more(effect) + among, thresholds), Extension(effect)
    if reach > _FARTHEST:
        return {}
    return {name: float(np.expm1(reach * size)) for name, size in extension.search.sizes.items()}


def _reach(sd: float, size: int, needed: float, thresholds: Thresholds) -> float:
    """The coordinate that two deviations less than it would still be named by, of so many that are fitted."""
    occam = size * max(0.0, float(np.log(SPREAD / sd)))
    gained = sd * (float(np.sqrt(2.0 * (needed + occam))) + _MARGIN)
    return max(gained, float((thresholds.size + _MARGIN * sd) / _FAITHFUL))


def excluded_below(trial: Trial, least: float, thresholds: Thresholds) -> dict[str, float]:
    """Values below which a limit is excluded, by parameter; empty for what is no limit.

    A limit is told by what goes beyond it: the gentlest of the values at which it was tried that two deviations less
    would still have told, all tighter ones being told as well.
    """
    extension, found = trial.hypothesis.extension, dict[str, float]()
    if not extension.search.reference:
        return found
    for own, cost in sorted(trial.tested, key=lambda one: float(one[0][0])):
        if np.sqrt(max(cost, 0.0)) - _MARGIN < np.sqrt(2.0 * (least + thresholds.more(trial.id))):
            break
        found = {name: float(extension.values(own)[name]) for name in extension.search.sizes}
    return found
