"""Which recordings are fitted and which are held out, under names of their own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.records import LAST_THIRD
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.measurements import Stretch, stretches
from artibot_sim.experiment import Experiment
from artibot_sim.model import Robot

Array = NDArray[np.float64]

_FEWEST = 12
"""Positions of a recording, without which its last third is too little to be held out."""


def distinctly_named(
    recordings: Sequence[Experiment], holdout: Sequence[Experiment]
) -> tuple[list[Experiment], list[Experiment]]:
    """Recordings under names of their own: `monday/run0` and `tuesday/run0` are both `run0` in their bags."""
    every, seen = sorted([*recordings, *holdout], key=_order), Counter[str]()
    names: dict[int, str] = {}
    for one in every:
        seen[one.name] += 1
        names[id(one)] = one.name if seen[one.name] == 1 else f"{one.name} ({seen[one.name]})"
    fitted, held = ([replace(one, name=names[id(one)]) for one in group] for group in (recordings, holdout))
    return fitted, held


def split(
    recordings: Sequence[Experiment], holdout: Sequence[Experiment], robot: Robot
) -> tuple[list[Experiment], list[Experiment]]:
    """Recordings to fit and to hold out, in an order that does not depend on theirs."""
    fitted, held = sorted(recordings, key=_order), sorted(holdout, key=_order)
    if not held and len(fitted) > 1:
        return fitted[:-1], fitted[-1:]
    if not held:
        return first_part(fitted[0], robot)
    return fitted, held


def first_part(experiment: Experiment, robot: Robot) -> tuple[list[Experiment], list[Experiment]]:
    """The first two thirds of what a recording measured of positions while its motors were, and the rest.

    Raises
    ------
    ArtibotError
        Where that is too little to be held out.
    """
    begin, end = experiment.segments[0][0], experiment.segments[-1][1]
    times = np.sort(np.concatenate([_measured(stretch) for stretch in stretches(experiment, robot)]))
    if len(times) < _FEWEST:
        raise ArtibotError(
            f"{experiment.path}: {len(times)} positions are measured while its motors are: too few to hold some out, "
            f"expected at least {_FEWEST}; record longer, or give another recording with --holdout"
        )
    border = float(times[2 * len(times) // 3])
    parts = []
    for name, a, b in (("", begin, border), (LAST_THIRD, border, end)):
        segments = tuple((max(s, a), min(e, b)) for s, e in experiment.segments if max(s, a) < min(e, b))
        channels = {key: channel.between(a, b) for key, channel in experiment.channels.items()}
        channels = {key: channel for key, channel in channels.items() if len(channel)}
        parts.append(replace(experiment, name=experiment.name + name, channels=channels, segments=segments))
    return parts[:1], parts[1:]


def _measured(stretch: Stretch) -> Array:
    """Times of a stretch's positions, s."""
    t = next(series.t for series in stretch.series if series.channel == "position")
    return t[(t >= stretch.inputs.t[0]) & (t <= stretch.inputs.t[-1])]


def _order(experiment: Experiment) -> tuple[str, int, float, float]:
    """What recordings are sorted by: their names, then what is in them."""
    motors = experiment.channels.get("motor_torques")
    total = sum(float(np.nansum(column)) for column in motors.columns.values()) if motors is not None else 0.0
    return experiment.name, experiment.start_ns, experiment.duration, total
