"""Whether all positions are in one map: only then has what is fixed in the map one place and one heading."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from artibot_sim.estimation.measurements import Stretch
from artibot_sim.experiment import Experiment
from artibot_sim.experiment.measured import Measured
from artibot_sim.model.effects import EFFECTS

_TOLERANCE = 0.5
"""m that positions may jump over a gap, beyond what the rover drove at twice its mean speed meanwhile."""
_SAME = 0.05
"""m within which segments begin at one place: a pose that is set to zero at the start of each."""
_FEWEST = 3
"""Segments that begin at one place, from which that is no chance."""

NEEDS = {"map": "a common map", "heading": "a common heading"}
"""What an effect needs of all recordings → words."""


def needed(effect: str) -> str:
    """What an effect needs of the recordings' poses, in words: it is fixed in the map; empty where it is not."""
    declared = EFFECTS[effect]
    if declared.search is None or declared.uniform:
        return ""
    return NEEDS["map"] if declared.search.disc else NEEDS["heading"] if declared.search.direction else ""


def in_common_map(recordings: Iterable[Experiment]) -> bool:
    """Whether the segments of each recording can be parts of one drive; recordings are taken to share their map."""
    return all(_continuous(experiment) for experiment in recordings)


def experiments_of(stretches: Iterable[Stretch]) -> list[Experiment]:
    """The recordings that stretches are parts of, each once."""
    return list({id(one.experiment): one.experiment for one in stretches}.values())


def _continuous(experiment: Experiment) -> bool:
    """Whether positions go on over the gaps between segments, and segments do not all begin at one place."""
    parts = [Measured(experiment, begin, end).position() for begin, end in experiment.segments]
    parts = [(t, points) for t, points in parts if len(t)]
    if len(parts) < 2:
        return True
    starts = np.array([points[0] for _, points in parts])
    if len(parts) >= _FEWEST and float(np.hypot(*(starts - starts[0]).T).max()) < _SAME:
        return False
    way = sum(float(np.hypot(*np.diff(points, axis=0).T).sum()) for _, points in parts)
    speed = 2.0 * way / max(sum(float(t[-1] - t[0]) for t, _ in parts), 1e-9)
    jumps = [
        float(np.hypot(*(after[0] - before[-1]))) - speed * float(t[0] - last[-1])
        for (last, before), (t, after) in zip(parts, parts[1:], strict=False)
    ]
    return max(jumps) < _TOLERANCE
